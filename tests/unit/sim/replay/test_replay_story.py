"""The story of an episode: which moment decides, which lead to it, in which words."""

from dataclasses import replace

import numpy as np
import pytest
from support.traces import make_trace

from brink.sim.replay.captions import scenario_words, with_unit
from brink.sim.replay.errors import ReplayError
from brink.sim.replay.gap import front_gap
from brink.sim.replay.moments import tell
from brink.sim.replay.still import still
from brink.sim.replay.top_down import FramePainter


def test_first_violation_decides() -> None:
    trace = make_trace()
    story = tell(trace)
    series = trace.robustness["front-gap@1"]
    assert story.requirement == "front-gap@1"
    assert story.violated
    assert series[story.decisive] < 0
    assert (series[: story.decisive] >= 0).all()
    assert story.least == pytest.approx(series.min())


def test_closest_approach_decides_where_nothing_is_violated() -> None:
    trace = make_trace(violated=False)
    story = tell(trace)
    assert not story.violated
    assert story.decisive == trace.robustness["front-gap@1"].argmin()


def test_moments_ascend_and_hold_the_decisive_one_and_what_led_to_it() -> None:
    story = tell(make_trace())
    samples = [moment.sample for moment in story.moments]
    assert samples == sorted(set(samples))
    assert 4 <= len(samples) <= 6
    reasons = {moment.sample: moment.reason for moment in story.moments}
    assert reasons[story.decisive] == "violation"
    assert "injected vehicle" in reasons.values()
    assert "1 s before" in reasons.values()


@pytest.mark.parametrize("violated", [True, False])
def test_every_injected_detection_has_a_moment_at_which_it_is_reported(violated: bool) -> None:
    trace = make_trace(violated=violated)
    injected = [moment for moment in tell(trace).moments if moment.reason.startswith("injected ")]
    assert injected
    for moment in injected:
        labels = trace.given_boxes.at(moment.sample)[:, 0].astype(int)
        assert ("vehicle", "person").index(moment.reason.removeprefix("injected ")) in labels


@pytest.mark.parametrize("name", ["progress", "progress@1"])
def test_requirement_is_found_with_or_without_its_version(name: str) -> None:
    assert tell(make_trace(), name).requirement == "progress@1"


def test_unknown_requirement_is_refused_with_the_known_ones() -> None:
    with pytest.raises(ReplayError, match=r"front-gap@1, progress@1.*got 'speed'"):
        tell(make_trace(), "speed")


def test_trace_without_samples_or_requirements_is_refused() -> None:
    trace = make_trace()
    with pytest.raises(ReplayError, match="no samples"):
        tell(replace(trace, time_s=np.empty(0, np.float32)))
    with pytest.raises(ReplayError, match="no requirement"):
        tell(replace(trace, robustness={}))


def test_robustness_that_never_applies_is_no_violation() -> None:
    trace = make_trace()
    never = replace(trace, robustness={"front-gap@1": np.full(200, np.inf, np.float32)})
    assert not tell(never).violated
    assert np.isinf(tell(never).least)
    assert FramePainter(never).verdict() == "front-gap was never at stake"
    assert still(never).width == 1280


def test_scenario_is_told_in_words() -> None:
    assert scenario_words(make_trace()) == (
        "Medium straight road (road 1), sunset, wet cloudy, 18 pedestrians, task: follow the road"
    )
    assert scenario_words(replace(make_trace(), about={})) == ""
    unknown: dict[str, object] = {"spec": {"scenario": {"fog_density": 0.5, "pedestrians": 0}}}
    assert scenario_words(replace(make_trace(), about=unknown)) == "no pedestrians, fog density 0.5"  # type: ignore[arg-type]


def test_nothing_is_said_to_be_longer_before_than_the_episode_is() -> None:
    trace = make_trace()
    early = np.ones(len(trace.time_s), np.float32)
    early[int(np.searchsorted(trace.time_s, 1.5))] = -1.0
    reasons = [m.reason for m in tell(replace(trace, robustness={"front-gap@1": early})).moments]
    assert "1 s before" in reasons
    assert "2.5 s before" not in reasons
    assert "5 s before" not in reasons


def test_robustness_is_written_with_sign_and_unit() -> None:
    assert with_unit(-0.84, "front-gap@1") == "−0.8 m"
    assert with_unit(-0.021, "front-gap@1") == "−0.02 m"
    assert with_unit(3.0, "speed-limit@1") == "+3.0 m/s"
    assert with_unit(3.0, "mine@2") == "+3.0"


def test_gap_line_leads_to_the_vehicle_ahead_and_has_the_recorded_length() -> None:
    trace = make_trace()
    found = front_gap(trace, tell(trace).decisive)
    assert found is not None
    assert trace.actors[found.actor].name == "lead"
    assert np.hypot(*(found.ends[0] - found.ends[1])) == pytest.approx(found.gap_m, abs=0.05)


def test_gap_line_is_not_drawn_to_an_oncoming_vehicle_at_the_same_distance() -> None:
    trace = make_trace()
    sample = 10
    lead, oncoming = trace.actors[0].motion.copy(), trace.actors[1].motion.copy()
    oncoming[sample, :2] = lead[sample, 0], 1.75
    actors = (replace(trace.actors[1], motion=oncoming), replace(trace.actors[0], motion=lead))
    found = front_gap(replace(trace, actors=actors), sample)
    assert found is not None
    assert found.actor == 1


def test_no_gap_is_drawn_to_what_was_hit() -> None:
    trace = make_trace()
    sample = tell(trace).decisive
    hit = np.ones(len(trace.time_s), np.float32)
    touching = trace.actors[0].motion.copy()
    touching[sample - 1 : sample + 1, 0] -= 1.2
    actors = (replace(trace.actors[0], motion=touching), *trace.actors[1:])
    judged = replace(trace, actors=actors, robustness={"no-collision@1": hit})
    near = front_gap(judged, sample)
    assert near is not None
    assert near.gap_m < 1.0
    hit[sample] = -0.4
    assert front_gap(judged, sample) is None
    assert front_gap(judged, sample - 1) is not None


def test_the_gap_ahead_is_drawn_while_somebody_else_is_hit() -> None:
    trace = make_trace()
    hit = np.full(len(trace.time_s), -0.4, np.float32)
    judged = replace(trace, robustness={**trace.robustness, "no-collision@1": hit})
    found = front_gap(judged, 10)
    assert found is not None
    assert found.gap_m > 1.0


def test_gap_without_record_goes_to_the_nearest_vehicle_in_the_corridor() -> None:
    trace = replace(make_trace(), robustness={"progress@1": np.zeros(200, np.float32)})
    found = front_gap(trace, 50)
    assert found is not None
    assert trace.actors[found.actor].name == "lead"


def test_no_gap_is_drawn_when_nobody_is_ahead() -> None:
    trace = make_trace()
    far = {"front-gap@1": np.full(200, 48.5, np.float32)}
    assert front_gap(replace(trace, robustness=far), 50) is None
    assert front_gap(replace(trace, actors=()), 50) is None
