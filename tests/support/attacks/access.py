"""Who asks: with no token that holds, or with one of another scope."""

from collections.abc import Iterable

from support.api import ball
from support.hostile import Answer, Attack, Target, row

CAMPAIGNS = "/api/v1/campaigns"
LEASE = "/api/v1/jobs/lease"
WANTED = {"worker": {"id": "mine"}, "capabilities": ["faulty@1"], "wait_s": 0}


def _everything(target: Target, authorization: bytes | None) -> Iterable[Answer]:
    headers = {} if authorization is None else {b"Authorization": authorization}
    for method, path in (
        ("GET", CAMPAIGNS),
        ("POST", CAMPAIGNS),
        ("GET", f"{CAMPAIGNS}/{target.running}"),
        ("POST", LEASE),
        ("POST", f"{CAMPAIGNS}/{target.running}/cancel"),
        ("DELETE", f"{CAMPAIGNS}/{target.finished}"),
        ("GET", "/metrics"),
        ("GET", "/nothing"),
        ("GET", f"{CAMPAIGNS}/{target.finished}/archive.npz"),
    ):
        yield target.ask(method, path, None, headers=headers)


@row("no token", 401)
def _none(target: Target) -> Iterable[Answer]:
    return _everything(target, None)


@row("a malformed token", 401)
def _malformed(target: Target) -> Iterable[Answer]:
    token = target.tokens["admin"].encode()
    for given in (
        b"",
        b"Bearer",
        b"Bearer  ?",
        token,
        b"bearer " + token,
        b"Bearer " + token[:-1],
        b"Bearer " + token + b"0",
        b"Bearer brink_admin_00000000_" + b"0" * 48,
        b"Bearer \xff\xfe",
        b"Bearer " + b"x" * 8000,
        b"Bearer ' OR '1'='1",
        b"Bearer " + token.upper(),
    ):
        yield from _everything(target, given)


@row("a revoked token", 401)
def _revoked(target: Target) -> Iterable[Answer]:
    return _everything(target, b"Bearer " + target.tokens["revoked"].encode())


@row("an expired token", 401)
def _expired(target: Target) -> Iterable[Answer]:
    return _everything(target, b"Bearer " + target.tokens["expired"].encode())


@row("a token altered to name another scope", 401)
def _widened(target: Target) -> Iterable[Answer]:
    for scope in ("read", "user", "worker"):
        widened = target.tokens[scope].replace(f"_{scope}_", "_admin_")
        yield from _everything(target, b"Bearer " + widened.encode())


@row("a valid token outside the Authorization header", 401)
def _misplaced(target: Target) -> Iterable[Answer]:
    token = target.tokens["admin"]
    yield target.ask("GET", f"{CAMPAIGNS}?token={token}&access_token={token}", None)
    for name in ("Cookie", "X-Authorization", "X-Api-Key", "Proxy-Authorization"):
        yield target.ask("GET", CAMPAIGNS, None, headers={name: f"Bearer {token}"})
    yield target.ask("GET", CAMPAIGNS, None, headers={"Authorization": f"Basic {token}"})


@row("two tokens at once", 401)
def _both(target: Target) -> Iterable[Answer]:
    head = b"GET /api/v1/campaigns HTTP/1.1\r\nHost: x\r\nConnection: close\r\nAuthorization: Bearer no\r\n"
    yield target.send(head + b"AUTH\r\n" + b"\r\n")


@row("scope read submits or modifies", 403)
def _read_changes(target: Target) -> Iterable[Answer]:
    yield target.submit(ball(seed=9), "read")
    for verb in ("pause", "resume", "cancel"):
        yield target.ask("POST", f"{CAMPAIGNS}/{target.running}/{verb}", "read")
    yield target.ask("POST", f"/api/v1/jobs/{target.mine.job}/retry", "read")
    yield target.ask("POST", f"{CAMPAIGNS}/{target.finished}/solutions/1/trace", "read")
    yield target.ask("PUT", f"{CAMPAIGNS}/{target.finished}/violations/1/x/name", "read", json={"name": "x"})


@row("scope read or user uses the worker endpoints", 403)
def _user_leases(target: Target) -> Iterable[Answer]:
    for scope in ("read", "user"):
        for what in ("lease", "heartbeat", "results"):
            yield target.ask("POST", f"/api/v1/jobs/{what}", scope, json=WANTED)


@row("scope worker submits", 403)
def _worker_submits(target: Target) -> Iterable[Answer]:
    yield target.submit(ball(seed=9), "worker")
    yield target.ask("POST", f"{CAMPAIGNS}/{target.running}/pause", "worker")


@row("scope worker reads", 403)
def _worker_reads(target: Target) -> Iterable[Answer]:
    for path in (CAMPAIGNS, f"{CAMPAIGNS}/{target.finished}/solutions", "/api/v1/jobs", "/metrics"):
        yield target.ask("GET", path, "worker")


@row("scope read, user or worker deletes", 403)
def _others_delete(target: Target) -> Iterable[Answer]:
    for scope in ("read", "user", "worker"):
        for after in ("", "/", "?force=1"):
            yield target.ask("DELETE", f"{CAMPAIGNS}/{target.finished}{after}", scope)


@row("a worker path in an unusual spelling", 403, 404, 405)
def _spelled(target: Target) -> Iterable[Answer]:
    for path in (
        "lease%0A",
        "lease%0D",
        "lease/",
        "lease%2F",
        "lease%00",
        "./lease",
        "../jobs//lease",
        "LEASE",
    ):
        yield target.ask("POST", f"/api/v1/jobs/{path}", "user", json=WANTED)
        head = f"POST /api/v1/jobs/{path} HTTP/1.1\r\nHost: x\r\nConnection: close\r\n".encode()
        yield target.send(head + b"Content-Length: 0\r\nAUTH\r\n\r\n", scope="user")


ACCESS: tuple[Attack, ...] = (
    _none,
    _malformed,
    _revoked,
    _expired,
    _widened,
    _misplaced,
    _both,
    _read_changes,
    _user_leases,
    _worker_submits,
    _worker_reads,
    _others_delete,
    _spelled,
)
