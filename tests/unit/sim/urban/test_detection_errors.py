"""Episodes in which the obstacle detector reports the truth with errors, and what each error does to the boxes."""

import io
import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
from support.marks import mostly_long

from brink.server.problems.urban_injected import UrbanInjected, UrbanInjectedParams
from brink.sim.catalogue import requirement_ids
from brink.sim.driving.camera import Camera, Solid
from brink.sim.driving.interface import Box, ObstacleLabel
from brink.sim.episode import EpisodeResult, EpisodeSpec, Json, JsonObject
from brink.sim.errors import InvalidEpisode
from brink.sim.trace import FloatArray, Trace
from brink.sim.urban.detection_errors import (
    BOX_TYPES,
    MAGNITUDES,
    MAX_ERRORS,
    DetectionError,
    ErrorType,
    Onset,
    Target,
    errors_from_json,
)
from brink.sim.urban.simulator import BrinkDrive, BrinkDriveErrors
from brink.sim.world.pedestrians import PERSON_HEIGHT_M, PERSON_WIDTH_M
from brink.sim.world.vehicle import CAR, VAN

CAMERA = Camera()
DURATION_S = 8.0
SCENARIO: JsonObject = {
    "time_of_day": "noon",
    "weather": "clear",
    "pedestrians": 18,
    "road_curve": "straight",
    "road_id": 0,
    "road_length": 0,
    "driving_task": "follow_road",
}
STRAIGHT = EpisodeSpec(
    simulator="brink-drive-errors@2",
    scenario=SCENARIO,
    behaviour={"mode": "errors", "errors": []},
    requirements=("front-gap@1", "no-collision@1"),
    seed=3,
    duration_s=DURATION_S,
)
"""The lead, two oncoming cars and 18 pedestrians on a straight road, where y is the distance to its middle."""
LEVEL = replace(STRAIGHT, options={"pitch": False})
"""The same with a camera that stays level, in which errors act."""
RAIN = replace(STRAIGHT, scenario={**SCENARIO, "weather": "hard_rain"}, seed=29)
"""As before, but two pedestrians step onto the road ahead."""
CROSSROAD = replace(STRAIGHT, scenario={**SCENARIO, "road_curve": "crossroad"})
LABEL, X_MIN, X_MAX, Y_MIN, Y_MAX = range(5)
KERB_M = 3.5
"""Distance of the kerbs from the middle of the road."""
BEGINS, ENDS = 10, 30
"""The steps at which most windows here begin and end."""


class Drive(NamedTuple):
    """A recorded episode."""

    result: EpisodeResult
    trace: Trace

    @property
    def steps(self) -> range:
        """All perception steps; the trace's last sample repeats the boxes of the last one."""
        return range(len(self.trace.time_s) - 1)

    def seen(self, step: int) -> FloatArray:
        return self.trace.seen_boxes.at(step)

    def given(self, step: int) -> FloatArray:
        return self.trace.given_boxes.at(step)

    def pitch_rad(self, step: int) -> float:
        assert self.trace.pitch_rad is not None
        return float(self.trace.pitch_rad[step])

    def level_boxes(self, step: int) -> dict[str, Box]:
        """Return the boxes of all road users in the image of a level camera, hidden or not, by name."""
        x_m, y_m, yaw_rad = map(float, self.trace.ego[step, :3])
        boxes = {}
        for actor in self.trace.actors:
            person = actor.kind == "pedestrian"
            height_m = PERSON_HEIGHT_M if person else (VAN if actor.length_m > CAR.length_m else CAR).height_m
            label = ObstacleLabel.PERSON if person else ObstacleLabel.VEHICLE
            x, y, yaw = map(float, actor.motion[step, :3])
            found = CAMERA.project(
                x_m, y_m, yaw_rad, Solid(label, x, y, yaw, actor.length_m, actor.width_m, height_m)
            )
            if found is not None:
                boxes[actor.name] = found[0]
        return boxes

    @property
    def changed(self) -> list[int]:
        """The steps at which the reported boxes are not the true ones."""
        return [step for step in self.steps if not np.array_equal(self.seen(step), self.given(step))]

    def names(self, step: int) -> list[str]:
        """Return the road users whose boxes are visible at a step, identified by their positions."""
        boxes = {}
        for name, level in self.level_boxes(step).items():
            box = CAMERA.tilted(level, self.pitch_rad(step))
            if box is not None:
                boxes[name] = np.array([float(box.label is ObstacleLabel.PERSON), *box[1:]])
        names = []
        for row in self.seen(step):
            away = {name: float(np.abs(box - row).max()) for name, box in boxes.items()}
            nearest = min(away, key=lambda name: away[name])
            assert away[nearest] < 0.01
            names.append(nearest)
        return names

    def kind(self, name: str, step: int) -> str:
        """Return the kind of a road user, by its heading relative to the ego's."""
        (actor,) = [one for one in self.trace.actors if one.name == name]
        if actor.kind == "pedestrian":
            return "pedestrian"
        turn_rad = float(actor.motion[step, 2] - self.trace.ego[step, 2])
        turn_deg = abs(math.degrees(math.remainder(turn_rad, math.tau)))
        return "lead" if turn_deg <= 45 else "oncoming" if turn_deg >= 135 else "crossing"

    def motion(self, name: str) -> FloatArray:
        (actor,) = [one for one in self.trace.actors if one.name == name]
        return actor.motion


def error(kind: str, magnitude: float, target: str = "lead", **window: Json) -> JsonObject:
    """Return an error that, unless said otherwise, lasts from `BEGINS` to `ENDS` if its type has a duration."""
    scale = MAGNITUDES[ErrorType(kind)]
    document: JsonObject = {"type": kind, "target": target, "magnitude": magnitude}
    if scale.has_window:
        document |= {"onset": "time", "onset_s": 0.1 * BEGINS}
    if scale.has_duration:
        document["duration_s"] = 0.1 * (ENDS - BEGINS)
    return {**document, **window}


def with_errors(spec: EpisodeSpec, *errors: JsonObject) -> EpisodeSpec:
    return replace(spec, simulator="brink-drive-errors@2", behaviour={"mode": "errors", "errors": [*errors]})


@pytest.fixture(name="simulator", scope="module")
def _simulator() -> BrinkDriveErrors:
    return BrinkDriveErrors()


@pytest.fixture(name="drive", scope="module")
def _drive(simulator: BrinkDriveErrors) -> Callable[..., Drive]:
    """Run and record an episode with errors, and check that the result says at which steps they acted."""

    def run(*errors: JsonObject, spec: EpisodeSpec = STRAIGHT) -> Drive:
        result = simulator.run(with_errors(spec, *errors), record=True)
        assert result.trace is not None
        found = Drive(result, Trace.from_bytes(result.trace))
        if len(errors) == 1:
            changed = found.changed
            assert changed, "the error never acted"
            assert result.features["error_steps"] == [[changed[0], changed[-1]]]
            (parsed,) = errors_from_json({"mode": "errors", "errors": [*errors]}, spec.duration_s)
            assert result.features["severity"] == parsed.severity > 0
        return found

    return run


def assert_hidden(drive: Drive, is_hidden: Callable[[int, str, FloatArray], bool]) -> None:
    """Check that the boxes that should be hidden are not reported, and all others are, unchanged and in order."""
    for step in drive.steps:
        seen = drive.seen(step)
        hidden = [is_hidden(step, name, row) for name, row in zip(drive.names(step), seen, strict=True)]
        assert np.array_equal(drive.given(step), seen[~np.array(hidden, dtype=np.bool_)]), step


def edited(
    drive: Drive, is_target: Callable[[int, str], bool], steps: range = range(BEGINS, ENDS)
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Return each target's true and reported boxes at the given steps, and check that all else is as it was."""
    count = 0
    for step in drive.steps:
        seen, given = drive.seen(step), drive.given(step)
        assert seen.shape == given.shape, step
        for name, true, reported in zip(drive.names(step), seen, given, strict=True):
            if step in steps and is_target(step, name):
                count += 1
                yield true, reported
            else:
                assert np.array_equal(true, reported), (step, name)
    assert count >= len(steps)


def is_lead(step: int, name: str) -> bool:
    return name == "lead"


def depth_m(row: FloatArray) -> float:
    found = CAMERA.ground_depth_m(float(row[Y_MAX]))
    assert found is not None
    return found


def scene_of(result: EpisodeResult) -> tuple[JsonObject, dict[str, bytes]]:
    """Return the verdicts and features of an episode, and all arrays of its trace, without what errors add."""
    assert result.trace is not None
    with np.load(io.BytesIO(result.trace), allow_pickle=False) as npz:
        arrays = {
            name: repr((npz[name].dtype, npz[name].shape)).encode() + npz[name].tobytes()
            for name in npz.files
            if name != "header"
        }
    said: JsonObject = {
        name: value for name, value in result.features.items() if name not in ("error_steps", "severity")
    }
    verdicts: JsonObject = {name: repr(verdict) for name, verdict in result.verdicts.items()}
    return {**said, **verdicts}, arrays


NOTHING: list[JsonObject] = [
    error(kind.value, scale.none, target.value, **({"onset_s": 0.0} if scale.has_window else {}))
    for kind, target in zip(BOX_TYPES, [*Target, *Target, *Target], strict=False)
    for scale in [MAGNITUDES[kind]]
]
"""An error of severity 0 of each type."""


@pytest.mark.parametrize("number", mostly_long(range(12), range(2), "further random scenarios"))
def test_errors_of_no_severity_change_nothing(simulator: BrinkDriveErrors, number: int) -> None:
    problem = UrbanInjected(UrbanInjectedParams(duration_s=12.0))
    spec = problem.episode(problem.space.sample(np.random.default_rng([31, number])), number)
    spec = replace(spec, behaviour={"mode": "oracle"}, requirements=requirement_ids(), options={})
    truth = BrinkDrive().run(spec, record=True)
    assert "error_steps" not in truth.features
    for errors in ([], NOTHING[:MAX_ERRORS], NOTHING[MAX_ERRORS:]):
        result = simulator.run(with_errors(spec, *errors), record=True)
        assert scene_of(result) == scene_of(truth)
        assert result.features["error_steps"] == [None] * len(errors)
        assert result.features["severity"] == 0.0


def test_an_episode_is_bit_identical_regardless_of_earlier_ones(simulator: BrinkDriveErrors) -> None:
    errors = [
        error("flicker", 0.4, "everybody"),
        error("late", 1.0, "oncoming"),
        error("ghost_on_road", 2.0, "pedestrian"),
        error("miss", 3.0, onset="lead_brakes"),
    ]
    spec = with_errors(STRAIGHT, *errors)
    first = simulator.run(spec, record=True)
    simulator.run(with_errors(RAIN, error("miss", 8.0, "everybody", onset_s=0.0)), record=True)
    for again in (simulator, BrinkDriveErrors()):
        result = again.run(spec, record=True)
        assert result.trace == first.trace
        assert result.verdicts == first.verdicts
        assert result.features == first.features


def test_an_error_changes_what_the_ego_does(drive: Callable[..., Drive]) -> None:
    blind = drive(error("miss", 8.0, "everybody", onset_s=0.0), spec=RAIN)
    assert not np.array_equal(blind.trace.ego, drive(spec=RAIN).trace.ego)
    assert [len(blind.given(step)) for step in blind.steps] == [0] * len(blind.steps)
    assert len(blind.trace.perceived.rows) == 0


@pytest.mark.parametrize("duration_s", [0.5, 1.3, 2.0])
def test_a_missed_lead_is_hidden_for_the_duration_and_nothing_else_is(
    drive: Callable[..., Drive], duration_s: float
) -> None:
    found = drive(error("miss", duration_s))
    steps = range(BEGINS, BEGINS + round(10 * duration_s))
    assert found.changed == list(steps)
    assert_hidden(found, lambda step, name, row: name == "lead" and step in steps)


def test_a_window_between_two_steps_begins_at_the_later_one(drive: Callable[..., Drive]) -> None:
    assert drive(error("miss", 0.5, onset_s=1.02)).changed == list(range(11, 16))


@pytest.mark.parametrize(
    ("target", "spec", "begins", "names"),
    [
        ("oncoming", STRAIGHT, BEGINS, {"oncoming-1", "oncoming-2"}),
        # Buildings hide the crossing cars at first.
        ("crossing", CROSSROAD, 25, {"crossing-1", "crossing-2"}),
    ],
    ids=["oncoming", "crossing"],
)
def test_a_group_is_missed_as_a_whole(
    drive: Callable[..., Drive], target: str, spec: EpisodeSpec, begins: int, names: set[str]
) -> None:
    found = drive(error("miss", 2.0, target, onset_s=0.1 * begins), spec=spec)
    hidden = set()

    def is_hidden(step: int, name: str, row: FloatArray) -> bool:
        if step not in range(begins, begins + 20) or found.kind(name, step) != target:
            return False
        hidden.add(name)
        return True

    assert_hidden(found, is_hidden)
    assert hidden == names


def test_late_withholds_everybody_from_first_sight(drive: Callable[..., Drive]) -> None:
    found = drive(error("late", 1.5, "everybody"))
    first: dict[str, int] = {}

    def is_hidden(step: int, name: str, row: FloatArray) -> bool:
        return step - first.setdefault(name, step) < 15

    assert_hidden(found, is_hidden)
    assert any(step > 0 for step in first.values()), "nobody came into view during the drive"
    assert found.changed[:15] == list(range(15))


@pytest.mark.parametrize("share", [0.1, 0.3, 0.5, 1.0])
def test_flicker_hides_the_share_of_each_period(drive: Callable[..., Drive], share: float) -> None:
    found = drive(error("flicker", share, duration_s=4.0))
    periods = [range(BEGINS, BEGINS + 20), range(BEGINS + 20, BEGINS + 40)]
    changed = set(found.changed)
    assert [len(changed.intersection(period)) for period in periods] == [round(20 * share)] * 2
    assert changed <= {step for period in periods for step in period}
    assert_hidden(found, lambda step, name, row: name == "lead" and step in changed)


@pytest.mark.parametrize(
    ("kind", "share", "factor"),
    [("too_far", 0.2, 1.2), ("too_far", 1.0, 2.0), ("too_near", 0.2, 0.8), ("too_near", 0.8, 0.2)],
)
def test_the_bottom_edge_is_at_the_wrong_distance_and_nothing_else_changes(
    drive: Callable[..., Drive], kind: str, share: float, factor: float
) -> None:
    for true, reported in edited(drive(error(kind, share), spec=LEVEL), is_lead):
        assert depth_m(reported) == pytest.approx(factor * depth_m(true), rel=1e-4)
        assert np.array_equal(reported[:Y_MAX], true[:Y_MAX])


@pytest.mark.parametrize(("kind", "left_m"), [("left", 0.4), ("left", 3.0), ("right", -0.4), ("right", -3.0)])
def test_a_box_is_moved_aside_by_metres_at_its_distance(
    drive: Callable[..., Drive], kind: str, left_m: float
) -> None:
    for true, reported in edited(drive(error(kind, abs(left_m)), spec=LEVEL), is_lead):
        for edge in (X_MIN, X_MAX):
            was_m, is_m = (CAMERA.left_m(float(row[edge]), depth_m(true)) for row in (true, reported))
            assert is_m - was_m == pytest.approx(left_m, abs=1e-3)
        assert np.array_equal(reported[[LABEL, Y_MIN, Y_MAX]], true[[LABEL, Y_MIN, Y_MAX]])


def test_what_is_moved_out_of_the_image_is_not_reported(drive: Callable[..., Drive]) -> None:
    found = drive(error("right", 4.0, "everybody"), spec=LEVEL)
    gone = 0
    for step in range(BEGINS, ENDS):
        seen, given = found.seen(step), found.given(step)
        shifts = np.array([4.0 * CAMERA.focal_px / depth_m(row) for row in seen])
        inside = seen[:, X_MIN] + shifts < CAMERA.width_px - 1
        gone += int((~inside).sum())
        moved = np.clip(seen[inside, X_MIN : X_MAX + 1] + shifts[inside, None], 0, CAMERA.width_px)
        np.testing.assert_allclose(given[:, X_MIN : X_MAX + 1], moved, atol=1e-3)
    assert gone


@pytest.mark.parametrize(
    ("kind", "share", "factor"),
    [("too_large", 0.3, 1.3), ("too_large", 1.0, 2.0), ("too_small", 0.3, 0.7), ("too_small", 0.8, 0.2)],
)
def test_a_box_is_scaled_about_its_centre(
    drive: Callable[..., Drive], kind: str, share: float, factor: float
) -> None:
    for true, reported in edited(drive(error(kind, share), spec=LEVEL), is_lead):
        assert reported[LABEL] == true[LABEL]
        for low, high in ((X_MIN, X_MAX), (Y_MIN, Y_MAX)):
            assert reported[low] + reported[high] == pytest.approx(true[low] + true[high], abs=1e-3)
            assert reported[high] - reported[low] == pytest.approx(
                factor * (true[high] - true[low]), abs=1e-3
            )


@pytest.mark.parametrize(
    ("kind", "magnitude"),
    [
        ("too_far", 0.5),
        ("too_near", 0.5),
        ("left", 1.0),
        ("right", 1.0),
        ("too_large", 0.3),
        ("too_small", 0.3),
    ],
)
def test_errors_act_in_a_level_camera_and_their_boxes_pitch_with_the_car(
    drive: Callable[..., Drive], kind: str, magnitude: float
) -> None:
    edits: dict[str, Callable[[Box], Box]] = {
        "too_far": lambda box: at_distance(box, 1.0 + magnitude),
        "too_near": lambda box: at_distance(box, 1.0 - magnitude),
        "left": lambda box: moved_left(box, magnitude),
        "right": lambda box: moved_left(box, -magnitude),
        "too_large": lambda box: scaled(box, 1.0 + magnitude),
        "too_small": lambda box: scaled(box, 1.0 - magnitude),
    }
    found = drive(error(kind, magnitude))
    pitches_rad = []
    for step in range(BEGINS, ENDS):
        (place,) = [number for number, name in enumerate(found.names(step)) if name == "lead"]
        pitches_rad.append(found.pitch_rad(step))
        expected = CAMERA.tilted(edits[kind](found.level_boxes(step)["lead"]), pitches_rad[-1])
        assert expected is not None
        assert found.given(step)[place, X_MIN:] == pytest.approx(np.array(expected[X_MIN:], float), abs=0.02)
    assert np.ptp(pitches_rad) > math.radians(0.2), "the car hardly pitches"


def at_distance(box: Box, factor: float) -> Box:
    return box._replace(y_max_px=CAMERA.horizon_px + (box.y_max_px - CAMERA.horizon_px) / factor)


def moved_left(box: Box, left_m: float) -> Box:
    ground_m = CAMERA.ground_depth_m(box.y_max_px)
    assert ground_m is not None
    shift_px = left_m * CAMERA.focal_px / ground_m
    return box._replace(x_min_px=box.x_min_px - shift_px, x_max_px=box.x_max_px - shift_px)


def scaled(box: Box, factor: float) -> Box:
    middle_x, middle_y = 0.5 * (box.x_min_px + box.x_max_px), 0.5 * (box.y_min_px + box.y_max_px)
    sides = (middle_x + factor * (x - middle_x) for x in (box.x_min_px, box.x_max_px))
    ends = (middle_y + factor * (y - middle_y) for y in (box.y_min_px, box.y_max_px))
    return Box(box.label, *sides, *ends)


def test_vehicles_and_persons_are_mistaken_for_each_other(drive: Callable[..., Drive]) -> None:
    labels = set()
    for true, reported in edited(drive(error("wrong_label", 2.0, "everybody")), lambda step, name: True):
        assert reported[LABEL] == 1 - true[LABEL]
        assert np.array_equal(reported[X_MIN:], true[X_MIN:])
        labels.add(float(true[LABEL]))
    assert labels == {0.0, 1.0}


@pytest.mark.parametrize(("target", "range_m"), [("everybody", 25.0), ("lead", 30.0), ("pedestrian", 0.0)])
def test_a_short_range_hides_what_is_farther_away(
    drive: Callable[..., Drive], target: str, range_m: float
) -> None:
    found = drive(error("short_range", range_m, target), spec=LEVEL)
    counts = [0, 0]

    def is_hidden(step: int, name: str, row: FloatArray) -> bool:
        if target not in ("everybody", found.kind(name, step)):
            return False
        hidden = depth_m(row) > range_m
        counts[hidden] += 1
        return hidden

    assert_hidden(found, is_hidden)
    assert counts[True]
    assert counts[False] or range_m == 0.0


def ghosts_of(drive: Drive) -> list[FloatArray]:
    """Return the ghosts at each step, and check that the true boxes are reported before them, unchanged."""
    ghosts = []
    for step in drive.steps:
        seen, given = drive.seen(step), drive.given(step)
        assert np.array_equal(given[: len(seen)], seen)
        ghosts.append(given[len(seen) :])
    return ghosts


@pytest.mark.parametrize("kind", ["ghost_on_road", "ghost_in_image"])
@pytest.mark.parametrize(
    ("target", "labels", "half_length_m", "left_m"),
    [
        ("lead", [0], 0.5 * CAR.length_m, 0.0),
        ("oncoming", [0], 0.5 * CAR.length_m, 3.5),
        ("crossing", [0], 0.5 * CAR.width_m, 0.0),
        ("pedestrian", [1], 0.5 * PERSON_WIDTH_M, 0.0),
        ("everybody", [0, 1], 0.5 * CAR.length_m, 0.0),
    ],
)
def test_a_ghost_appears_ahead_for_the_duration(
    drive: Callable[..., Drive],
    kind: str,
    target: str,
    labels: list[int],
    half_length_m: float,
    left_m: float,
) -> None:
    found = drive(error(kind, 2.0, target), spec=LEVEL)
    ghosts = ghosts_of(found)
    assert [step for step, rows in enumerate(ghosts) if len(rows)] == list(range(BEGINS, ENDS))
    first = ghosts[BEGINS]
    assert first[:, LABEL].tolist() == labels
    assert depth_m(first[0]) == pytest.approx(15.0 - CAMERA.forward_m - half_length_m, abs=0.1)
    lane_m = float(found.trace.route[0, 1] - found.trace.ego[BEGINS, 1])
    sides_m = [CAMERA.left_m(float(first[0, edge]), depth_m(first[0])) for edge in (X_MIN, X_MAX)]
    if left_m:  # beside the optical axis, the far end of the car bounds its box on the right
        assert sides_m[0] == pytest.approx(left_m + lane_m + 0.5 * CAR.width_m, abs=0.1)
    else:
        assert sum(sides_m) / 2 == pytest.approx(lane_m, abs=0.1)


def test_a_ghost_in_the_image_stays_there_while_the_ego_moves(drive: Callable[..., Drive]) -> None:
    found = drive(error("ghost_in_image", 2.0))
    assert np.ptp(found.trace.ego[BEGINS:ENDS, 0]) > 3.0
    ghosts = ghosts_of(found)[BEGINS:ENDS]
    assert all(np.array_equal(rows, ghosts[0]) for rows in ghosts)


def test_a_ghost_on_the_road_stays_there_while_the_ego_moves(drive: Callable[..., Drive]) -> None:
    found = drive(error("ghost_on_road", 2.0), spec=LEVEL)
    places, depths = [], []
    for step, rows in enumerate(ghosts_of(found)[:ENDS]):
        for row in rows:
            x_m, y_m, yaw_rad, *_ = map(float, found.trace.ego[step])
            ahead_m = CAMERA.forward_m + depth_m(row)
            left_m = sum(CAMERA.left_m(float(row[edge]), depth_m(row)) for edge in (X_MIN, X_MAX)) / 2
            depths.append(depth_m(row))
            places.append(
                (
                    x_m + ahead_m * math.cos(yaw_rad) - left_m * math.sin(yaw_rad),
                    y_m + ahead_m * math.sin(yaw_rad) + left_m * math.cos(yaw_rad),
                )
            )
    assert len(places) == ENDS - BEGINS
    assert depths[0] - depths[-1] > 3.0
    assert np.ptp(places, axis=0).max() < 0.1


@pytest.mark.parametrize(
    ("spec", "after_s"),
    [(STRAIGHT, 0.0), (replace(RAIN, scenario={**RAIN.scenario, "pedestrians": 0}), 0.0), (STRAIGHT, 4.9)],
    ids=["hard", "gentle", "already"],
)
def test_a_window_begins_when_the_lead_brakes(
    drive: Callable[..., Drive], spec: EpisodeSpec, after_s: float
) -> None:
    found = drive(error("too_far", 0.3, onset="lead_brakes", onset_s=after_s, duration_s=1.0), spec=spec)
    losses = -np.diff(found.motion("lead")[:, 3])
    begins = next(step for step in found.steps[1:] if step >= 10 * after_s and losses[step - 1] > 1.5 * 0.1)
    assert begins > 40
    list(edited(found, is_lead, range(begins, begins + 10)))
    assert found.changed == list(range(begins, begins + 10))


@pytest.mark.parametrize(
    ("target", "after_s"), [("pedestrian", 0.0), ("pedestrian", 4.0), ("lead", 0.0), ("everybody", 4.0)]
)
def test_a_window_begins_when_a_pedestrian_steps_out(
    drive: Callable[..., Drive], target: str, after_s: float
) -> None:
    found = drive(error("miss", 1.0, target, onset="pedestrian_steps_out", onset_s=after_s), spec=RAIN)
    stepping = {}
    for actor in found.trace.actors:
        speeds = actor.motion[:, 3]
        if actor.kind == "pedestrian":
            for step in found.steps[1:]:
                # Pedestrians stand still at the kerb before they cross; on the road, they may wait for a vehicle.
                is_beside_road = abs(actor.motion[step, 1]) > KERB_M
                if is_beside_road and speeds[step - 1] == 0 < speeds[step] and step >= 10 * after_s:
                    stepping[step] = actor.name
    begins = min(stepping)
    hidden = {"pedestrian": {stepping[begins]}, "lead": {"lead"}}.get(target)
    window = range(begins, begins + 10)
    assert begins > BEGINS
    assert_hidden(found, lambda step, name, row: step in window and (hidden is None or name in hidden))
    assert found.changed == list(window)


def test_a_window_waits_until_there_is_a_pedestrian_near_the_lane(drive: Callable[..., Drive]) -> None:
    found = drive(error("miss", 1.0, "pedestrian", onset_s=2.0), spec=RAIN)
    lane_y_m = float(found.trace.route[0, 1])
    near = [
        (step, name)
        for step in found.steps[20:]
        for name in found.names(step)
        if found.kind(name, step) == "pedestrian" and abs(found.motion(name)[step, 1] - lane_y_m) < 3.0
    ]
    begins, target = near[0]
    assert begins > 20, "there was a target at once"
    window = range(begins, begins + 10)
    assert_hidden(found, lambda step, name, row: step in window and name == target)
    assert found.changed == list(window)


def test_without_a_target_a_window_never_opens(drive: Callable[..., Drive]) -> None:
    empty = replace(STRAIGHT, scenario={**SCENARIO, "pedestrians": 0})
    errors = [
        error("miss", 8.0, "pedestrian"),
        error("left", 4.0, "pedestrian", onset="pedestrian_steps_out"),
        error("ghost_on_road", 2.0, onset="pedestrian_steps_out"),
    ]
    found = drive(*errors, spec=empty)
    assert found.changed == []
    assert found.result.features["error_steps"] == [None, None, None]
    assert found.result.features["severity"] == 0.0


def test_the_severity_is_the_greatest_of_the_errors_that_acted(drive: Callable[..., Drive]) -> None:
    found = drive(
        error("miss", 0.8, onset_s=2.0),
        error("left", 4.0, onset="lead_brakes", onset_s=DURATION_S),
        error("too_far", 0.5, onset_s=4.0, duration_s=0.5),
        error("flicker", 1.0, duration_s=0.0),
    )
    assert found.result.features["error_steps"] == [[20, 27], None, [40, 44], None]
    assert found.result.features["severity"] == pytest.approx(0.5)


def test_errors_act_one_after_another(drive: Callable[..., Drive]) -> None:
    both = drive(error("left", 1.0), error("left", 0.5), spec=LEVEL)
    for true, reported in edited(both, is_lead):
        shift_px = (reported - true)[[X_MIN, X_MAX]]
        np.testing.assert_allclose(shift_px, -1.5 * CAMERA.focal_px / depth_m(true), atol=1e-3)
    hidden = drive(error("miss", 2.0), error("left", 1.0))
    assert hidden.result.features["error_steps"] == [[BEGINS, ENDS - 1], None]
    assert_hidden(hidden, lambda step, name, row: name == "lead" and BEGINS <= step < ENDS)


@pytest.mark.parametrize("kind", ErrorType)
def test_an_error_reads_what_it_writes(kind: ErrorType) -> None:
    scale = MAGNITUDES[kind]
    window = {"onset": Onset.LEAD_BRAKES, "onset_s": 1.5} if scale.has_window else {}
    magnitude = scale.at(0.25)
    lasts_s = {"duration_s": 2.5 if scale.has_duration else magnitude} if scale.has_window else {}
    one = DetectionError(type=kind, target=Target.ONCOMING, magnitude=magnitude, **window, **lasts_s)  # type: ignore[arg-type]
    behaviour: JsonObject = {"mode": "errors", "on": "objects", "errors": [one.to_json()]}
    assert errors_from_json(behaviour, DURATION_S) == (one,)
    del behaviour["on"]
    if kind in BOX_TYPES:
        assert errors_from_json(behaviour, DURATION_S) == (one,)
    else:
        with pytest.raises(InvalidEpisode, match=f"{kind} needs a list of objects"):
            errors_from_json(behaviour, DURATION_S)
    assert one.severity == pytest.approx(0.25)
    assert scale.severity(scale.none) == 0.0
    assert scale.severity(scale.most) == 1.0


def replaced(document: JsonObject, **changes: Json) -> JsonObject:
    """Return an error with other values, without those that are None."""
    return {name: value for name, value in {**document, **changes}.items() if value is not None}


MISS, FAR, LATE = error("miss", 1.0), error("too_far", 0.5), error("late", 1.0)
WHERE = r"behaviour\.errors\[0\]"
KINDS = ", ".join(kind.value for kind in ErrorType)


@pytest.mark.parametrize(
    ("document", "expected"),
    [
        (replaced(MISS, magnitude=8.5), rf"{WHERE}\.magnitude: expected a number in \[0, 8\] s, got 8\.5"),
        (replaced(MISS, magnitude=-0.1), rf"{WHERE}\.magnitude: expected a number in \[0, 8\] s, got -0\.1"),
        (
            replaced(MISS, magnitude=math.nan),
            rf"{WHERE}\.magnitude: expected a number in \[0, 8\] s, got nan",
        ),
        (replaced(MISS, magnitude=True), rf"{WHERE}\.magnitude: expected a number in \[0, 8\] s, got True"),
        (replaced(MISS, magnitude="1"), rf"{WHERE}\.magnitude: expected a number in \[0, 8\] s, got '1'"),
        (replaced(LATE, magnitude=9.0), rf"{WHERE}\.magnitude: expected a number in \[0, 8\] s, got 9"),
        (error("flicker", 1.1), rf"{WHERE}\.magnitude: expected a number in \[0, 1\] share, got 1\.1"),
        (error("too_far", 1.1), rf"{WHERE}\.magnitude: expected a number in \[0, 1\] share, got 1\.1"),
        (error("too_near", 0.9), rf"{WHERE}\.magnitude: expected a number in \[0, 0\.8\] share, got 0\.9"),
        (error("left", 5.0), rf"{WHERE}\.magnitude: expected a number in \[0, 4\] m, got 5"),
        (error("right", -1.0), rf"{WHERE}\.magnitude: expected a number in \[0, 4\] m, got -1"),
        (error("too_large", 2.0), rf"{WHERE}\.magnitude: expected a number in \[0, 1\] share, got 2"),
        (error("too_small", 1.0), rf"{WHERE}\.magnitude: expected a number in \[0, 0\.8\] share, got 1"),
        (error("short_range", 61.0), rf"{WHERE}\.magnitude: expected a number in \[0, 60\] m, got 61"),
        (error("wrong_label", 9.0), rf"{WHERE}\.magnitude: expected a number in \[0, 8\] s, got 9"),
        (error("ghost_on_road", 9.0), rf"{WHERE}\.magnitude: expected a number in \[0, 8\] s, got 9"),
        (error("ghost_in_image", math.inf), rf"{WHERE}\.magnitude: expected a number in \[0, 8\] s, got inf"),
        (
            replaced(MISS, type="mis"),
            rf"{WHERE}\.type: expected one of {KINDS}; got 'mis' \(did you mean 'miss'",
        ),
        (replaced(MISS, type=None), rf"{WHERE}\.type: expected one of {KINDS}; got None"),
        (replaced(MISS, type=["miss"]), rf"{WHERE}\.type: expected one of {KINDS}; got \['miss'\]"),
        (
            replaced(MISS, target="leed"),
            rf"{WHERE}\.target: expected one of lead, oncoming.* \(did you mean 'lead'",
        ),
        (replaced(MISS, target=1), rf"{WHERE}\.target: expected one of lead, oncoming, crossing.*; got 1"),
        (
            replaced(MISS, onset="never"),
            rf"{WHERE}\.onset: expected one of time, lead_brakes, .*; got 'never'",
        ),
        (replaced(MISS, onset_s=8.1), rf"{WHERE}\.onset_s: expected a number in \[0, 8\] s, got 8\.1"),
        (replaced(MISS, onset_s=-1), rf"{WHERE}\.onset_s: expected a number in \[0, 8\] s, got -1"),
        (replaced(FAR, duration_s=9.0), rf"{WHERE}\.duration_s: expected a number in \[0, 8\] s, got 9"),
        (replaced(FAR, duration_s=-1.0), rf"{WHERE}\.duration_s: expected a number in \[0, 8\] s, got -1"),
        (replaced(MISS, magnitude=None), rf"{WHERE}\.magnitude: missing; expected type, target, magnitude"),
        (replaced(MISS, target=None), rf"{WHERE}\.target: missing"),
        (replaced(MISS, onset=None), rf"{WHERE}\.onset: missing"),
        (replaced(MISS, onset_s=None), rf"{WHERE}\.onset_s: missing"),
        (replaced(FAR, duration_s=None), rf"{WHERE}\.duration_s: missing; expected .*onset_s, duration_s"),
        (
            replaced(MISS, duration_s=1.0),
            rf"{WHERE}: unknown field 'duration_s'.*expected type, .*, onset_s$",
        ),
        (
            replaced(LATE, onset_s=1.0),
            rf"{WHERE}: unknown field 'onset_s'.*; expected type, target, magnitude$",
        ),
        (replaced(MISS, magnitud=1.0), rf"{WHERE}: unknown field 'magnitud' \(did you mean 'magnitude'"),
        ("miss", rf"{WHERE}: expected an object, got 'miss'"),
        (None, rf"{WHERE}: expected an object, got None"),
    ],
)
def test_a_bad_error_is_refused_with_its_field(document: Json, expected: str) -> None:
    with pytest.raises(InvalidEpisode, match=expected):
        errors_from_json({"mode": "errors", "errors": [document]}, DURATION_S)


@pytest.mark.parametrize(
    ("behaviour", "expected"),
    [
        (
            {"mode": "errors", "errors": [MISS] * (MAX_ERRORS + 1)},
            r"behaviour\.errors: expected a list of at most 8",
        ),
        (
            {"mode": "errors", "errors": MISS},
            r"behaviour\.errors: expected a list of at most 8 errors, got \{",
        ),
        (
            {"mode": "errors", "errors": [LATE, replaced(MISS, onset_s=9)]},
            r"behaviour\.errors\[1\]\.onset_s: ",
        ),
        ({"mode": "errors"}, r"behaviour\.errors: missing"),
        (
            {"mode": "errors", "errors": [], "error": []},
            r"behaviour: unknown field 'error' \(did you mean 'errors'",
        ),
        ({"mode": "oracle", "errors": []}, r"behaviour\.mode: expected errors, got 'oracle'"),
        ({"errors": []}, r"behaviour\.mode: missing"),
    ],
)
def test_a_bad_behaviour_is_refused_by_the_simulator(
    simulator: BrinkDriveErrors, behaviour: JsonObject, expected: str
) -> None:
    with pytest.raises(InvalidEpisode, match=expected):
        simulator.run(replace(STRAIGHT, behaviour=behaviour))


def test_each_simulator_takes_only_its_own_behaviours(simulator: BrinkDriveErrors) -> None:
    with pytest.raises(InvalidEpisode, match="simulator: expected brink-drive-errors@2, got 'brink-drive@3'"):
        simulator.run(replace(STRAIGHT, simulator="brink-drive@3"))
    with pytest.raises(InvalidEpisode, match=r"behaviour\.mode: expected one of injected, oracle"):
        BrinkDrive().run(replace(STRAIGHT, simulator="brink-drive@3"))


def test_late_withholds_nobody_who_was_reported_before() -> None:
    # A car that joins from a side street turns into the ego's direction long after it was first visible.
    scenario: JsonObject = {
        "time_of_day": "noon",
        "weather": "clear",
        "pedestrians": 0,
        "road_curve": "right",
        "road_id": 1,
        "road_length": 0,
        "driving_task": "follow_road",
    }
    spec = EpisodeSpec(
        simulator="brink-drive-errors@2",
        scenario=scenario,
        requirements=("front-gap@1",),
        seed=3,
        behaviour={"mode": "errors", "errors": [{"type": "late", "target": "lead", "magnitude": 1.5}]},
        duration_s=12.0,
        options={"fidelity": "bicycle"},
    )
    recorded = BrinkDriveErrors().run(spec, record=True).trace
    assert recorded is not None
    trace = Trace.from_bytes(recorded)
    shown = [len(trace.given_boxes.at(step)) for step in range(len(trace.time_s))]
    true = [len(trace.seen_boxes.at(step)) for step in range(len(trace.time_s))]
    assert shown[:15] != true[:15]
    assert shown[77:95] == true[77:95]


def test_everybody_is_missed(drive: Callable[..., Drive]) -> None:
    found = drive(error("miss", 2.0, "everybody"))
    assert_hidden(found, lambda step, name, row: BEGINS <= step < ENDS)


def test_late_withholds_the_kind_that_it_names(drive: Callable[..., Drive]) -> None:
    found = drive(error("late", 2.0, "oncoming"))
    first: dict[str, int] = {}

    def is_hidden(step: int, name: str, row: FloatArray) -> bool:
        return found.kind(name, step) == "oncoming" and step - first.setdefault(name, step) < 20

    assert_hidden(found, is_hidden)
    assert first["oncoming-1"] == 0 < first["oncoming-2"]
