"""What the fuzzer is told beyond the description of the API: not to wait for work, and what there is to ask for.

`BRINK_FUZZ_KNOWN` is JSON of what `support.fuzzed.fill` has put there. Most cases get some of it in place of what was
made up: made-up ids alone would find nothing but "no such campaign".
"""

import json
import os
import random
from typing import Any

import schemathesis

KNOWN: dict[str, list[Any]] = json.loads(os.environ["BRINK_FUZZ_KNOWN"])
SHARE = 0.7
"""Of cases that are told what there is."""

_NEED_TRACES = ("/trace", "/episode", "/pictures/{index}.jpg", "/replay.{extension}")
_rng = random.Random(1)


@schemathesis.hook
def before_call(context: Any, case: Any, **_: Any) -> None:
    """Change a request before it is sent."""
    body = case.body if isinstance(case.body, dict) else {}
    for place in (body, body.get("lease")):
        if isinstance(place, dict) and "capabilities" in place:
            place["wait_s"] = 0
    if case.path.endswith(_NEED_TRACES) and _would_wait(case.query):
        case.query["wait_s"] = 0
    if isinstance(case.path_parameters, dict) and (_rng.random() < SHARE or _would_end_one(case)):
        _find(case)
    if isinstance(case.query, dict) and _rng.random() < SHARE:
        _ask(case.query)
    for name in ("results", "leases", "release"):
        items = body.get(name)
        for item in items if isinstance(items, list) else []:
            if isinstance(item, dict) and _rng.random() < SHARE:
                item.update(_rng.choice(KNOWN["leases"]))
    for name, known in (("problem", "ball@1"), ("algorithm", "ga@1")):
        if isinstance(body.get(name), dict) and _rng.random() < SHARE:
            body[name]["id"] = known
    if case.path.endswith("/monitor/score") and body and _rng.random() < SHARE:
        body["solutions"] = KNOWN["solutions"]
        body.pop("threshold", None)
        case.path_parameters["campaign_id"] = KNOWN["campaigns"][0]


def _would_wait(query: Any) -> bool:
    """Whether a trace that a worker must make would be waited for."""
    if not isinstance(query, dict):
        return False
    try:
        return 0 <= float(query.get("wait_s", 20)) <= 60
    except (TypeError, ValueError):
        return False


def _ends(case: Any) -> bool:
    path: str = case.path
    return case.method.upper() == "DELETE" or path.endswith("/cancel")


def _would_end_one(case: Any) -> bool:
    """Whether a made-up id is the beginning of that of a campaign which the other cases need."""
    made_up = str(case.path_parameters.get("campaign_id", case.path_parameters.get("experiment_id", "?")))
    needed = [*KNOWN["campaigns"], *KNOWN["experiments"]]
    return _ends(case) and any(name.startswith(made_up) for name in needed)


def _find(case: Any) -> None:
    """Name what there is in a path; what ends a campaign gets one to spare."""
    path = case.path_parameters
    ends = _ends(case)
    if "requirement" in path:
        path.update(_rng.choice(KNOWN["violations"]))
    elif case.path.endswith(_NEED_TRACES) and _rng.random() < SHARE:
        path.update(_rng.choice(KNOWN["traced"]))
        if "index" in path:
            path["index"] = _rng.randrange(4)
    elif "experiment_id" in path:
        path["experiment_id"] = _rng.choice(KNOWN["spare_experiments" if ends else "experiments"])
    elif "campaign_id" in path:
        path["campaign_id"] = _rng.choice(KNOWN["spares" if ends else "campaigns"])
        if "number" in path:
            path["number"] = _rng.choice(KNOWN["numbers"])
    elif "job" in path:
        path["job"] = _rng.choice(KNOWN["jobs"])


def _ask(query: dict[str, Any]) -> None:
    """Name what there is in a query."""
    if "numbers" in query:
        query["numbers"] = ",".join(str(_rng.choice(KNOWN["numbers"])) for _ in range(3))
    if "campaign" in query:
        query["campaign"] = _rng.choice(KNOWN["campaigns"])
