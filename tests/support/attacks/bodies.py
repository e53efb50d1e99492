"""Bodies: what is no campaign, what is no JSON, what is too much, and what never ends."""

import gzip
import json
from collections.abc import Iterable, Iterator

from support.api import ball
from support.hostile import Answer, Attack, Target, results, row

MOST_BYTES = 12 * 1024 * 1024
"""The bound of the coordinator that is attacked."""
CAMPAIGNS = "/api/v1/campaigns"
HEAD = b"POST /api/v1/campaigns HTTP/1.1\r\nHost: x\r\nContent-Type: application/json\r\nAUTH\r\n"
BALL = json.dumps(ball(seed=9)).encode()


def _with(old: bytes, new: bytes) -> bytes:
    assert old in BALL
    return BALL.replace(old, new)


@row("NaN, Infinity or 1e999 in a campaign", 422)
def _not_finite(target: Target) -> Iterable[Answer]:
    for number in (b"NaN", b"Infinity", b"-Infinity", b"1e999", b"-1e999"):
        yield target.submit(_with(b'"seed": 9', b'"seed": ' + number))
        yield target.submit(_with(b'"ball@1"', b'"ball@1", "params": {"limit": ' + number + b"}"))
        yield target.submit(_with(b'"seed": 9', b'"execution": {"max_failed_share": ' + number + b"}"))


@row("integers of 25 to 5,000 digits", 400, 422)
def _huge_integers(target: Target) -> Iterable[Answer]:
    for digits in (25, 400, 4000, 5000):
        for sign in (b"", b"-"):
            yield target.submit(_with(b'"seed": 9', b'"seed": ' + sign + b"9" * digits))
            yield target.submit(_with(b'"simulations": 60', b'"simulations": ' + sign + b"9" * digits))


@row("JSON nested 100,000 levels deep", 400, 413, 422)
def _deep(target: Target) -> Iterable[Answer]:
    for inner in (
        b"[" * 100_000 + b"]" * 100_000,
        b'{"a":' * 100_000 + b"1" + b"}" * 100_000,
        b"[" * 100_000,
    ):
        yield target.submit(inner)
        yield target.submit(_with(b'"ball@1"', b'"ball@1", "params": {"limit": ' + inner + b"}"))
    for levels in (33, 500, 900):
        inner = b"[" * levels + b"]" * levels
        yield target.submit(_with(b'"ball@1"', b'"ball@1", "params": {"limit": ' + inner + b"}"))


@row("a duplicate field, of which the last one counts", 422, says="/name")
def _twice(target: Target) -> Iterable[Answer]:
    yield target.submit(BALL[:-1] + b', "name": ""}')


@row("a body that is not JSON", 400, 422)
def _no_json(target: Target) -> Iterable[Answer]:
    for content in (
        b"",
        b"{",
        b"\x00",
        b"\xff\xfe",
        b"<xml/>",
        b"name: yaml",
        BALL[:-1],
        BALL + b"x",
        b"'",
        b"\x80{}",
    ):
        yield target.submit(content)


@row("JSON that is not a campaign", 422)
def _no_campaign(target: Target) -> Iterable[Answer]:
    for body in (None, 1, "text", [], [ball(seed=9)], {}, {"campaign": ball(seed=9)}, True):
        yield target.submit(body)


@row("unknown fields, such as `__proto__`", 422, says="unknown field")
def _unknown_fields(target: Target) -> Iterable[Answer]:
    for name in (
        "__proto__",
        "constructor",
        "__class__",
        "__init__",
        "id",
        "status",
        "model_config",
        "$where",
    ):
        yield target.submit({**ball(seed=9), name: {"admin": True}})
        yield target.submit({**ball(seed=9), "problem": {"id": "ball@1", "params": {name: 1}}})
        algorithm = {"id": "ga@1", "params": {"population_size": 20, name: 1}}
        yield target.submit({**ball(seed=9), "algorithm": algorithm})


@row("parameters of the wrong type", 422)
def _types(target: Target) -> Iterable[Answer]:
    for value in ("1", True, None, [], {}, [1.0], {"$gt": 0}, "1; DROP TABLE jobs", "${7*7}", 10**400):
        yield target.submit({**ball(seed=9), "problem": {"id": "ball@1", "params": {"limit": value}}})
        algorithm = {"id": "ga@1", "params": {"population_size": value}}
        yield target.submit({**ball(seed=9), "algorithm": algorithm})
    for value in (None, [], "x", 1):
        yield target.submit({**ball(seed=9), "problem": {"id": "ball@1", "params": value}})


@row("a population or a budget of billions", 422)
def _billions(target: Target) -> Iterable[Answer]:
    yield target.submit({**ball(seed=9), "budget": {"simulations": 10**10}})
    for number in (10**9, 2**63, 0, -1):
        algorithm = {"id": "ga@1", "params": {"population_size": number}}
        yield target.submit({**ball(seed=9), "algorithm": algorithm})


@row("an unknown content type", 422)
def _content_types(target: Target) -> Iterable[Answer]:
    for kind in (
        "text/plain",
        "application/xml",
        "multipart/form-data; boundary=x",
        "application/x-www-form-urlencoded",
        "application/x-python-pickle",
        "application/yaml",
        "x",
        "application/json5",
        "",
    ):
        yield target.ask("POST", CAMPAIGNS, "user", content=BALL, headers={"Content-Type": kind})
    yield target.ask("POST", CAMPAIGNS, "user", content=BALL)


@row("a compression bomb", 400, 422)
def _bomb(target: Target) -> Iterable[Answer]:
    bomb = gzip.compress(b" " * 200_000_000)
    for encoding in ("gzip", "deflate", "br", "zstd", "gzip, gzip"):
        headers = {"Content-Type": "application/json", "Content-Encoding": encoding}
        yield target.ask("POST", CAMPAIGNS, "user", content=bomb, headers=headers)


@row("an oversized body with a Content-Length", 413)
def _too_long(target: Target) -> Iterable[Answer]:
    for length in (MOST_BYTES + 1, 10**12, 10**18):
        yield target.send(HEAD + b"Connection: close\r\nContent-Length: %d\r\n\r\n{" % length)


@row("an oversized body without a Content-Length", 413)
def _endless(target: Target) -> Iterable[Answer]:
    def parts() -> Iterator[bytes]:
        for _ in range(MOST_BYTES // 65536 + 2):
            yield b" " * 65536

    headers = {"Content-Type": "application/json"}
    yield target.ask("POST", CAMPAIGNS, "user", content=parts(), headers=headers)


@row("a small body of very many values", 413, says="JSON values")
def _many_values(target: Target) -> Iterable[Answer]:
    for item in (b"1", b"{}", b"[]", b'"a"', b'{"a":1}'):
        many = b"[" + b",".join([item] * 100_001) + b"]"
        yield target.submit(many)
        yield target.submit(_with(b'"ball@1"', b'"ball@1", "params": {"limit": ' + many + b"}"))
        yield target.say("results", b'{"worker":{"id":"mine"},"results":' + many + b"}")
        few = b"[" + b",".join([item] * 2_001) + b"]"
        yield target.say("heartbeat", b'{"worker":{"id":"mine"},"leases":' + few + b"}")
        yield target.say("lease", b'{"worker":{"id":"mine"},"capabilities":' + few + b"}")


@row("very many unknown fields", 422, says="fields")
def _many_fields(target: Target) -> Iterable[Answer]:
    many = b", ".join(b'"f%d": 1' % number for number in range(90_000))
    yield target.submit(BALL[:-1] + b", " + many + b"}")
    yield target.submit(_with(b'"ball@1"', b'"ball@1", ' + many))
    yield target.say("results", b'{"worker":{"id":"mine"},"results":[], ' + many + b"}")


@row("very many unknown parameters", 422)
def _many_parameters(target: Target) -> Iterable[Answer]:
    many = b", ".join(b'"f%d": 1' % number for number in range(90_000))
    yield target.submit(_with(b'"ball@1"', b'"ball@1", "params": {' + many + b"}"))


@row("a campaign file whose aliases stand for billions of values", 422, says="alias")
def _aliases(target: Target) -> Iterable[Answer]:
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{level}: &a{level} [{', '.join([f'*a{level - 1}'] * 9)}]" for level in range(1, 12)]
    for text in ("\n".join(lines), "a: &a [*a]"):
        headers = {"Content-Type": "application/yaml"}
        yield target.ask("POST", f"{CAMPAIGNS}/check", "user", content=text.encode(), headers=headers)


@row("a body shorter than its Content-Length", 408)
def _lie(target: Target) -> Iterable[Answer]:
    yield target.send(HEAD + b"Content-Length: 5000\r\n\r\n" + BALL)


@row("a body longer than its Content-Length", 400, 422)
def _longer(target: Target) -> Iterable[Answer]:
    yield target.send(HEAD + b"Connection: close\r\nContent-Length: 5\r\n\r\n" + BALL)


@row("a chunked body that never ends", 408)
def _unended(target: Target) -> Iterable[Answer]:
    yield target.send(HEAD + b"Transfer-Encoding: chunked\r\n\r\n", b"5\r\n     \r\n" * 10)


@row("an invalid Content-Length", 400, problem=False)
def _no_length(target: Target) -> Iterable[Answer]:
    for length in (b"-1", b"1e3", b"0x10", b"\xb2", b"9" * 5000, b"5\r\nContent-Length: 6", b"1 1", b"+5"):
        yield target.send(HEAD + b"Content-Length: " + length + b"\r\n\r\n     ")
    yield target.send(HEAD + b"Transfer-Encoding: chunked\r\n\r\nZZ\r\n")


@row("a Content-Length together with chunked encoding", 400, problem=False)
def _both(target: Target) -> Iterable[Answer]:
    both = b"Connection: close\r\nContent-Length: 60\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n\r\n"
    hidden = f"DELETE /api/v1/campaigns/{target.finished} HTTP/1.1\r\nHost: x\r\nAUTH\r\n\r\n".encode()
    yield target.send(HEAD + both + hidden)


@row("a name of a megabyte", 422)
def _long_names(target: Target) -> Iterable[Answer]:
    long = "x" * 1024**2
    start = {"solutions": [{"values": {long: 1}}]}
    for body in (
        {**ball(seed=9), long: 1},
        ball(seed=9, execution={long: 1}),
        ball(seed=9, start_from=start),
        ball(seed=9, sources={long: 1}),
        ball(seed=9, problem={"id": "ball@1", "params": {long: 1}}),
    ):
        yield target.submit(body)
    for outcome in ({"kind": long}, {"kind": "completed", "verdicts": {long: 1}}):
        yield target.say("results", results(target.mine.job, target.mine.token, outcome))


BODIES: tuple[Attack, ...] = (
    _not_finite,
    _huge_integers,
    _deep,
    _twice,
    _no_json,
    _no_campaign,
    _unknown_fields,
    _types,
    _billions,
    _content_types,
    _bomb,
    _too_long,
    _endless,
    _many_values,
    _many_fields,
    _many_parameters,
    _aliases,
    _lie,
    _longer,
    _unended,
    _no_length,
    _both,
    _long_names,
)
