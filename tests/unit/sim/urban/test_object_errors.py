"""Episodes in which a list of objects has errors, and what each error does to the objects."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, ClassVar

import pytest

from brink.search.parameters import Categorical
from brink.server.problems.catalogue import make_problem
from brink.sim import catalogue
from brink.sim.driving_systems import Decision, Observation, SeenObject, Start
from brink.sim.driving_systems.option import DRIVING_SYSTEMS, DrivingOption
from brink.sim.episode import EpisodeResult, EpisodeSpec, Json, JsonObject
from brink.sim.trace import Trace
from brink.sim.urban.detection_errors import MAGNITUDES, ErrorType
from brink.sim.urban.simulator import BrinkDriveErrors

STREET: JsonObject = {
    "time_of_day": "noon",
    "weather": "clear",
    "pedestrians": 0,
    "road_curve": "straight",
    "road_id": 0,
    "road_length": 0,
    "driving_task": "follow_road",
}
SPEC = EpisodeSpec(
    simulator="brink-drive-errors@2",
    scenario=STREET,
    behaviour={"mode": "errors", "on": "objects", "errors": []},
    requirements=("no-collision@1",),
    seed=3,
    duration_s=2.0,
)
LEAD = 0


class Watches:
    """Stands, and keeps what it gets."""

    needs: ClassVar[str] = "objects"
    seen: ClassVar[list[tuple[SeenObject, ...]]] = []

    def __init__(self, start: Start) -> None:
        type(self).seen = []

    def step(self, observation: Observation) -> Decision:
        assert observation.boxes is None
        if observation.objects is not None:
            self.seen.append(observation.objects)
        return Decision(accel_mps2=-1.0, steer_rad=0.0)


@pytest.fixture
def watched(monkeypatch: pytest.MonkeyPatch) -> Callable[..., list[dict[int, SeenObject]]]:
    """Drives with an error of the lead, and returns the reported objects of each report by their numbers."""
    load = catalogue.load_plugin
    monkeypatch.setattr(
        "brink.sim.driving_systems.option.load_plugin",
        lambda group, name: Watches if (group, name) == (DRIVING_SYSTEMS, "watches") else load(group, name),
    )

    def drive(*errors: JsonObject) -> list[dict[int, SeenObject]]:
        drive_with(*errors, system="watches")
        return [{one.id: one for one in objects} for objects in Watches.seen]

    return drive


def drive_with(*errors: JsonObject, system: str = "modular@1", **changes: Any) -> EpisodeResult:
    behaviour = changes.pop("behaviour", SPEC.behaviour)
    spec = replace(SPEC, behaviour={**behaviour, "errors": list(errors)}, **changes)
    return BrinkDriveErrors().run(
        replace(spec, options=DrivingOption(system=system).to_options()), record=True
    )


def wrong(kind: ErrorType, magnitude: float) -> JsonObject:
    scale = MAGNITUDES[kind]
    error: dict[str, Json] = {"type": kind.value, "target": "lead", "magnitude": magnitude}
    error |= {"onset": "time", "onset_s": 0.5} if scale.has_window else {}
    return error | ({"duration_s": 2.0} if scale.has_duration else {})


def differences(
    kind: ErrorType, magnitude: float, watched: Callable[..., list[dict[int, SeenObject]]]
) -> list[tuple[SeenObject, SeenObject]]:
    """Return the true and the reported lead in each report in which the error acts."""
    truth, reported = watched(), watched(wrong(kind, magnitude))
    assert len(truth) == len(reported) > 15
    pairs = [(old[LEAD], new[LEAD]) for old, new in zip(truth, reported, strict=True)]
    assert all(old == new for old, new in pairs[:5])
    return pairs[5:]


def test_objects_are_the_truth_in_the_egos_frame(watched: Callable[..., Any]) -> None:
    lead = watched()[-1][LEAD]
    assert lead.existence == 1.0
    assert (lead.length_m, lead.yaw_rad) == pytest.approx((4.5, 0.0), abs=0.1)
    assert lead.y_m == pytest.approx(0.0, abs=0.3)
    assert lead.vx_mps > 2.0


EXPECTED: dict[ErrorType, tuple[float, Callable[[SeenObject, SeenObject], bool]]] = {
    ErrorType.LEFT: (1.0, lambda old, new: abs(new.y_m - old.y_m - 1.0) < 1e-6 and new.vx_mps == old.vx_mps),
    ErrorType.RIGHT: (1.0, lambda old, new: abs(new.y_m - old.y_m + 1.0) < 1e-6),
    ErrorType.TOO_FAR: (
        0.5,
        lambda old, new: new.x_m > 1.2 * old.x_m and abs(new.y_m) < 2.0 * abs(old.y_m) + 0.1,
    ),
    ErrorType.TOO_NEAR: (0.5, lambda old, new: 0.0 < new.x_m < 0.9 * old.x_m),
    ErrorType.TOO_LARGE: (0.5, lambda old, new: new.width_m == 1.5 * old.width_m),
    ErrorType.TOO_SMALL: (0.5, lambda old, new: new.length_m == 0.5 * old.length_m),
    ErrorType.WRONG_LABEL: (2.0, lambda old, new: new.label != old.label and new[2:] == old[2:]),
    ErrorType.TOO_FAST: (3.0, lambda old, new: math.isclose(new.vx_mps - old.vx_mps, 3.0, abs_tol=0.05)),
    ErrorType.TOO_SLOW: (3.0, lambda old, new: math.isclose(new.vx_mps - old.vx_mps, -3.0, abs_tol=0.05)),
    ErrorType.STALE: (0.3, lambda old, new: -4.0 < new.x_m - old.x_m < -0.5),
    ErrorType.UNSURE: (
        0.7,
        lambda old, new: new[:2] + new[3:] == old[:2] + old[3:] and math.isclose(new.existence, 0.3),
    ),
    ErrorType.NOISE: (0.2, lambda old, new: new[5:] == old[5:] and 0.0 < abs(new.x_m - old.x_m) < 20.0),
}


@pytest.mark.parametrize("kind", EXPECTED)
def test_error_changes_the_lead_as_it_says(kind: ErrorType, watched: Callable[..., Any]) -> None:
    magnitude, is_right = EXPECTED[kind]
    pairs = differences(kind, magnitude, watched)
    assert [(old, new) for old, new in pairs if not is_right(old, new)] == []


def test_nobody_is_reported_while_missed_and_each_report_has_another_number(
    watched: Callable[..., Any],
) -> None:
    assert [LEAD in one for one in watched(wrong(ErrorType.MISS, 2.0))[4:6]] == [True, False]
    numbers = [set(one) for one in watched(wrong(ErrorType.NEW_ID, 2.0))]
    new = [max(one) for one in numbers[5:]]
    assert len(set(new)) == len(new)
    assert not any(LEAD in one for one in numbers[5:])


def test_ghosts_stand_on_the_road_or_move_with_the_ego(watched: Callable[..., Any]) -> None:
    stands = [one[1_000] for one in watched(wrong(ErrorType.GHOST_ON_ROAD, 2.0))[5:]]
    follows = [one[1_000] for one in watched(wrong(ErrorType.GHOST_IN_IMAGE, 2.0))[5:]]
    assert stands[0].x_m - stands[-1].x_m > 2.0
    assert {(one.vx_mps, one.vy_mps) for one in stands} == {(0.0, 0.0)}
    assert max(abs(one.x_m - follows[0].x_m) for one in follows) < 0.5


def test_brinks_own_system_and_pictures_see_the_same_errors_as_boxes() -> None:
    plain, hidden = drive_with(), drive_with(wrong(ErrorType.MISS, 2.0))
    assert plain.trace is not None
    assert hidden.trace is not None
    seen, given = (
        [len(boxes.at(step)) for step in range(19)]
        for boxes in (Trace.from_bytes(hidden.trace).seen_boxes, Trace.from_bytes(hidden.trace).given_boxes)
    )
    assert [old - new for old, new in zip(seen, given, strict=True)] == [0] * 5 + [1] * 14
    trace = Trace.from_bytes(plain.trace)
    assert (trace.seen_boxes.rows == trace.given_boxes.rows).all()
    assert hidden.features["error_steps"] == [[5, 19]]


def test_without_errors_brinks_own_system_drives_as_with_true_boxes() -> None:
    on_objects = drive_with(duration_s=8.0)
    on_boxes = drive_with(duration_s=8.0, behaviour={"mode": "errors"})
    assert on_objects.features == on_boxes.features
    assert on_objects.verdicts == on_boxes.verdicts


def test_problem_on_objects_has_more_types_and_says_so() -> None:
    boxes, objects = (make_problem("urban-errors@1", {"errors_on": on}) for on in ("boxes", "objects"))
    for problem, kinds in ((boxes, 13), (objects, 19)):
        kind = problem.space.parameters[list(problem.space.column_names()).index("behaviour.error_1.type")]
        assert isinstance(kind, Categorical)
        assert len(kind.choices) == 1 + kinds
    assert "list of objects" in objects.about_component
