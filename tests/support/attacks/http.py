"""HTTP itself: hosts, methods, upgrades, heads that are none or never end."""

from collections.abc import Iterable

from support.hostile import Answer, Attack, Target, row

CAMPAIGNS = "/api/v1/campaigns"
EVIL = "evil.example"


@row("a foreign name in Host", 200, hides=(EVIL,))
def _hosts(target: Target) -> Iterable[Answer]:
    for host in (EVIL, f"{EVIL}:80", f"127.0.0.1@{EVIL}", "", "x" * 1000):
        headers = {
            "Host": host,
            "X-Forwarded-Host": EVIL,
            "X-Forwarded-For": EVIL,
            "Forwarded": f"host={EVIL}",
        }
        yield target.ask("GET", CAMPAIGNS, headers=headers)


@row("a redirect to a foreign name in Host", 404, 405, hides=(EVIL,))
def _redirect(target: Target) -> Iterable[Answer]:
    for path in (f"{CAMPAIGNS}/", "/docs/", "//evil.example/%2f..", "/healthz/"):
        yield target.ask("GET", path, headers={"Host": EVIL})


@row("a method override in a header", 200)
def _override(target: Target) -> Iterable[Answer]:
    for name in ("X-HTTP-Method-Override", "X-HTTP-Method", "X-Method-Override"):
        yield target.ask("GET", f"{CAMPAIGNS}/{target.finished}", headers={name: "DELETE"})
        yield target.ask("GET", f"{CAMPAIGNS}/{target.finished}?_method=DELETE", headers={name: "DELETE"})


@row("an unknown method", 400, 405, problem=False)
def _methods(target: Target) -> Iterable[Answer]:
    for method in ("BREW", "TRACE", "PUT", "delete", "PROPFIND", "X" * 500):
        head = (
            f"{method} {CAMPAIGNS}/{target.finished} HTTP/1.1\r\nHost: x\r\nConnection: close\r\nAUTH\r\n\r\n"
        )
        yield target.send(head.encode())


@row("a CORS preflight from another site", 401, hides=("access-control",))
def _preflight(target: Target) -> Iterable[Answer]:
    asked = {"Origin": f"http://{EVIL}", "Access-Control-Request-Method": "POST"}
    for path in (CAMPAIGNS, f"{CAMPAIGNS}/{target.running}/cancel", "/api/v1/jobs/lease"):
        yield target.ask("OPTIONS", path, None, headers=asked)


@row("an upgrade to a websocket", 200, 401)
def _websocket(target: Target) -> Iterable[Answer]:
    asked = {
        "Connection": "Upgrade",
        "Upgrade": "websocket",
        "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==",
        "Sec-WebSocket-Version": "13",
    }
    for scope in ("admin", None):
        yield target.ask("GET", CAMPAIGNS, scope, headers=asked)
        yield target.ask("GET", CAMPAIGNS, scope, headers={"Connection": "Upgrade", "Upgrade": "h2c"})


@row("an absolute URL of another site as the path", 200, hides=(EVIL,))
def _proxied(target: Target) -> Iterable[Answer]:
    head = f"GET http://{EVIL}/api/v1/campaigns HTTP/1.1\r\nHost: {EVIL}\r\nConnection: close\r\nAUTH\r\n\r\n"
    yield target.send(head.encode())


@row("a pipelined second request", 200)
def _pipelined(target: Target) -> Iterable[Answer]:
    first = b"GET /healthz HTTP/1.1\r\nHost: x\r\nAUTH\r\n\r\n"
    second = f"DELETE /api/v1/campaigns/{target.finished} HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n"
    answer = target.send(first + second.encode())
    assert " 401 " in answer.text, "judged by itself"
    yield answer


@row("a request that is not valid HTTP/1.1", 400, 401, problem=False)
def _garbage(target: Target) -> Iterable[Answer]:
    for line in (
        b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03",
        b"\x00\r\n\r\n",
        b"GET /metrics\r\n\r\n",
        b"GET /metrics HTTP/1.1\r\nConnection: close\r\n\r\n",
        b"GET / HTTP/1.1\r\nHost: x\r\nno colon\r\n\r\n",
        b"HTTP/1.1 200 OK\r\n\r\n",
        b"GET /\xff HTTP/1.1\r\nHost: x\r\n\r\n",
        b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n",
    ):
        yield target.send(line, scope=None)


@row("an oversized request head", 0, 400, 431, problem=False)
def _enormous(target: Target) -> Iterable[Answer]:
    for head in (b"GET /" + b"a" * 200_000, b"GET / HTTP/1.1\r\nHost: x\r\nX-A: " + b"a" * 200_000):
        yield target.send(head, scope=None)
    many = b"".join(b"X-%d: a\r\n" % number for number in range(20_000))
    yield target.send(b"GET / HTTP/1.1\r\nHost: x\r\n" + many, scope=None)


@row("a request head that never ends", 0, problem=False)
def _slow(target: Target) -> Iterable[Answer]:
    for head in (b"", b"G", b"GET /api/v1/campaigns HTTP/1.1\r\nHost: x\r\nX-Slow: "):
        yield target.send(head, scope=None)


HTTP: tuple[Attack, ...] = (
    _hosts,
    _redirect,
    _override,
    _methods,
    _preflight,
    _websocket,
    _proxied,
    _pipelined,
    _garbage,
    _enormous,
    _slow,
)
