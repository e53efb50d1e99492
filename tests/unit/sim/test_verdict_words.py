"""Verdicts in words: they name the requirement, and every other one that was violated."""

import numpy as np
import pytest

from brink.sim.catalogue import REQUIREMENTS, is_own_plugin, requirement_ids
from brink.sim.episode import Verdict
from brink.sim.requirements import CollisionKind
from brink.sim.verdict import (
    _HELD,
    _VIOLATED,
    EpisodeVerdict,
    Impact,
    clock_words,
    drives_violate,
    plain_id,
    violated_words,
)

SIX = ("front-gap@1", "no-collision@1", "lane-keeping@1", "red-light@1", "speed-limit@1", "progress@1")


def verdicts(**violated_at_s: float | None) -> dict[str, Verdict]:
    """Return verdicts on six requirements; those named are violated at the given time."""
    given = {name.replace("_", "-"): time_s for name, time_s in violated_at_s.items()}
    return {
        f"{name}@1": Verdict(robustness=-1.0, unit="m", violated_at_s=given[name])
        if name in given
        else Verdict(robustness=1.0, unit="m", violated_at_s=None)
        for name in (one.partition("@")[0] for one in SIX)
    }


def test_a_drive_that_holds_its_requirement_names_every_other_violation() -> None:
    features = {"no-collision@1:collision_kind": "pedestrian"}
    found = EpisodeVerdict.of(verdicts(no_collision=12.84, lane_keeping=3.0), features, ("front-gap@1",))
    assert not found.unsafe
    assert found.words() == "front gap held; left the lane at 3.0 s; hit a pedestrian at 12.8 s"
    assert found.words(times=False) == "front gap held; left the lane; hit a pedestrian"
    assert [one.requirement for one in found.others] == ["lane-keeping@1", "no-collision@1"]


def test_the_requirements_that_decide_come_first() -> None:
    found = EpisodeVerdict.of(verdicts(no_collision=5.0, lane_keeping=3.0), {}, ("no-collision@1",))
    assert found.unsafe
    assert found.words() == "had a collision at 5.0 s; left the lane at 3.0 s"
    assert [one.decides for one in found.violated] == [True, False]


def test_every_requirement_that_ships_has_words_of_its_own() -> None:
    shipped = {plain_id(name) for name in requirement_ids() if is_own_plugin(REQUIREMENTS, name)}
    for words in (_HELD, _VIOLATED):
        assert shipped <= set(words), "add the missing ones in sim/verdict.py"


@pytest.mark.parametrize("requirement", requirement_ids())
def test_what_drives_do_is_worded_as_what_a_drive_did(requirement: str) -> None:
    if drives_violate([requirement]) != "collide":
        _, *did = violated_words(requirement).split()
        _, *do = drives_violate([requirement]).split()
        assert do == did


@pytest.mark.parametrize("kind", CollisionKind)
def test_a_collision_says_with_what(kind: CollisionKind) -> None:
    assert kind.value in violated_words("no-collision@1", kind)


@pytest.mark.parametrize(
    ("bearing_rad", "heading_rad", "speed_mps", "words"),
    [
        (0.1, -1.57, 2.0, "hit a vehicle"),
        (1.5, -1.57, 2.0, "was driven into by a vehicle at its left side"),
        (2.2, -1.57, 2.0, "was driven into by a vehicle at its left rear"),
        (-1.0, 1.57, 2.0, "was driven into by a vehicle at its right front"),
        (-1.0, -1.57, 2.0, "hit a vehicle with its right front"),
        (1.5, -1.57, 0.0, "hit a vehicle with its left side"),
        (3.1, 0.0, 9.0, "was driven into by a vehicle at its rear"),
        (3.1, 0.0, 4.0, "hit a vehicle with its rear"),
    ],
)
def test_a_collision_says_who_ran_into_whom(
    bearing_rad: float, heading_rad: float, speed_mps: float, words: str
) -> None:
    other = {"bearing_rad": bearing_rad, "heading_rad": heading_rad, "speed_mps": speed_mps, "kind": "car"}
    violation = {"requirement": "no-collision@1", "ego": {"speed_mps": 5.0}, "other": other}
    features = {"no-collision@1:collision_kind": "vehicle", "violations": [{}, violation]}
    found = EpisodeVerdict.of(verdicts(no_collision=12.0), features, ())
    assert found.words() == f"{words} at 12.0 s"


@pytest.mark.parametrize(
    "violations",
    [
        None,
        [3],
        [{"requirement": "no-collision@1", "other": {}}],
        [
            {
                "requirement": "no-collision@1",
                "ego": {"speed_mps": True},
                "other": {"bearing_rad": 10**400, "heading_rad": 0.0, "speed_mps": 1.0},
            }
        ],
    ],
)
def test_what_other_simulators_report_of_a_collision_is_no_error(violations: object) -> None:
    features = {"no-collision@1:collision_kind": "pedestrian", "violations": violations}
    assert EpisodeVerdict.of(verdicts(no_collision=1.0), features, ()).words() == "hit a pedestrian at 1.0 s"


def test_people_walk_into_a_car() -> None:
    met = Impact.of(bearing_rad=1.5, heading_rad=-1.57, speed_mps=1.0, ego_mps=3.0, on_foot=True)
    assert met.words("pedestrian-4") == "was walked into by pedestrian-4 at its left side"


def test_a_time_has_the_same_words_whatever_the_type_of_the_number() -> None:
    assert {clock_words(6.85), clock_words(float(np.float32(6.85))), clock_words(6.9)} == {"6.9 s"}
    assert clock_words(12.84) == "12.8 s"
