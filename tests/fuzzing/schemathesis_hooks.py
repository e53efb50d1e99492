"""Changes to the fuzzer's requests: they do not wait for work, and most of them name campaigns and jobs that exist.

`BRINK_FUZZ_KNOWN` holds the ids and leases that `fill` in `test_fuzzing.py` made, as JSON. Made-up ids alone would
get no answer but "no such campaign".
"""

import json
import os
import random
from typing import Any

import schemathesis

KNOWN: dict[str, list[Any]] = json.loads(os.environ["BRINK_FUZZ_KNOWN"])
SHARE = 0.7
"""Share of the requests that get existing ids."""

_NEED_TRACES = ("/trace", "/episode", "/pictures/{index}.jpg", "/replay.{extension}")
_PICTURE_OF_PAIR = "/{side}.png"
_rng = random.Random(1)


@schemathesis.hook
def before_call(context: Any, case: Any, **_: Any) -> None:
    """Change a request before it is sent."""
    body = case.body if isinstance(case.body, dict) else {}
    for place in (body, body.get("lease")):
        if isinstance(place, dict) and "capabilities" in place:
            place["wait_s"] = 0
    if case.path.endswith((*_NEED_TRACES, _PICTURE_OF_PAIR)) and _would_wait(case.query):
        case.query["wait_s"] = 0
    if isinstance(case.path_parameters, dict) and (_rng.random() < SHARE or _would_end_a_needed_one(case)):
        _use_existing_ids_in_path(case)
    if isinstance(case.query, dict) and _rng.random() < SHARE:
        _use_existing_ids_in_query(case.query)
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
    if "/tolerance" in case.path and _rng.random() < SHARE:
        _ask_for_tolerances(case, body)
    if case.path.endswith("/pairs/follow-ups") and body and _rng.random() < SHARE:
        body.pop("repeats", None)
        body |= {"kind": "confirm", "eps": 1.0, "d_th": 0.0, "limit": 1}
        case.path_parameters["campaign_id"] = KNOWN["campaigns"][0]
    if case.path.endswith("/thresholds/follow-ups") and body and _rng.random() < SHARE:
        body.pop("repeats", None)
        body |= {"kind": "confirm", "limit": 1}
        case.path_parameters["campaign_id"] = KNOWN["thresholds"][0]


def _ask_for_tolerances(case: Any, body: dict[str, Any]) -> None:
    """Name campaigns and drives between which there is something to compare."""
    known = KNOWN["tolerances"][0]
    case.path_parameters["campaign_id"] = known["campaign"]
    if isinstance(case.query, dict):
        case.query |= {name: known[name] for name in ("fresh", "episodes") if name in case.query}
    if body:
        body["drives"] = [{"name": "1", "condition": "all", "measures": {"lead": {"miss": 0.5}}}]


def _would_wait(query: Any) -> bool:
    """Return whether a request would wait for a worker to record a trace."""
    if not isinstance(query, dict):
        return False
    try:
        return 0 <= float(query.get("wait_s", 20)) <= 60
    except (TypeError, ValueError):
        return False


def _ends_a_campaign(case: Any) -> bool:
    path: str = case.path
    return case.method.upper() == "DELETE" or path.endswith("/cancel")


def _would_end_a_needed_one(case: Any) -> bool:
    """Return whether a made-up id is a prefix of an id that other requests need."""
    made_up = str(case.path_parameters.get("campaign_id", case.path_parameters.get("experiment_id", "?")))
    needed = [*KNOWN["campaigns"], *KNOWN["thresholds"], *KNOWN["experiments"]]
    return _ends_a_campaign(case) and any(name.startswith(made_up) for name in needed)


def _use_existing_ids_in_path(case: Any) -> None:
    """Put existing ids into a path; a request that ends a campaign gets a spare one."""
    path = case.path_parameters
    ends = _ends_a_campaign(case)
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
        path.update({side: _rng.choice(KNOWN["numbers"]) for side in ("safe", "unsafe") if side in path})
        if "number" in path:
            path["number"] = _rng.choice(KNOWN["numbers"])
    elif "job" in path:
        path["job"] = _rng.choice(KNOWN["jobs"])


def _use_existing_ids_in_query(query: dict[str, Any]) -> None:
    """Put existing ids into a query."""
    if "numbers" in query:
        query["numbers"] = ",".join(str(_rng.choice(KNOWN["numbers"])) for _ in range(3))
    if "campaign" in query:
        query["campaign"] = _rng.choice(KNOWN["campaigns"])
