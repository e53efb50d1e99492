"""How wrong a detector was in a drive, from the simulator."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import pytest

from brink.sim.driving.camera import Camera, Solid
from brink.sim.driving.interface import Box, ObstacleLabel
from brink.sim.episode import EpisodeSpec
from brink.sim.urban.camera import BrinkDriveCamera
from brink.sim.urban.detection_errors import MAGNITUDES, RELEVANT_M, ErrorType, Target
from brink.sim.urban.erroneous_detector import Observer
from brink.sim.urban.error_meter import MEASURES, ErrorMeter, Measures, ReportedBox, TrueBox
from brink.sim.world.scenario import DrivingTask, RoadCurve, TimeOfDay, UrbanScenario, Weather
from brink.sim.world.world import UrbanWorld, make_world

CAMERA = Camera()
STEPS = 100
Report = Callable[[int, Box], Box | None]


def standing(depth_m: float, left_m: float = 0.0, label: ObstacleLabel = ObstacleLabel.VEHICLE) -> Box:
    """Return the box of something 1.8 m wide and 1.5 m high that stands at a place."""
    middle = CAMERA.centre_x_px - left_m * CAMERA.focal_px / depth_m
    half = 0.9 * CAMERA.focal_px / depth_m
    bottom = CAMERA.horizon_px + CAMERA.focal_px * CAMERA.height_m / depth_m
    top = bottom - 1.5 * CAMERA.focal_px / depth_m
    return Box(label=label, x_min_px=middle - half, x_max_px=middle + half, y_min_px=top, y_max_px=bottom)


LEAD = standing(15.0)


def measured(report: Report, true: Box = LEAD, kind: Target = Target.LEAD) -> Measures:
    """Return what the meter says of a drive with one road user, given how it is reported at each step."""
    meter = ErrorMeter(CAMERA)
    for step in range(STEPS):
        box = report(step, true)
        meter.see(step / 10, [TrueBox(7, true, kind, True)], [] if box is None else [ReportedBox(box)])
    return meter.errors().magnitudes


def at_distance(box: Box, depth_m: float) -> Box:
    return box._replace(y_max_px=CAMERA.horizon_px + CAMERA.focal_px * CAMERA.height_m / depth_m)


def test_a_true_report_has_no_error() -> None:
    found = measured(lambda step, box: box)
    assert set(found) == {Target.LEAD, Target.EVERYBODY, Target.PEDESTRIAN}
    assert set(found[Target.PEDESTRIAN]) == {ErrorType.GHOST_ON_ROAD}
    for errors in found.values():
        assert {kind: MAGNITUDES[kind].severity(value) for kind, value in errors.items()} == dict.fromkeys(
            errors, 0.0
        )


@pytest.mark.parametrize(
    ("report", "kind", "expected"),
    [
        (lambda step, box: None if 20 <= step < 33 else box, ErrorType.MISS, 1.3),
        (lambda step, box: None if step < 13 else box, ErrorType.LATE, 1.3),
        (lambda step, box: None if step % 20 < 5 and step > 0 else box, ErrorType.FLICKER, 0.24),
        (lambda step, box: at_distance(box, 18.0), ErrorType.TOO_FAR, 0.2),
        (lambda step, box: at_distance(box, 12.0), ErrorType.TOO_NEAR, 0.2),
        (lambda step, box: standing(15.0, 0.5), ErrorType.LEFT, 0.5),
        (lambda step, box: standing(15.0, -0.5), ErrorType.RIGHT, 0.5),
        (
            lambda step, box: box._replace(label=ObstacleLabel.PERSON) if 20 <= step < 33 else box,
            ErrorType.WRONG_LABEL,
            1.3,
        ),
    ],
)
def test_each_error_is_measured_in_its_unit(report: Report, kind: ErrorType, expected: float) -> None:
    errors = measured(report)[Target.LEAD]
    assert errors[kind] == pytest.approx(expected, abs=1e-6)
    missed_s = {ErrorType.MISS: 1.3, ErrorType.LATE: 1.3, ErrorType.FLICKER: 0.5}
    assert errors[ErrorType.MISS] == pytest.approx(missed_s.get(kind, 0.0))


def test_sizes_are_measured_about_the_centre() -> None:
    def larger(step: int, box: Box) -> Box:
        wide, high = box.x_max_px - box.x_min_px, box.y_max_px - box.y_min_px
        return box._replace(
            x_min_px=box.x_min_px - 0.1 * wide,
            x_max_px=box.x_max_px + 0.1 * wide,
            y_min_px=box.y_min_px - 0.1 * high,
            y_max_px=box.y_max_px + 0.1 * high,
        )

    assert measured(larger)[Target.LEAD][ErrorType.TOO_LARGE] == pytest.approx(0.2)


def test_an_error_of_place_counts_as_a_mean_over_the_time_for_which_the_target_is_there() -> None:
    brief = measured(lambda step, box: at_distance(box, 18.0) if 30 <= step < 40 else box)
    assert brief[Target.LEAD][ErrorType.TOO_FAR] == pytest.approx(0.2 / 10)


def test_a_range_is_short_only_if_there_was_something_beyond_it() -> None:
    meter = ErrorMeter(CAMERA)
    for step in range(STEPS):
        depth_m = 50.0 - 0.4 * step
        box = standing(depth_m)
        meter.see(
            step / 10, [TrueBox(1, box, Target.LEAD, True)], [ReportedBox(box)] if depth_m <= 25.0 else []
        )
    assert meter.errors().magnitudes[Target.LEAD][ErrorType.SHORT_RANGE] == pytest.approx(25.0, abs=0.5)
    far = measured(lambda step, box: box, standing(RELEVANT_M - 1.0))
    assert far[Target.LEAD][ErrorType.SHORT_RANGE] == RELEVANT_M
    assert ErrorType.SHORT_RANGE not in measured(lambda step, box: box)[Target.LEAD]


def test_what_is_missed_beyond_the_relevant_distance_does_not_count() -> None:
    far = standing(RELEVANT_M + 5.0)
    assert set(measured(lambda step, box: None, far)[Target.LEAD]) == {ErrorType.GHOST_ON_ROAD}


def test_a_detection_in_the_lane_where_nothing_is_counts_as_a_ghost() -> None:
    meter, far, ghost = ErrorMeter(CAMERA), standing(40.0), standing(8.0, 0.3)
    for step in range(STEPS):
        boxes = [ReportedBox(far), ReportedBox(ghost)] if step < 7 else [ReportedBox(far)]
        meter.see(step / 10, [TrueBox(1, far, Target.LEAD, True)], boxes)
    assert meter.errors().magnitudes[Target.LEAD][ErrorType.GHOST_ON_ROAD] == pytest.approx(0.7)
    assert measured(lambda step, box: box)[Target.LEAD][ErrorType.GHOST_ON_ROAD] == 0.0


def test_a_target_that_is_never_reported_is_missed_and_late_for_its_whole_life() -> None:
    found = measured(lambda step, box: None)[Target.LEAD]
    assert found[ErrorType.MISS] == found[ErrorType.LATE] == pytest.approx(STEPS / 10)
    assert found[ErrorType.FLICKER] == 1.0
    # Nobody knows where a detection would have been.
    assert not found.keys() & {ErrorType.TOO_FAR, ErrorType.LEFT, ErrorType.TOO_LARGE, ErrorType.WRONG_LABEL}


def test_a_miss_counts_while_the_road_user_is_a_target_whatever_it_was_before() -> None:
    meter, beside, ahead = ErrorMeter(CAMERA), standing(20.0, 3.5), standing(20.0)
    for step in range(STEPS):
        is_target = step >= 50
        box = ahead if is_target else beside
        reported = [] if 50 <= step < 90 else [ReportedBox(box)]
        kind = Target.LEAD if is_target else Target.EVERYBODY
        meter.see(step / 10, [TrueBox(1, box, kind, is_target)], reported)
    errors = meter.errors()
    assert errors.magnitudes[Target.LEAD][ErrorType.MISS] == pytest.approx(4.0)
    assert errors.magnitudes[Target.LEAD][ErrorType.LATE] == 0.0
    span = errors.spans[Target.LEAD][ErrorType.MISS]
    assert (span.from_s, span.track) == (5.0, 1)


def test_time_out_of_sight_is_no_delay() -> None:
    meter = ErrorMeter(CAMERA)
    for step in range(240):
        is_hidden = 20 <= step < 220
        hidden = TrueBox(1, LEAD, Target.LEAD, not is_hidden, is_visible=not is_hidden)
        truth = [] if 120 <= step < 220 else [hidden]
        meter.see(step / 10, truth, [])
    errors = meter.errors()
    assert errors.magnitudes[Target.LEAD][ErrorType.MISS] == pytest.approx(2.0)
    assert errors.magnitudes[Target.LEAD][ErrorType.LATE] == pytest.approx(4.0)
    assert ErrorType.LATE in errors.at_least[Target.LEAD]


def test_a_report_while_out_of_sight_is_the_first_detection_and_no_ghost() -> None:
    meter, near = ErrorMeter(CAMERA), standing(12.0)
    for step in range(STEPS):
        is_visible = step >= 10
        true = TrueBox(1, near, Target.LEAD, is_visible, is_visible=is_visible)
        meter.see(step / 10, [true], [ReportedBox(near)])
    found = meter.errors().magnitudes[Target.LEAD]
    assert (found[ErrorType.LATE], found[ErrorType.GHOST_ON_ROAD]) == (0.0, 0.0)


def test_nobody_knows_how_late_what_an_excerpt_begins_with_was_reported() -> None:
    for is_excerpt in (False, True):
        for missed in (0, 3):
            meter = ErrorMeter(CAMERA, is_excerpt=is_excerpt)
            for step in range(STEPS):
                reported = [] if step < missed else [ReportedBox(LEAD)]
                meter.see(step / 10, [TrueBox(1, LEAD, Target.LEAD, True)], reported)
            errors = meter.errors()
            assert errors.magnitudes[Target.LEAD][ErrorType.LATE] == pytest.approx(missed / 10)
            assert (ErrorType.LATE in errors.at_least.get(Target.LEAD, ())) is is_excerpt
            assert (ErrorType.MISS in errors.at_least.get(Target.LEAD, ())) is (is_excerpt and missed > 0)


Truth = Callable[[int], list[TrueBox]]
FAR = standing(20.0)


@pytest.mark.parametrize(
    ("truth", "steps"),
    [
        (lambda step: [TrueBox(1, FAR, Target.LEAD, True)], [step for step in range(STEPS) if step % 4 != 2]),
        (lambda step: [TrueBox(1, FAR, Target.LEAD, True)], [*range(40), *range(40, STEPS, 5)]),
        (lambda step: [TrueBox(1, FAR, Target.LEAD, True, is_visible=step % 4 > 0)], range(STEPS)),
        (lambda step: [TrueBox(1, FAR, Target.LEAD, step % 2 == 0)], range(STEPS)),
        (lambda step: [TrueBox(step % 3, FAR, Target.LEAD, True)], range(STEPS)),
    ],
    ids=[
        "every fourth image is missing",
        "fewer images later",
        "hidden now and then",
        "beside now and then",
        "two",
    ],
)
def test_interruptions_do_not_cut_a_miss_into_pieces(truth: Truth, steps: Sequence[int]) -> None:
    meter = ErrorMeter(CAMERA)
    for step in steps:
        meter.see(step / 10, truth(step), [ReportedBox(FAR)] if step < 10 else [])
    errors = meter.errors()
    # Images in which it is no target, or hidden, do not count.
    assert errors.magnitudes[Target.LEAD][ErrorType.MISS] >= 4.4
    assert errors.magnitudes[Target.LEAD][ErrorType.FLICKER] >= 0.85


def test_a_detection_in_an_interruption_ends_a_miss_and_a_long_one_does_as_well() -> None:
    for reported_at, expected_s in ((range(0), 4.2), (range(45, 46), 3.0)):
        meter = ErrorMeter(CAMERA)
        for step in range(STEPS):
            true = TrueBox(1, FAR, Target.LEAD, not 40 <= step < 48 and step < 60)
            is_seen = step < 10 or step >= 60 or step in reported_at
            meter.see(step / 10, [true], [ReportedBox(FAR)] if is_seen else [])
        assert meter.errors().magnitudes[Target.LEAD][ErrorType.MISS] == pytest.approx(expected_s)
    meter = ErrorMeter(CAMERA)
    for step in range(STEPS):
        if not 40 <= step < 70:  # no images for 3 s
            meter.see(
                step / 10, [TrueBox(1, FAR, Target.LEAD, True)], [ReportedBox(FAR)] if step < 10 else []
            )
    assert meter.errors().magnitudes[Target.LEAD][ErrorType.MISS] == pytest.approx(3.0)


def test_a_range_that_nobody_tested_is_a_bound() -> None:
    errors = ErrorMeter(CAMERA)
    for step in range(STEPS):
        errors.see(step / 10, [TrueBox(1, standing(27.0), Target.LEAD, True)], [])
    found = errors.errors()
    assert found.magnitudes[Target.LEAD][ErrorType.SHORT_RANGE] == 25.0
    assert ErrorType.SHORT_RANGE in found.at_least[Target.LEAD]


def test_what_is_reported_where_nothing_was_labelled_is_no_ghost() -> None:
    ghost, far = standing(8.0), standing(40.0)
    for ignored, expected_s in (([], STEPS / 10), ([ghost], 0.0)):
        meter = ErrorMeter(CAMERA)
        for step in range(STEPS):
            truth = [TrueBox(1, far, Target.LEAD, True)]
            meter.see(step / 10, truth, [ReportedBox(far), ReportedBox(ghost)], ignored)
        found = meter.errors().magnitudes[Target.LEAD]
        assert found[ErrorType.GHOST_ON_ROAD] == pytest.approx(expected_s)


def test_places_that_are_given_count_instead_of_the_box() -> None:
    meter = ErrorMeter(CAMERA)
    for step in range(STEPS):
        true = TrueBox(1, LEAD, Target.LEAD, True, depth_m=30.0, left_m=0.0)
        meter.see(step / 10, [true], [ReportedBox(LEAD, depth_m=36.0, left_m=0.5)])
    found = meter.errors().magnitudes[Target.LEAD]
    assert found[ErrorType.TOO_FAR] == pytest.approx(0.2)
    assert found[ErrorType.LEFT] == pytest.approx(0.5)
    # Nobody was farther away.
    assert found[ErrorType.SHORT_RANGE] == 35.0


def test_drives_with_a_camera_tell_the_errors_of_their_detector() -> None:
    spec = EpisodeSpec(
        simulator="brink-drive-camera@3",
        scenario={
            "time_of_day": "noon",
            "weather": "clear",
            "pedestrians": 0,
            "road_curve": "straight",
            "road_id": 0,
            "road_length": 0,
            "driving_task": "follow_road",
        },
        behaviour={"mode": "detector", "detector": "brink-det@2", "threshold": 0.5},
        requirements=("front-gap@1",),
        seed=1,
        duration_s=5.0,
        options={"fidelity": "bicycle"},
    )
    found = BrinkDriveCamera().run(spec).features[MEASURES]
    assert isinstance(found, dict)
    lead = found["lead"]
    assert isinstance(lead, dict)
    assert set(lead) >= {kind.value for kind in (ErrorType.MISS, ErrorType.TOO_FAR, ErrorType.LATE)}
    assert float(str(lead["too_far"])) < 0.3
    assert float(str(lead["miss"])) < 3.0


BEND = UrbanScenario(
    time_of_day=TimeOfDay.NOON,
    weather=Weather.CLEAR,
    pedestrians=18,
    road_curve=RoadCurve.RIGHT,
    road_id=1,
    road_length=1,
    driving_task=DrivingTask.FOLLOW_ROAD,
)
"""A tight bend to the right between parked cars."""


def world_at(station_m: float, scenario: UrbanScenario = BEND) -> UrbanWorld:
    """Return a world with the ego in its lane at a station."""
    world = make_world(scenario, 4)
    ego = world.ego
    ego.x_m, ego.y_m, ego.yaw_rad = world.route.pose_at(station_m)
    return world


def ghosts_among(world: UrbanWorld, boxes: Sequence[Box]) -> tuple[set[Box], set[Box]]:
    """Return which boxes are ghosts on the road ahead, and which would be on a road that leads straight ahead."""
    found: tuple[set[Box], set[Box]] = (set(), set())
    for box in boxes:
        observer = Observer(world, CAMERA)
        observer.look(0.0)
        scene = observer.look(0.0)  # the ego's station is found near the last one
        for meter, parked, among in (
            (ErrorMeter(CAMERA, in_lane=observer.is_in_lane), observer.parked_boxes(), found[0]),
            (ErrorMeter(CAMERA), [], found[1]),
        ):
            meter.see(0.0, scene.true_boxes(), [ReportedBox(box)], parked=parked)
            if meter.ghosts[-1][1]:
                among.add(box)
    return found


@pytest.mark.parametrize("station_m", [60.0, 65.0, 85.0])
def test_a_parked_car_in_a_bend_is_no_ghost_on_the_road(station_m: float) -> None:
    world = world_at(station_m)
    parked = Observer(world, CAMERA).parked_boxes()
    ghosts, straight_on = ghosts_among(world, parked)
    assert len(parked) > 5
    assert straight_on, "no parked car stands where a straight road would lead"
    assert not ghosts


def test_a_detection_on_the_road_ahead_is_a_ghost_in_a_bend_too() -> None:
    empty = replace(BEND, road_id=0, pedestrians=0)
    route = make_world(empty, 4).route
    begins_m = next(station_m for station_m in range(200) if route.curvature_at(station_m) != 0.0)
    world, at_m = world_at(begins_m, empty), begins_m + 22.0
    boxes = []
    for offset_m in (0.0, 3.3, -2.4):
        x_m, y_m, yaw_rad = world.route.pose_at(at_m, offset_m)
        body = Solid(ObstacleLabel.PERSON, x_m, y_m, yaw_rad, 0.5, 0.5, 1.75)
        found = CAMERA.project(world.ego.x_m, world.ego.y_m, world.ego.yaw_rad, body)
        assert found is not None
        boxes.append(found[0])
    ghosts, straight_on = ghosts_among(world, boxes)
    assert ghosts == {boxes[0]}
    assert boxes[0] not in straight_on


def test_a_detection_of_a_road_user_of_whom_too_little_is_visible_is_no_ghost() -> None:
    world = make_world(replace(BEND, road_curve=RoadCurve.STRAIGHT), 4)
    lead, van = world.vehicles[0], world.vehicles[1]
    van.x_m, van.y_m, van.yaw_rad = world.route.pose_at(18.0)
    lead.x_m, lead.y_m, lead.yaw_rad = world.route.pose_at(28.0)
    scene = Observer(world, CAMERA).look(0.0)
    (hidden,) = [true for true in scene.true_boxes() if true.track == 0]
    assert not hidden.is_visible
    for truth, is_ghost in ((scene.true_boxes(), False), ([], True)):
        meter = ErrorMeter(CAMERA)
        meter.see(0.0, truth, [ReportedBox(hidden.box)])
        assert bool(meter.ghosts[-1][1]) is is_ghost


def test_a_few_far_detections_are_no_range() -> None:
    meter = ErrorMeter(CAMERA)
    for step in range(STEPS):
        box = standing(58.0 - 0.5 * step)
        meter.see(
            step / 10, [TrueBox(1, box, Target.LEAD, True)], [ReportedBox(box)] if step in (1, 50) else []
        )
    assert meter.errors().magnitudes[Target.LEAD][ErrorType.SHORT_RANGE] < 10.0


def test_a_target_that_is_hardly_there_is_not_measured() -> None:
    meter = ErrorMeter(CAMERA)
    for step in range(5):
        meter.see(step / 10, [TrueBox(1, LEAD, Target.LEAD, True)], [])
    assert all(set(errors) == {ErrorType.GHOST_ON_ROAD} for errors in meter.errors().magnitudes.values())
