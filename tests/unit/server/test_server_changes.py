"""The change between the two sides of a pair, in values and in words."""

from typing import Any

import numpy as np
import pytest
from support.urban_pairs import BOX, NONE, SCENARIO

from brink.search.pairs import Steps
from brink.search.parameters import Categorical
from brink.server.findings.words import as_sentence
from brink.server.problems.aeb_crossing import AebCrossing
from brink.server.problems.base import SimulatedSolution, activity_of
from brink.server.problems.benchmarks import Mtq
from brink.server.problems.changes import (
    NOTHING_ACTIVE,
    Change,
    change_words,
    changes_between,
    common_words,
    different,
    moved_words,
)
from brink.server.problems.urban_changes import AFTERWARDS
from brink.server.problems.urban_injected import UrbanInjected

URBAN = UrbanInjected(UrbanInjected.params_type())
ABOVE = {"y_min_1_px": 180.0, "y_max_1_px": 240.0}
"""The upper and lower edge of a box above the horizon, at its end."""
VIOLATED_AT_S = 7.1


def report(label: str, start: int, end: int, **box: float) -> dict[str, Any]:
    return {"label": label, "t0_step": start, "t1_step": end, **BOX, **box}


def drive(
    *reports: dict[str, Any], violated_at_s: float | None = None, end_step: int = 300, **scenario: str
) -> SimulatedSolution:
    """Return a drive with two reports, each delivered until the end of the drive."""
    values = {
        f"trajectory_{number}.{name}": value
        for number, one in enumerate(reports, start=1)
        for name, value in one.items()
    }
    vectors = URBAN.space.encode({"scenario": {**SCENARIO, **scenario}, "behaviour": values})
    delivered = [
        None if one["t0_step"] > end_step else [one["t0_step"], min(one["t1_step"], end_step)]
        for one in reports
        if one["label"] != "null"
    ]
    verdict = {
        "robustness": 1.0 if violated_at_s is None else -1.0,
        "unit": "m",
        "violated_at_s": violated_at_s,
    }
    result = {
        "features": {"delivered_steps": delivered, "ended_at_s": end_step / 10},
        "verdicts": {"front-gap@1": verdict},
    }
    return SimulatedSolution(vectors=vectors, activity=activity_of(URBAN, vectors, result), result=result)


def unsafe_drive(*reports: dict[str, Any], **scenario: str) -> SimulatedSolution:
    return drive(*reports, violated_at_s=VIOLATED_AT_S, end_step=74, **scenario)


def words(safe: SimulatedSolution, unsafe: SimulatedSolution) -> str:
    rows = [URBAN.space.join(tuple(one.vectors)) for one in (safe, unsafe)]
    units = Steps(URBAN.space).differing(*rows)
    return change_words(URBAN, safe, unsafe, changes_between(URBAN, safe, unsafe, units))


def test_a_change_says_how_far_each_number_moved_of_its_range() -> None:
    safe, unsafe = drive(report("person", 130, 250), NONE), unsafe_drive(report("person", 156, 250), NONE)
    rows = [URBAN.space.join(tuple(one.vectors)) for one in (safe, unsafe)]
    [change] = changes_between(URBAN, safe, unsafe, Steps(URBAN.space).differing(*rows))
    [step] = [one for one in URBAN.space.components[1].parameters if one.name == "trajectory_1.t0_step"]
    assert not isinstance(step, Categorical)
    assert change.moved == pytest.approx(26 / step.range)
    assert moved_words([change]) == f"1 number moves by {26 / step.range:.0%} of its range"


def test_how_far_the_numbers_moved_is_told_of_those_that_had_a_part() -> None:
    near, far, idle, category = (
        Change(names=(name,), units=("",), safe=(0.0,), unsafe=(1.0,), active=active, moved=moved)
        for name, active, moved in (
            ("a", True, 0.004),
            ("b", True, 0.41),
            ("c", False, 0.9),
            ("d", None, None),
        )
    )
    assert moved_words([near]) == "1 number moves by 0.4% of its range"
    assert moved_words([near, far, idle]) == "2 numbers move by up to 41% of their ranges"
    assert moved_words([far, category]) == "1 number moves by 41% of its range; 1 category changes"
    assert moved_words([idle]) == ""


def test_of_several_alike_a_description_counts() -> None:
    three = UrbanInjected(UrbanInjected.params_type(trajectories=3))
    first, second = report("person", 10, 250), report("person", 20, 250)

    def side(third: dict[str, Any]) -> SimulatedSolution:
        values = {
            f"trajectory_{number}.{name}": value
            for number, one in enumerate((first, second, third), start=1)
            for name, value in one.items()
        }
        return SimulatedSolution(
            vectors=three.space.encode({"scenario": SCENARIO, "behaviour": values}),
            activity=None,
            result=None,
        )

    fields = {f"behaviour.trajectory_3.{name}" for name in NONE}
    later, absent = side(report("person", 43, 60)), side(NONE)
    sooner, moved = (
        side(report("person", 41, 60)),
        side(report("person", 43, 60, x_min_0_px=200.0, x_max_0_px=300.0)),
    )
    start = {"behaviour.trajectory_3.t0_step"}
    edges = {"behaviour.trajectory_3.x_min_0_px", "behaviour.trajectory_3.x_max_0_px"}
    assert three.words_of_change(absent, later, fields) == (
        "a third person is reported from 4.3 to 6.0 s; in the safe drive, no third person is"
    )
    assert three.words_of_change(later, absent, fields) == (
        "no third person is reported; in the safe drive, one is from 4.3 to 6.0 s"
    )
    assert "third" in three.words_of_change(later, moved, edges)
    assert "from 4.1 s instead of 4.3 s" in three.words_of_change(later, sooner, start)
    assert three.words(later.vectors).count("person ") == 3


@pytest.mark.parametrize(
    ("safe", "unsafe", "expected"),
    [
        (
            report("person", 43, 60),
            report("person", 41, 60),
            "a person is reported from 4.1 s instead of 4.3 s",
        ),
        (
            report("person", 43, 60),
            report("person", 43, 65),
            "a person is reported until 6.5 s instead of 6.0 s",
        ),
        (
            report("person", 7, 189),
            report("person", 80, 249),
            "no person is reported; in the safe drive, one is from 0.7 to 18.9 s",
        ),
        (
            report("person", 7, 189),
            report("person", 73, 249),
            "a person is reported only after the violation, from 7.3 s instead of 0.7 s",
        ),
        (
            report("person", 100, 200),
            report("person", 41, 200),
            "a person is reported from 4.1 to 20.0 s; in the safe drive, only from 10.0 s",
        ),
        (
            NONE,
            report("person", 41, 60),
            "a person is reported from 4.1 to 6.0 s; in the safe drive, no person is",
        ),
        (
            report("person", 41, 200),
            report("person", 41, 250),
            "the reported person moves more slowly through the image",
        ),
        (
            report("person", 41, 200),
            report("vehicle", 41, 200),
            "a vehicle is reported instead of a person from 4.1 to 20.0 s",
        ),
        (  # (400 - 350) px * 6.8 m / 400 px is 0.85 m, where 6.8 m is the distance of the lower edge
            report("person", 41, 60),
            report("person", 41, 60, x_min_0_px=310.0, x_max_0_px=410.0),
            "the reported person is 0.7 m left of straight ahead instead of 0.8 m (at 4.1 s)",
        ),
        (
            report("person", 41, 60),
            report("person", 41, 60, x_min_0_px=420.0, x_max_0_px=520.0),
            "the reported person is 1.2 m right of straight ahead instead of 0.8 m left (at 4.1 s)",
        ),
        (  # by its height: 400 px * 1.7 m / 70 px is 9.7 m
            report("person", 41, 60),
            report("person", 41, 60, y_min_0_px=220.0, y_max_0_px=290.0, x_min_0_px=310.0, x_max_0_px=410.0),
            "the reported person is 9.7 m ahead instead of 6.8 m (at 4.1 s), and 1 more difference",
        ),
        (
            report("person", 41, 60),
            report("person", 41, 60, x_min_0_px=300.0, x_max_0_px=500.0),
            "the reported person spans 1.7 m left to 1.7 m right of straight ahead instead of 0.0 to "
            "1.7 m left (at 4.1 s)",
        ),
        (
            report("person", 41, 60),
            report("person", 41, 60, x_min_0_px=304.0, x_max_0_px=396.0),
            "the reported person is 1.6 m wide instead of 1.7 m (at 4.1 s)",
        ),
        (  # 400 px * 1.7 m / (400 - 300) px is 6.8 m
            report("person", 41, 60),
            report("person", 41, 60, y_max_0_px=470.0),
            "the reported person is 4.0 m ahead instead of 6.8 m (at 4.1 s)",
        ),
        (
            report("person", 41, 60),
            report("person", 41, 60, y_max_1_px=305.0),
            "the reported person is 12.4 m ahead instead of 3.4 m (at 6.0 s)",
        ),
        (  # its lower edge is where it was, 6.8 m ahead; 200 px are as much as 3.4 m there
            report("person", 41, 60),
            report("person", 41, 60, y_min_0_px=200.0),
            "the reported person is 3.4 m tall instead of 2.5 m (at 4.1 s)",
        ),
        (  # above the horizon, a person of 60 px is 11.3 m away, wherever in the image
            report("person", 41, 60, y_min_0_px=200.0, y_max_0_px=260.0, **ABOVE),
            report("person", 41, 60, y_min_0_px=180.0, y_max_0_px=240.0, **ABOVE),
            "the reported person is higher in the image (at 4.1 s)",
        ),
        (  # At 4.1 s both are 6.8 m away, one by its height (100 px), the other one by its lower edge.
            report("person", 41, 61, y_min_0_px=180.0, y_max_0_px=280.0),
            report("person", 41, 61),
            "the reported person is 5.9 m ahead instead of 52.3 m (at 4.4 s), and 1 more difference",
        ),
        (report("person", 80, 189), report("person", 90, 189), NOTHING_ACTIVE),
    ],
)
def test_a_change_is_described_as_what_the_detector_reports(
    safe: dict[str, Any], unsafe: dict[str, Any], expected: str
) -> None:
    ended = report("person", 80, 189) == safe
    before = drive(safe, NONE, end_step=74 if ended else 300)
    assert words(before, unsafe_drive(unsafe, NONE)) == expected


@pytest.mark.parametrize(
    ("box", "expected"),
    [
        # The box of the safe drive's report at 7.1 s, 30 of 200 steps after its first one, is 15% on its way.
        (
            {"x_min_1_px": 300.0, "x_max_1_px": 700.0},
            "0.4 m left of straight ahead instead of 0.8 m (at 7.1 s)",
        ),
        (
            {"y_max_0_px": 450.0, "y_min_0_px": 200.0},
            "4.5 m ahead instead of 6.8 m (at 4.1 s), and 1 more difference",
        ),
        (
            {"x_min_0_px": 200.0, "x_max_0_px": 280.0, "y_min_0_px": 270.0, "y_max_0_px": 330.0},
            "9.1 m left of straight ahead instead of 0.8 m (at 4.1 s), and 2 more differences",
        ),
    ],
)
def test_boxes_are_compared_while_both_drives_run(box: dict[str, float], expected: str) -> None:
    safe, unsafe = report("person", 41, 241), report("person", 41, 241, **box)
    assert words(drive(safe, NONE), unsafe_drive(unsafe, NONE)) == f"the reported person is {expected}"


def test_boxes_are_not_compared_after_the_safe_drive_has_ended() -> None:
    safe, unsafe = report("person", 41, 241), report("person", 41, 241, x_min_1_px=300.0, x_max_1_px=700.0)
    assert words(drive(safe, NONE, end_step=61), unsafe_drive(unsafe, NONE)) == (
        "the reported person is 0.5 m left of straight ahead instead of 0.8 m (at 6.1 s)"
    )


def test_a_report_after_the_violation_makes_no_other_one_the_first() -> None:
    late = report("person", 150, 200)
    assert words(drive(report("person", 12, 60), late), unsafe_drive(report("person", 10, 60), late)) == (
        "a person is reported from 1.0 s instead of 1.2 s"
    )


def test_a_change_after_the_violation_is_not_called_its_cause() -> None:
    before, after = drive(report("person", 80, 189), NONE), unsafe_drive(report("person", 90, 189), NONE)
    assert words(before, after) == AFTERWARDS


def test_of_two_equal_labels_the_earlier_report_is_the_first() -> None:
    late = report("person", 50, 70)
    assert words(drive(late, report("person", 12, 70)), unsafe_drive(late, report("person", 10, 70))) == (
        "the first person is reported from 1.0 s instead of 1.2 s"
    )


@pytest.mark.parametrize(
    ("safe", "unsafe", "expected"),
    [
        (
            (report("person", 20, 250), report("person", 65, 250)),
            (report("person", 20, 250), report("person", 75, 250)),
            "no second person is reported; in the safe drive, one is from 6.5 to 25.0 s",
        ),
        (
            (report("person", 20, 250), report("person", 75, 250)),
            (report("person", 20, 250), report("person", 65, 250)),
            "a second person is reported from 6.5 to 25.0 s; in the safe drive, only from 7.5 s",
        ),
        (
            (report("person", 73, 250), report("person", 90, 250)),
            (report("person", 73, 250), report("person", 65, 250)),
            "a second person is reported from 6.5 to 25.0 s; in the safe drive, only from 9.0 s",
        ),
        (
            (report("person", 20, 250), NONE),
            (report("person", 20, 250), report("person", 65, 250)),
            "a second person is reported from 6.5 to 25.0 s; in the safe drive, no second person is",
        ),
        (
            (report("person", 73, 250), report("person", 65, 250)),
            (report("person", 73, 250), report("person", 75, 250)),
            "no person is reported up to the violation; in the safe drive, one is from 6.5 to 25.0 s",
        ),
        (
            (report("vehicle", 20, 250), report("person", 65, 250)),
            (report("vehicle", 20, 250), report("person", 75, 250)),
            "no person is reported; in the safe drive, one is from 6.5 to 25.0 s",
        ),
    ],
)
def test_a_sentence_about_one_report_is_true_of_both(
    safe: tuple[dict[str, Any], ...], unsafe: tuple[dict[str, Any], ...], expected: str
) -> None:
    assert words(drive(*safe), unsafe_drive(*unsafe)) == expected


def test_a_change_of_the_scenario_is_described() -> None:
    one = report("person", 10, 70)
    assert words(drive(one, NONE), unsafe_drive(one, NONE, weather="medium_rain", pedestrians="18")) == (
        "the weather is medium rain instead of clear; there are 18 pedestrians instead of 0"
    )


def test_what_had_no_part_in_either_drive_is_not_active_and_not_described() -> None:
    safe = drive(report("person", 10, 70), report("vehicle", 200, 250), end_step=100)
    unsafe = unsafe_drive(report("person", 12, 70), report("vehicle", 210, 250))
    rows = [URBAN.space.join(tuple(one.vectors)) for one in (safe, unsafe)]
    changes = changes_between(URBAN, safe, unsafe, Steps(URBAN.space).differing(*rows))
    assert [(change.names, change.active) for change in changes] == [
        (("behaviour.trajectory_1.t0_step",), True),
        (("behaviour.trajectory_2.t0_step",), False),
    ]
    assert [(change.safe, change.unsafe) for change in changes] == [((10,), (12,)), ((200,), (210,))]
    assert change_words(URBAN, safe, unsafe, changes) == "a person is reported from 1.2 s instead of 1.0 s"


def test_without_a_record_every_difference_may_matter() -> None:
    safe, unsafe = drive(report("person", 80, 189), NONE), drive(report("person", 90, 189), NONE)
    safe, unsafe = (SimulatedSolution(vectors=one.vectors) for one in (safe, unsafe))
    rows = [URBAN.space.join(tuple(one.vectors)) for one in (safe, unsafe)]
    changes = changes_between(URBAN, safe, unsafe, Steps(URBAN.space).differing(*rows))
    assert [change.active for change in changes] == [None]
    assert change_words(URBAN, safe, unsafe, changes) == "a person is reported from 9.0 s instead of 8.0 s"


def test_a_problem_without_words_shows_values_with_units() -> None:
    problem = Mtq(Mtq.params_type())
    safe, unsafe = (
        SimulatedSolution(vectors=problem.space.split(np.array(row))) for row in ((0.25, 0.5), (0.25001, 0.5))
    )
    changes = changes_between(problem, safe, unsafe, [(0,)])
    name = problem.space.column_names()[0]
    assert change_words(problem, safe, unsafe, changes) == f"{name} 0.25 -> 0.25001"


@pytest.mark.parametrize(
    ("first", "second", "expected"),
    [
        (12.3, 12.5, ("12.3", "12.5")),
        (0.123456, 0.123457, ("0.123456", "0.123457")),
        (1234.56, 1300.0, ("1235", "1300")),
        (7, 1234567, ("7", "1234567")),
        ("rain", "fog", ("rain", "fog")),
        (1.0, 1.0 + 2**-50, ("1.0", "1.0000000000000009")),
    ],
)
def test_values_are_shown_in_digits_that_tell_them_apart(
    first: Any, second: Any, expected: tuple[str, str]
) -> None:
    assert different(first, second) == expected


@pytest.mark.parametrize(
    ("changed", "expected"),
    [
        ({"perturbation": {"intensity_2": 0.2}}, "Perturbation 2 is snow 1/5 instead of none"),
        (
            {"perturbation": {"gene_1": "contrast"}},
            "The perturbation is contrast 5/10 instead of brightness 5/10",
        ),
        (
            {"scenario": {"time_of_day": "night", "crossing_m": 50.25}},
            "At night instead of noon; the pedestrian crosses after 50.2 m instead of 50.1 m",
        ),
    ],
)
def test_a_perturbed_picture_changes_by_the_level_of_a_perturbation(
    changed: dict[str, dict[str, Any]], expected: str
) -> None:
    problem = AebCrossing(AebCrossing.params_type())
    candidate = {
        "scenario": {
            "time_of_day": "noon",
            "weather": "clear",
            "occluder": "van",
            "crossing_m": 50.125,
            "arrival_s": 0.0,
            "oncoming_m": 60.0,
        },
        "perturbation": {"gene_1": "brightness", "intensity_1": 0.5, "gene_2": "snow", "intensity_2": 0.0},
    }
    other = {name: {**values, **changed.get(name, {})} for name, values in candidate.items()}
    safe, unsafe = (SimulatedSolution(vectors=problem.space.encode(one)) for one in (candidate, other))
    rows = [problem.space.join(tuple(one.vectors)) for one in (safe, unsafe)]
    changes = changes_between(problem, safe, unsafe, Steps(problem.space).differing(*rows))
    assert as_sentence(change_words(problem, safe, unsafe, changes)) == expected


@pytest.mark.parametrize(
    ("safe", "unsafe", "common"),
    [
        ("town road, night; no errors", "town road, night; person missed", "town road, night"),
        ("snow 1/5, then rain 2/5; noon, dry", "snow 1/5, then rain 3/5; noon, dry", "snow 1/5; noon, dry"),
        ("rain 2/5, then snow 1/5; noon, dry", "snow 1/5, then dirty 2/5; noon, wet", "snow 1/5"),
        ("rain 2/5; noon, dry", "snow 1/5; noon, wet", ""),
        ("smoke 8/10; noon, dry", "smoke 8/10, then rain 2/5; noon, wet", "smoke 8/10"),
        ("rain 2/5; noon", "snow 1/5, then rain 2/5; noon", "rain 2/5; noon"),
    ],
)
def test_what_both_sides_of_a_pair_share_is_told(safe: str, unsafe: str, common: str) -> None:
    assert common_words(safe, unsafe) == common
