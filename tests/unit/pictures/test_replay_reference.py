"""Replays of violations that a reference driver would have avoided: the words, and both drives side by side."""

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from support.traces import make_trace

from brink.pictures.frame import FramePainter
from brink.pictures.motion import brakings, distances, lane_edge, motion_of, plan_words, scripts_of
from brink.pictures.reference import Comparison, comparison_of
from brink.pictures.story import runs
from brink.server.problems.npc_actions import NpcActions, NpcActionsParams
from brink.sim.encounter.simulator import BrinkEncounter
from brink.sim.episode import Json
from brink.sim.trace import AVOIDABLE, Event, Trace

PERSON_M = 60.75
"""Where a person crosses, less half a body."""
HALF_CAR_M = 2.25


def hits_a_person(*, at_s: float = 7.0, avoidable: str = "careful", gap_too: bool = False) -> Trace:
    """Return a drive that hits a person, and perhaps comes too near to a vehicle half a second before."""
    trace = make_trace(violated=False)
    hit = np.where(trace.time_s >= at_s - 1e-4, -0.5, 3.0).astype(np.float32)
    near = np.where(trace.time_s >= at_s - 0.5 - 1e-4, -0.2, 3.0).astype(np.float32)
    requirements = {"front-gap@2": near if gap_too else np.full_like(near, 3.0), "no-collision@1": hit}
    event = Event(time_s=at_s, kind="collision", text="the ego hits pedestrian-1 at 5.0 m/s")
    return replace(
        trace,
        robustness=requirements,
        events=(event,),
        about={**trace.about, AVOIDABLE: dict.fromkeys(requirements, avoidable)},
    )


def driven(*, stops_at_m: float | None, from_s: float = 3.5, driver: str = "careful") -> Trace:
    """Return the drive of a reference driver, who brakes and then stands with the middle of the car at a place."""
    trace = make_trace(violated=False, samples=121)
    ego, modes = trace.ego.copy(), list(trace.plan_mode)
    if stops_at_m is not None:
        stands = trace.time_s >= from_s + 1.0 - 1e-4
        ego[stands, 0], ego[stands, 3], ego[:, 1] = stops_at_m, 0.0, -1.75
        modes = ["stop" if time_s >= from_s - 1e-4 else "cruise" for time_s in trace.time_s]
    else:
        ego[:, 0], ego[:, 3] = 14.0 * trace.time_s, 14.0
        modes = ["cruise"] * len(modes)
    held = {name: np.full(len(trace.time_s), 3.0, np.float32) for name in ("front-gap@2", "no-collision@1")}
    spec: dict[str, Json] = {"behaviour": {"mode": "reference", "driver": driver}}
    return replace(
        trace,
        ego=ego,
        plan_mode=tuple(modes),
        robustness=held,
        events=(),
        about={**trace.about, "spec": spec},
    )


def compared(system: Trace, reference: Trace, requirement: str | tuple[str, ...] | None = None) -> Comparison:
    found = comparison_of(replace(system, reference=reference), requirement)
    assert found is not None
    return found


def test_the_words_say_what_the_system_did_and_what_a_careful_driver_does_instead() -> None:
    found = compared(hits_a_person(), driven(stops_at_m=50.0))
    short_m = PERSON_M - HALF_CAR_M - 50.0
    assert found.sentences == (
        "The system hit pedestrian-1 at 7.0 s.",
        f"A careful driver brakes at 3.5 s and stops {short_m:.1f} m short of pedestrian-1.",
    )
    assert "UN Regulation No. 157, Annex 3" in found.explanation
    assert found.brakes_at_s == pytest.approx(3.5)
    assert found.avoided_by == ""
    nearest = found.deed.nearest
    assert nearest is not None
    assert nearest.gap_m == pytest.approx(short_m, abs=0.05), (
        "the number in the words is a point of the curve"
    )


def test_pictures_are_about_the_collision_that_too_small_a_gap_led_to() -> None:
    system = hits_a_person(gap_too=True)
    found = compared(system, driven(stops_at_m=50.0), ("no-collision@1", "front-gap@2"))
    assert found.system == "came within 1.5 m of lead at 6.5 s and hit pedestrian-1 at 7.0 s"
    assert found.about.requirement == "no-collision@1"
    assert [mark.words for mark in found.violated] == ["within 1.5 m", "collision"]
    assert found.others == ""
    gap = compared(system, driven(stops_at_m=50.0), "front-gap@2")
    assert (gap.system, gap.about.requirement) == ("came within 1.5 m of lead at 6.5 s", "front-gap@2")


def test_who_moves_up_while_waiting_stays_behind_and_brakes_once() -> None:
    reference = driven(stops_at_m=50.0)
    ego, modes = reference.ego.copy(), list(reference.plan_mode)
    for number in range(5):  # lets go of the brake for half a second, and moves up by 0.4 m
        begin = 50 + 15 * number
        modes[begin : begin + 5] = ["cruise"] * 5
        ego[begin : begin + 5, 3] = 0.8
        ego[begin:, 0] += 0.4
    moves_up = replace(reference, ego=ego, plan_mode=tuple(modes))
    words = plan_words(moves_up)
    assert [word for word, _, _ in runs(words)] == ["drives", "brakes", "waits"]
    assert brakings(moves_up) == [(35, len(words) - 1)]
    found = compared(hits_a_person(), moves_up)
    person = next(index for index, actor in enumerate(moves_up.actors) if actor.name == "pedestrian-1")
    least_m = float(np.nanmin(distances(moves_up, person)[35:]))
    assert found.driven == f"brakes at 3.5 s and stays at least {least_m:.1f} m clear of pedestrian-1"


def test_who_brakes_for_the_second_time_brakes_again() -> None:
    reference = driven(stops_at_m=50.0)
    modes = ["stop" if 5 <= sample < 10 else mode for sample, mode in enumerate(reference.plan_mode)]
    found = compared(hits_a_person(), replace(reference, plan_mode=tuple(modes)))
    assert found.driven.startswith("brakes again at 3.5 s and stops ")


def test_a_script_that_moves_nobody_is_no_motion() -> None:
    trace = hits_a_person()
    lead = trace.actors[0]
    motion = lead.motion.copy()
    motion[50:, 3] = 0.0
    events = tuple(
        Event(time_s=at_s, kind="action", text=f"car-1:{action}")
        for at_s, action in ((0.0, "keep"), (3.0, "decelerate"), (5.5, "change_right"))
    )
    trace = replace(trace, actors=(replace(lead, name="car-1", motion=motion),), events=events)
    found = [words for words, _, _ in runs(scripts_of(trace)["car-1"])]
    assert found == ["keeps going", "slows down", "stands"]
    assert motion_of(trace, 0, 60) == "stands"
    assert motion_of(trace, 0, 10).startswith("drives at ")


def test_what_nobody_avoids_is_shown_alone_and_says_so() -> None:
    system = replace(hits_a_person(avoidable="no"), reference=driven(stops_at_m=50.0))
    assert comparison_of(system) is None
    painter = FramePainter(system)
    assert painter.verdict() == "hit a pedestrian at 7.0 s, not avoidable by braking"
    assert comparison_of(hits_a_person()) is None, "it has no other drive"
    assert comparison_of(make_trace(violated=False)) is None


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_edge_of_the_lane_is_drawn_where_the_margin_has_it(side: float) -> None:
    trace = make_trace(violated=False)
    ego = trace.ego.copy()
    offset_m = np.linspace(0.0, 1.6, len(ego))
    ego[:, 1], ego[:, 2] = -1.75 + side * offset_m, 0.0
    half_lane_m, tolerance_m = 1.9, 0.2
    margin = half_lane_m + tolerance_m - offset_m - trace.ego_size_m[1] / 2
    trace = replace(trace, ego=ego, robustness={"lane-keeping@1": margin.astype(np.float32)})
    edge = lane_edge(trace, 100, 9.0)
    assert edge is not None
    assert edge[:, 1] == pytest.approx(-1.75 + side * half_lane_m, abs=0.01)
    assert np.abs(edge[:, 0] - ego[100, 0]).max() < 11.0
    assert lane_edge(replace(trace, robustness={}), 100, 9.0) is None


@cache
def simulated() -> Trace:
    """Return the drive of a candidate that a careful driver would have avoided, as the simulator records it."""
    problem, rng = NpcActions(NpcActionsParams()), np.random.default_rng(4711)
    spec = problem.episode(problem.space.sample(rng), 1000)
    result = BrinkEncounter().run(spec, record=True)
    assert result.trace is not None
    return Trace.from_bytes(result.trace)


def test_a_recorded_drive_says_who_avoids_what() -> None:
    trace = simulated()
    assert trace.about[AVOIDABLE] == {"front-gap@2": "careful", "no-collision@1": "careful"}
    assert trace.reference is not None
    assert AVOIDABLE not in trace.reference.about
    found = comparison_of(trace)
    assert found is not None
    system, instead = found.sentences
    assert re.fullmatch(
        r"The system came within 1\.5 m of car-4 at \d+\.\d s and hit it at \d+\.\d s\.", system
    )
    assert re.fullmatch(r"A careful driver brakes at \d+\.\d s and stops \d+\.\d m short of car-4\.", instead)
