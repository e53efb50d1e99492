"""What workers say: of jobs that are not theirs, and of results that are none."""

import json
from collections.abc import Iterable

from support.attacks.access import WANTED
from support.hostile import Answer, Attack, Target, outcome_of, results, row


@row("a forged lease token", 200, says="stale")
def _forged(target: Target) -> Iterable[Answer]:
    outcome = outcome_of(target.mine)
    for token in ("0" * 32, target.mine.token[:-1] + "~", "'OR'1'='1", target.mine.token.upper() + "!"):
        yield target.say("results", results(target.mine.job, token, outcome))
    failed = {"kind": "failed", "reason": "invalid", "message": ""}
    yield target.say("results", results(target.mine.job, "0" * 32, failed))


@row("the lease token of another job", 200, says="stale")
def _another_jobs(target: Target) -> Iterable[Answer]:
    yield target.say("results", results(target.theirs.job, target.mine.token, outcome_of(target.theirs)))
    yield target.say("results", results(target.mine.job, target.reported.token, outcome_of(target.mine)))


@row("a job that another worker holds, of another campaign", 200, says="stale")
def _another_workers(target: Target) -> Iterable[Answer]:
    body = results(target.theirs.job, "0" * 32, outcome_of(target.theirs), "theirs")
    yield target.say("results", body)
    yield target.say("results", {**body, "worker": {"id": "mine"}})


@row("the same result twice", 200, says="duplicate")
def _twice(target: Target) -> Iterable[Answer]:
    body = results(target.reported.job, target.reported.token, outcome_of(target.reported))
    yield target.say("results", body)
    yield target.say("results", {**body, "results": body["results"] * 100})
    yield target.say("results", results(target.reported.job, target.reported.token, outcome_of(target.mine)))


@row("a result after its lease expired and the job was leased again", 200, says="stale")
def _late(target: Target) -> Iterable[Answer]:
    yield target.say("results", results(target.lost.job, target.lost.token, outcome_of(target.lost)))


@row("a result for a job that does not exist", 200, says="stale")
def _nowhere(target: Target) -> Iterable[Answer]:
    for job in (0, 10**6, 2**53 + 1, 2**63 - 1):
        yield target.say("results", results(job, target.mine.token, outcome_of(target.mine)))


@row("a heartbeat for leases that are not held", 200, says='"held":[]')
def _heartbeat(target: Target) -> Iterable[Answer]:
    forged = [{"job": job, "token": "0" * 32} for job in (0, target.mine.job, target.theirs.job, 2**63 - 1)]
    lost = {"job": target.lost.job, "token": target.lost.token}
    yield target.say("heartbeat", {"worker": {"id": "mine"}, "leases": [*forged, lost]})


@row("a release of leases that are not held", 200, says='"statuses":[]')
def _release(target: Target) -> Iterable[Answer]:
    forged = [{"job": job, "token": "0" * 32} for job in (target.mine.job, target.theirs.job)]
    reported = {"job": target.reported.job, "token": target.reported.token}
    yield target.say("results", {"worker": {"id": "mine"}, "results": [], "release": [*forged, reported]})


@row("NaN, Infinity or 1e999 in a result", 422)
def _not_finite(target: Target) -> Iterable[Answer]:
    verdict = {"robustness": "NUMBER", "unit": "m", "violated_at_s": None}
    for number in (b"NaN", b"Infinity", b"-Infinity", b"1e999", b"-1e999"):
        for outcome in (
            {"kind": "completed", "verdicts": {"distance@1": verdict}},
            {"kind": "completed", "verdicts": {}, "objectives": {"distance": "NUMBER"}},
            {"kind": "completed", "verdicts": {}, "features": {"a": [["NUMBER"]]}},
        ):
            body = json.dumps(results(target.mine.job, target.mine.token, outcome)).encode()
            yield target.say("results", body.replace(b'"NUMBER"', number))


@row("a number of a result beyond the limits", 422)
def _immense(target: Target) -> Iterable[Answer]:
    whole = outcome_of(target.mine)
    verdict = whole["verdicts"]["distance@1"]
    for outcome in (
        {**whole, "verdicts": {"distance@1": {**verdict, "violated_at_s": 1e308}}},
        {**whole, "verdicts": {"distance@1": {**verdict, "robustness": -1e308}}},
        {**whole, "objectives": {"distance": 1e308}},
    ):
        yield target.say("results", results(target.mine.job, target.mine.token, outcome))


@row("a malformed result", 422)
def _no_result(target: Target) -> Iterable[Answer]:
    whole = outcome_of(target.mine)
    outcomes: tuple[object, ...] = (
        None,
        [],
        "completed",
        {},
        {"kind": "other"},
        {"kind": "failed", "reason": "hacked", "message": ""},
        {**whole, "verdicts": None},
        {**whole, "verdicts": {"distance@1": {"robustness": "x", "unit": "m"}}},
        {**whole, "admin": True},
        {**whole, "features": []},
    )
    for outcome in outcomes:
        yield target.say("results", results(target.mine.job, target.mine.token, outcome))


@row("an oversized result", 422)
def _enormous(target: Target) -> Iterable[Answer]:
    whole = outcome_of(target.mine)
    verdict = whole["verdicts"]["distance@1"]
    deep: dict[str, object] = {}
    for _ in range(40):
        deep = {"in": deep}
    for outcome in (
        {**whole, "verdicts": {f"r{n}@1": verdict for n in range(65)}},
        {**whole, "verdicts": {"r" * 129: verdict}},
        {**whole, "objectives": {f"o{n}": 1.0 for n in range(65)}},
        {**whole, "features": {f"f{n}": 1.0 for n in range(257)}},
        {**whole, "features": deep},
        {"kind": "failed", "reason": "error", "message": "x" * 4001},
    ):
        yield target.say("results", results(target.mine.job, target.mine.token, outcome))


@row("a trace that is not base64", 422, says="base64")
def _no_base64(target: Target) -> Iterable[Answer]:
    for trace in ("!", "A", "AAAA=AAAA", "\u00fc", "AA AA", "data:;base64,AAAA"):
        outcome = {**outcome_of(target.mine), "trace": trace}
        yield target.say("results", results(target.mine.job, target.mine.token, outcome))


@row("an oversized trace", 422, says="8000000")
def _enormous_trace(target: Target) -> Iterable[Answer]:
    outcome = {**outcome_of(target.mine), "trace": "A" * 8_000_004}
    yield target.say("results", results(target.mine.job, target.mine.token, outcome))


@row("NUL or a lone surrogate from a worker", 422)
def _odd_text(target: Target) -> Iterable[Answer]:
    for odd in (r"\u0000", r"\ud800", r"\udfff\ud800"):
        for body in (
            {"worker": {"id": "ODD"}, "capabilities": []},
            {"worker": {"id": "mine", "host": "ODD"}, "capabilities": []},
            {"worker": {"id": "mine"}, "capabilities": ["ODD"]},
        ):
            yield target.say("lease", json.dumps(body).replace("ODD", odd).encode())
        outcome = {**outcome_of(target.mine), "objectives": {"ODD": 1.0}}
        body = results(target.mine.job, target.mine.token, outcome)
        yield target.say("results", json.dumps(body).replace("ODD", odd).encode())


@row("a worker identity that is too long or malformed", 422)
def _identity(target: Target) -> Iterable[Answer]:
    for identity in (
        {"id": "x" * 65},
        {"id": ""},
        {"id": "mine", "host": "x" * 256},
        {"id": "mine", "version": "x" * 65},
        {"id": "mine", "machine": "x" * 129},
        {"id": "mine", "pid": -1},
        {"id": "mine", "pid": 2**63},
        {"id": "mine", "scope": "admin"},
        {"id": ["mine"]},
        None,
    ):
        yield target.say("lease", {**WANTED, "worker": identity})


@row("a lease request beyond the limits", 422)
def _wishes(target: Target) -> Iterable[Answer]:
    for wish in (
        {"max_jobs": 257},
        {"max_jobs": 10**25},
        {"max_jobs": 0},
        {"max_jobs": -1},
        {"wait_s": 61},
        {"wait_s": -1},
        {"capabilities": ["x"] * 257},
        {"capabilities": ["x" * 129]},
        {"capabilities": {"x": 1}},
    ):
        yield target.say("lease", {**WANTED, **wish})
    yield target.say("lease", json.dumps(WANTED).encode().replace(b'"wait_s": 0', b'"wait_s": NaN'))
    lease = {"job": target.mine.job, "token": "0" * 32}
    yield target.say("heartbeat", {"worker": {"id": "mine"}, "leases": [lease] * 513})
    item = {**lease, "outcome": outcome_of(target.mine)}
    yield target.say("results", {"worker": {"id": "mine"}, "results": [item] * 257})
    for job in (-1, 2**63, 1.5, "1; DROP TABLE jobs", 10**400):
        yield target.say("results", results(job, "0" * 32, outcome_of(target.mine)))  # type: ignore[arg-type]


@row("text or a truth value as a number from a worker", 422)
def _no_numbers(target: Target) -> Iterable[Answer]:
    for wrong in ("8", True, [8], {"$gt": 0}):
        for field in ("max_jobs", "wait_s"):
            yield target.say("lease", {**WANTED, field: wrong})
        yield target.say("lease", {**WANTED, "worker": {"id": "mine", "pid": wrong}})
        lease = {"job": wrong, "token": target.mine.token}
        yield target.say("heartbeat", {"worker": {"id": "mine"}, "leases": [lease]})
        yield target.say("results", {"worker": {"id": "mine"}, "results": [], "release": [lease]})
        whole = outcome_of(target.mine)
        verdict = {**whole["verdicts"]["distance@1"], "robustness": wrong}
        for outcome in (
            {**whole, "verdicts": {"distance@1": verdict}},
            {**whole, "objectives": {"a": wrong}},
        ):
            yield target.say("results", results(target.mine.job, target.mine.token, outcome))


WORKERS: tuple[Attack, ...] = (
    _forged,
    _another_jobs,
    _another_workers,
    _twice,
    _late,
    _nowhere,
    _heartbeat,
    _release,
    _not_finite,
    _immense,
    _no_result,
    _enormous,
    _no_base64,
    _enormous_trace,
    _odd_text,
    _identity,
    _wishes,
    _no_numbers,
)
