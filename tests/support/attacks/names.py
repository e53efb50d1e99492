"""Names, paths, queries: SQL, ways out of folders, letters that are none, numbers past all bounds."""

import base64
import json
from collections.abc import Iterable
from urllib.parse import quote

from support.api import ball
from support.hostile import KEY, Answer, Attack, Target, row

CAMPAIGNS = "/api/v1/campaigns"
SQL = (
    "' OR '1'='1",
    "x'; DROP TABLE jobs; --",
    "%",
    "_",
    "__",
    "a%' --",
    "\\",
    "1 UNION SELECT * FROM tokens",
    "';ATTACH DATABASE '/tmp/x' AS x;--",
    "$1",
    ":campaign",
    "pg_sleep(9)",
)


@row("SQL in an id", 404)
def _sql_in_ids(target: Target) -> Iterable[Answer]:
    for sql in SQL:
        for after in ("", "/progress", "/solutions/1", "/boundary?format=csv", "/violations"):
            yield target.ask("GET", f"{CAMPAIGNS}/{quote(sql, safe='')}{after}")
        yield target.ask("POST", f"{CAMPAIGNS}/{quote(sql, safe='')}/cancel")
        yield target.ask("DELETE", f"{CAMPAIGNS}/{quote(sql, safe='')}")


@row("SQL in a query", 422)
def _sql_in_queries(target: Target) -> Iterable[Answer]:
    for sql in SQL:
        for path, name in (
            (CAMPAIGNS, "status"),
            (CAMPAIGNS, "document_hash"),
            (CAMPAIGNS, "limit"),
            ("/api/v1/jobs", "status"),
            ("/api/v1/jobs", "campaign"),
            ("/api/v1/jobs", "after"),
            (f"{CAMPAIGNS}/{target.finished}/solutions", "after"),
            (f"{CAMPAIGNS}/{target.finished}/solutions", "unsafe"),
            (f"{CAMPAIGNS}/{target.finished}/distances", "numbers"),
        ):
            yield target.ask("GET", path, params={name: sql})


@row("SQL in a cursor, or an invalid cursor", 422, says="/query/cursor")
def _sql_in_cursors(target: Target) -> Iterable[Answer]:
    for text in (
        *(f"1.0 {sql}" for sql in SQL if not sql.isalnum()),
        "nan abc",
        "-1.0 abc",
        "1.0",
        "1.0 a\0",
        "\xff",
    ):
        cursor = base64.urlsafe_b64encode(text.encode("latin-1")).decode()
        yield target.ask("GET", CAMPAIGNS, params={"cursor": cursor})
    for cursor in ("!!", "AAA", "\u00fc", "A" * 201):
        yield target.ask("GET", CAMPAIGNS, params={"cursor": cursor})


@row("path traversal in an id", 404)
def _traversal_in_ids(target: Target) -> Iterable[Answer]:
    for way in (
        "..%2F..%2Fetc%2Fpasswd",
        "%2e%2e%2f",
        "..%5c..%5c",
        "%2Fetc%2Fpasswd",
        "....%2F%2F",
        "%252e%252e%252f",
    ):
        for after in ("", "/archive.npz", "/boundary", "/solutions/1/replay.png"):
            yield target.ask("GET", f"{CAMPAIGNS}/{way}{after}")


@row("path traversal below the documentation files", 404, hides=("root:", "secret"))
def _traversal_in_pages(target: Target) -> Iterable[Answer]:
    for way in (
        "../../etc/passwd",
        "..%2f..%2f..%2fetc%2fpasswd",
        "%2e%2e/%2e%2e/etc/passwd",
        "/etc/passwd",
        "%2fetc%2fpasswd",
        "..%5c..%5cetc",
        "....//....//etc/passwd",
        "%252e%252e%252fetc",
        "%00",
        "swagger-ui.css%00",
        "swagger-ui.css%0a",
        "../__init__.py",
        "..%2f__init__.py",
        "a" * 5000,
        "",
        ".",
    ):
        head = f"GET /docs-files/{way} HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n"
        yield target.send(head.encode(), scope=None)


@row("path traversal from a public path to the API", 401, 404)
def _around(target: Target) -> Iterable[Answer]:
    for way in (
        "/docs-files/../api/v1/campaigns",
        "/docs-files/%2e%2e/api/v1/campaigns",
        "/docs/../api/v1/campaigns",
        "/healthz/../api/v1/campaigns",
        "//api/v1/campaigns",
        "/./api/v1/campaigns",
        "/%61pi/v1/campaigns",
        "/healthz%2f..%2fmetrics",
        "/docs-files%2f..%2fmetrics",
        "http://localhost/api/v1/campaigns",
        "/healthz;/../metrics",
        "/API/V1/CAMPAIGNS",
    ):
        head = f"GET {way} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n"
        yield target.send(head.encode(), scope=None)


@row("CR and LF in a name or an id", 404, 422, hides=("evil",))
def _line_feeds(target: Target) -> Iterable[Answer]:
    for name in ("a\r\nSet-Cookie: b", "a\nb", "a\r", "a\u2028b", "a\x1bb"):
        yield target.submit({**ball(seed=9), "name": name})
    for after in ("", "/boundary?format=csv", "/archive.npz"):
        yield target.ask("GET", f"{CAMPAIGNS}/{target.finished}%0d%0aSet-Cookie:%20evil{after}")


@row("NUL or a lone surrogate in a campaign", 422)
def _odd_text(target: Target) -> Iterable[Answer]:
    bodies: tuple[dict[str, object], ...] = (
        {"name": "ODD"},
        {"algorithm": {"id": "ODD"}},
        {"problem": {"id": "ODD"}},
        {"ODD": 1},
        {"problem": {"id": "ball@1", "params": {"ODD": 1}}},
    )
    for odd in (r"\u0000", r"\ud800", r"\udfff\ud800"):
        for body in bodies:
            yield target.submit(json.dumps({**ball(seed=9), **body}).replace("ODD", odd).encode())
    fault = json.dumps({**ball(seed=9), "problem": {"id": "ball@1", "params": {"fault": "ODD"}}})
    yield target.submit(fault.replace("ODD", r"\ud800").encode())


@row("limits and numbers that are negative or out of range", 422)
def _bounds(target: Target) -> Iterable[Answer]:
    for number in (
        "-1",
        "-9999999999999999999999",
        "1e9",
        "99999999999999999999",
        "NaN",
        "Infinity",
        "0x10",
        "",
        "\u0664",
    ):
        yield target.ask("GET", CAMPAIGNS, params={"limit": f"{number}x" if number == "\u0664" else number})
        yield target.ask(
            "GET", "/api/v1/jobs", params={"after": f"-{number}" if number == "\u0664" else number}
        )
    for path in (
        "solutions?limit=1001",
        "solutions?after=-2",
        "solutions/9007199254740993",
        "solutions/-1",
        "progress?since=-1",
        "boundary?t_b=2",
        "boundary?d_th=nan",
        "solutions?max_fitness=inf",
        "solutions/1/trace?wait_s=61",
        "solutions/1/trace?wait_s=nan",
        "solutions/1/replay.exe",
        "distances?numbers=",
        f"distances?numbers={'1,' * 1001}",
        f"distances?numbers={'9' * 6000}",
    ):
        yield target.ask("GET", f"{CAMPAIGNS}/{target.finished}/{path}")


@row("numbers of solutions and jobs that do not exist", 404)
def _not_there(target: Target) -> Iterable[Answer]:
    for path in (
        "solutions/9007199254740992",
        "solutions/60",
        "solutions/60/trace",
        "distances?numbers=0,60",
        "distances?numbers=-1",
        f"distances?numbers={'9' * 4000}",
        "violations",
    ):
        yield target.ask("GET", f"{CAMPAIGNS}/{target.finished}/{path}")
    yield target.ask("POST", "/api/v1/jobs/9007199254740992/retry")


@row("an ambiguous or empty id prefix", 404)
def _short_ids(target: Target) -> Iterable[Answer]:
    for name in ("%20", "*", "a" * 17, "a" * 3000, target.finished[:1], target.finished.upper() + "x"):
        yield target.ask("POST", f"{CAMPAIGNS}/{name}/cancel")


@row("an Idempotency-Key that is too long", 422, says="idempotency-key")
def _long_key(target: Target) -> Iterable[Answer]:
    for length in (201, 8000):
        headers = {"Idempotency-Key": "x" * length}
        yield target.ask("POST", CAMPAIGNS, "user", json=ball(seed=9), headers=headers)


@row("an Idempotency-Key that is empty or not printable text", 400, 422, problem=False)
def _binary_key(target: Target) -> Iterable[Answer]:
    body = json.dumps(ball(seed=9)).encode()
    for key in (b"", b"\x00", b"\x01\x02", b"a\x00b", b"\xff\xfe", b"a\x7fb"):
        head = (
            b"POST /api/v1/campaigns HTTP/1.1\r\nHost: x\r\nConnection: close\r\nAUTH\r\nIdempotency-Key: "
            + key
        )
        kind = b"\r\nContent-Type: application/json\r\nContent-Length: %d\r\n\r\n" % len(body)
        yield target.send(head + kind + body)


@row("the Idempotency-Key of another campaign", 409, says="used for another campaign")
def _taken_key(target: Target) -> Iterable[Answer]:
    yield target.ask("POST", CAMPAIGNS, "user", json=ball(seed=9), headers={"Idempotency-Key": KEY})


NAMES: tuple[Attack, ...] = (
    _sql_in_ids,
    _sql_in_queries,
    _sql_in_cursors,
    _traversal_in_ids,
    _traversal_in_pages,
    _around,
    _line_feeds,
    _odd_text,
    _bounds,
    _not_there,
    _short_ids,
    _long_key,
    _binary_key,
    _taken_key,
)
