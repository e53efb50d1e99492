"""Between the simulator's values and the wire: nothing changes, and nothing gets on the wire that cannot arrive."""

import json
import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from brink.sim.episode import EpisodeResult, Verdict
from brink.worker.codec import from_wire, outcome_from
from brink.worker.errors import UnexpectedReply, UnsendableResult
from brink.worker.outcome_document import MESSAGE_LENGTH, completed, failure_text
from brink.worker.wire import Completed, JobFailed

FINITE = st.floats(allow_nan=False, allow_infinity=False)
NAMES = st.text("abc@1-", min_size=1, max_size=8)
VERDICTS = st.builds(
    Verdict,
    robustness=FINITE,
    unit=st.sampled_from(["m", "s", "m/s"]),
    violated_at_s=st.none() | st.floats(0.0, 1e6),
)
JSON = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**53), 2**53) | FINITE | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(NAMES, inner, max_size=3),
    max_leaves=6,
)
RESULTS = st.builds(
    EpisodeResult,
    verdicts=st.dictionaries(NAMES, VERDICTS, max_size=3),
    objectives=st.dictionaries(NAMES, FINITE, max_size=3),
    features=st.dictionaries(NAMES, JSON, max_size=3),
    provenance=st.dictionaries(NAMES, JSON, max_size=3),
    trace=st.none() | st.binary(max_size=50),
)


@given(result=RESULTS)
def test_a_result_survives_the_wire(result: EpisodeResult) -> None:
    outcome = outcome_from(json.loads(json.dumps(completed(result))))
    assert isinstance(outcome, Completed)
    assert from_wire(outcome) == result


def result(**changed: Any) -> EpisodeResult:
    values: dict[str, Any] = {"verdicts": {}, "objectives": {}, "features": {}, "provenance": {}}
    return EpisodeResult(**{**values, **changed})


@pytest.mark.parametrize(
    ("changed", "place"),
    [
        ({"objectives": {"gap": math.nan}}, "objectives.gap"),
        ({"objectives": {"gap": math.inf}}, "objectives.gap"),
        (
            {"verdicts": {"r": Verdict(robustness=math.nan, unit="m", violated_at_s=None)}},
            "verdicts.r.robustness",
        ),
        ({"objectives": {"gap": "near"}}, "objectives.gap"),
        ({"features": {"deep": [{"x": math.nan}]}}, "features"),
        ({"features": {"odd": object()}}, "features"),
        ({"provenance": {"x": -math.inf}}, "provenance"),
    ],
)
def test_what_json_cannot_carry_is_refused_with_its_place(changed: dict[str, Any], place: str) -> None:
    with pytest.raises(UnsendableResult, match=place) as caught:
        completed(result(**changed))
    assert len(str(caught.value)) < 400


@pytest.mark.parametrize(
    ("changed", "place"),
    [
        ({"verdicts": {"r": Verdict(robustness=1.0, unit="m" * 17, violated_at_s=None)}}, "verdicts.r.unit"),
        ({"verdicts": {"r": Verdict(robustness=1.0, unit="m", violated_at_s=-1.0)}}, "violated_at_s"),
        ({"trace": b"x" * 6_000_001}, "trace"),
    ],
)
def test_what_breaks_the_bounds_of_the_wire_is_a_failure_that_names_its_place(
    changed: dict[str, Any], place: str
) -> None:
    outcome = outcome_from(completed(result(**changed)))
    assert isinstance(outcome, JobFailed)
    assert outcome.reason == "error"
    assert place in outcome.message
    assert len(outcome.message) < 400


def test_a_trace_that_is_no_base64_is_refused() -> None:
    with pytest.raises(UnexpectedReply, match="base64"):
        from_wire(Completed(verdicts={}, trace="not base64!"))


@given(message=st.text(max_size=9000), context=st.text(max_size=9000))
def test_the_text_of_a_failure_fits_the_wire(message: str, context: str) -> None:
    text = failure_text(message, context)
    assert len(text) <= MESSAGE_LENGTH
    JobFailed(reason="error", message=text)


def test_the_text_of_a_failure_keeps_its_head_and_the_end_of_its_context() -> None:
    text = failure_text("it broke", "line\n" * 5000 + "the last line\n")
    assert text.startswith("it broke\n")
    assert text.endswith("the last line")
