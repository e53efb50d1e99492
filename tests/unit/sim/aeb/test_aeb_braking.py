"""The emergency brake: its regions to the pixel, and its latch to the frame."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from brink.sim.aeb.braking import CRUISE_MPS, LEAST_FRICTION, EmergencyBrake, Region, needed_reach_m
from brink.sim.driving.camera import Camera, Solid
from brink.sim.driving.interface import Box, Command, EgoState, Observation, ObstacleLabel, PlanMode
from brink.sim.world.ego import EgoCar

WARNING = Region.from_reference(1280, 720, warning=True)
SMALL = Region.from_reference(640, 360, warning=True)
DRIVING = Region.in_driving_image(warning=True)
COLUMN, ROW = st.floats(-50, 700, width=32), st.floats(-50, 360, width=32)


def box(x_min: float, y_min: float, x_max: float, y_max: float) -> Box:
    """Return a person's box, in px of an image of any size."""
    return Box(label=ObstacleLabel.PERSON, x_min_px=x_min, x_max_px=x_max, y_min_px=y_min, y_max_px=y_max)


def scaled(candidate: Box, by: float, down_px: float = 0.0) -> Box:
    return Box(
        label=candidate.label,
        x_min_px=by * candidate.x_min_px,
        x_max_px=by * candidate.x_max_px,
        y_min_px=by * candidate.y_min_px + down_px,
        y_max_px=by * candidate.y_max_px + down_px,
    )


def seen(candidate: Box, label: ObstacleLabel = ObstacleLabel.PERSON) -> Box:
    """Return a box of an image of 1280 x 720 as the brake receives it."""
    return scaled(candidate, 0.625, 75.0)._replace(label=label)


def command(brake: EmergencyBrake, time_s: float, boxes: list[Box], speed_mps: float = CRUISE_MPS) -> Command:
    ego = EgoState(
        x_m=0.0, y_m=0.0, yaw_rad=0.0, speed_mps=speed_mps, accel_mps2=0.0, station_m=0.0, offset_m=0.0
    )
    return brake.step(Observation(time_s=time_s, ego=ego, boxes=tuple(boxes), light=None))


def brakes(brake: EmergencyBrake, time_s: float, boxes: list[Box]) -> bool:
    """Return whether the brake brakes after a frame."""
    result = command(brake, time_s, boxes)
    assert result.emergency is (result.accel_mps2 < -9.0) is (brake.plan.mode is PlanMode.STOP)
    return result.emergency


def person_at(depth_m: float, right_m: float, *, across: bool = False) -> tuple[Box, ...]:
    """Return the box of a person that a level camera sees from the middle of the lane."""
    yaw_rad = 0.5 * np.pi if across else 0.0
    camera = Camera()
    # Right is the right edge of the lane; the nearer side of a person who crosses is 0.225 m from their centre.
    side_m = right_m + (0.225 if across else 0.0)
    solid = Solid(ObstacleLabel.PERSON, depth_m + camera.forward_m, -side_m, yaw_rad, 0.45, 0.55, 1.75)
    seen = camera.project(0.0, 0.0, 0.0, solid)
    return () if seen is None else (seen[0],)


def seen_at(
    time_s: float, boxes: tuple[Box, ...], seen_s: float, speed_mps: float = CRUISE_MPS
) -> Observation:
    """Return an observation with the boxes of an earlier image."""
    ego = EgoState(
        x_m=0.0, y_m=0.0, yaw_rad=0.0, speed_mps=speed_mps, accel_mps2=0.0, station_m=0.0, offset_m=0.0
    )
    return Observation(time_s=time_s, ego=ego, boxes=boxes, light=None, seen_s=seen_s)


PERSON, VEHICLE = seen(box(600, 300, 680, 600)), ObstacleLabel.VEHICLE


@pytest.mark.parametrize(
    ("candidate", "meets"),
    [
        (box(600, 300, 680, 600), True),
        (box(600, 300, 680, 469), False),  # ends above the region
        (box(280, 480, 490, 500), False),  # in the bounding rectangle, but not in the trapezoid
        (box(280, 480, 490, 719), True),  # its lower end reaches the wide part of the region
        (box(1004, 500, 1200, 720), True),  # touches the corner
        (box(1006, 500, 1200, 720), False),
        (box(0, 0, 1280, 720), True),
        (box(600, 700, 610, 900), True),  # extends below the picture
    ],
)
def test_a_box_is_tested_against_the_trapezoid_not_its_bounds(candidate: Box, meets: bool) -> None:
    assert WARNING.intersects(candidate) is meets


def test_regions_scale_with_the_picture() -> None:
    for candidate in (box(280, 480, 500, 500), box(280, 480, 500, 719), box(1004, 500, 1200, 720)):
        meets = WARNING.intersects(candidate)
        assert SMALL.intersects(scaled(candidate, 0.5)) is meets
        assert DRIVING.intersects(seen(candidate)) is meets


def test_only_a_vehicle_in_the_lane_triggers_the_brake() -> None:
    brake = EmergencyBrake()
    beside, ahead = seen(box(876, 300, 1280, 720), VEHICLE), seen(box(520, 400, 760, 600), VEHICLE)
    farther = seen(box(520, 360, 760, 450), VEHICLE)
    assert not any(brakes(brake, 0.05 * frame, [beside, farther]) for frame in range(20))
    assert [brakes(brake, 1.0 + 0.05 * frame, [ahead]) for frame in range(4)] == [False, False, True, True]


def test_a_flickering_vehicle_does_not_trigger_the_brake() -> None:
    brake = EmergencyBrake()
    ahead = [seen(box(520, 400, 760, 600), VEHICLE)]
    assert not any(brakes(brake, 0.05 * frame, ahead if frame % 3 else []) for frame in range(30))


@pytest.mark.parametrize(
    ("person_frames", "reported", "braking"),
    [
        (1, "010000", "011111"),
        (2, "010010", "000000"),
        (2, "011000", "001111"),
        (2, "010100", "000111"),
        (3, "011011", "000000"),
        (3, "011100", "000111"),
    ],
)
def test_a_person_is_confirmed_in_some_of_three_frames(
    person_frames: int, reported: str, braking: str
) -> None:
    brake = EmergencyBrake(person_frames=person_frames)
    found = [
        brakes(brake, 0.05 * frame, [PERSON] if flag == "1" else []) for frame, flag in enumerate(reported)
    ]
    assert "".join("1" if flag else "0" for flag in found) == braking


def test_the_latch_holds_and_releases() -> None:
    brake = EmergencyBrake(hold_s=0.5, person_frames=1)
    person = [PERSON]
    assert not brakes(brake, 0.0, [])
    assert brakes(brake, 0.05, person)
    assert all(brakes(brake, 0.05 * frame, []) for frame in range(2, 11))
    assert not brakes(brake, 0.55, [])
    assert brakes(brake, 0.60, person)


@pytest.mark.parametrize("first", range(0, 300, 7))
def test_a_hold_has_the_same_number_of_frames_whenever_it_begins(first: int) -> None:
    brake = EmergencyBrake(hold_s=0.5, person_frames=1)
    assert brakes(brake, first * 0.05, [PERSON])
    assert sum(brakes(brake, (first + later) * 0.05, []) for later in range(1, 30)) == 9


@settings(deadline=None)
@given(COLUMN, COLUMN, ROW, ROW)
def test_a_box_intersects_the_region_if_any_of_its_rows_does(a: float, b: float, c: float, d: float) -> None:
    candidate = box(min(a, b), min(c, d), max(a, b), max(c, d))
    rows = np.linspace(candidate.y_min_px, min(candidate.y_max_px, 360.0), 400)
    inside = rows[rows >= 235.0]
    half = 0.5 * (115.0 + (inside - 235.0) / 125.0 * 250.0)
    touches = bool(np.any((candidate.x_min_px <= 320 + half) & (candidate.x_max_px >= 320 - half)))
    assert SMALL.intersects(candidate) is touches


def test_a_disabled_brake_cruises_whatever_it_sees() -> None:
    brake = EmergencyBrake(enabled=False)
    assert not any(brakes(brake, 0.05 * frame, [PERSON]) for frame in range(20))
    assert command(brake, 1.0, [], speed_mps=0.0).accel_mps2 == 2.5
    assert command(brake, 1.05, [], speed_mps=20.0).accel_mps2 == -3.0


def test_between_images_the_brake_holds_and_counts_nothing() -> None:
    brake = EmergencyBrake(hold_s=0.2)
    ego = EgoState(x_m=0.0, y_m=0.0, yaw_rad=0.0, speed_mps=8.0, accel_mps2=0.0, station_m=0.0, offset_m=0.0)
    assert not brakes(brake, 0.1, [PERSON])
    waiting = Observation(time_s=0.15, ego=ego, boxes=None, light=None)
    assert not brake.step(waiting).emergency
    late = Observation(time_s=0.2, ego=ego, boxes=(PERSON,), light=None, seen_s=0.1)
    assert brake.step(late).emergency
    assert [brake.step(replace(waiting, time_s=t)).emergency for t in (0.25, 0.35, 0.4)] == [
        True,
        True,
        False,
    ]
    assert (brake.person_seen_s, brake.braked_at_s) == (0.1, 0.2)


@pytest.mark.parametrize(
    ("beside_m", "towards_mps", "triggers"),
    [(0.4, 2.0, True), (0.8, 2.0, False), (0.4, 0.0, False), (0.4, -2.0, False)],
)
def test_a_person_counts_where_they_will_be_when_the_brakes_bite(
    beside_m: float, towards_mps: float, triggers: bool
) -> None:
    """With images 0.1 s old, and brakes that cost 0.17 s, a person at 2 m/s comes 0.54 m nearer to the region."""
    brake = EmergencyBrake()
    for frame in range(2):
        depth_m = 8.0 - 0.4 * frame
        aside_m = 1.75 + beside_m - 0.05 * towards_mps * (frame - 1)
        command = brake.step(
            seen_at(0.05 * frame, person_at(depth_m, aside_m, across=True), seen_s=0.05 * frame - 0.1)
        )
    assert command.emergency is triggers


@pytest.mark.parametrize("person_frames", [1, 2, 3])
@pytest.mark.parametrize("latency_s", [0.1, 0.3, 0.6])
def test_the_region_reaches_as_far_as_the_car_needs_to_stop(latency_s: float, person_frames: int) -> None:
    """Somebody appears in the middle of the lane where the region ends, on the most slippery road."""
    brake = EmergencyBrake(latency_s=latency_s, person_frames=person_frames)
    car = EgoCar((0.0, 0.0, 0.0), CRUISE_MPS, friction=LEAST_FRICTION)
    views: list[tuple[Box, ...]] = []
    reach_m = needed_reach_m(car.model, latency_s=latency_s, frames=person_frames)
    steps = round(latency_s / 0.05)
    while car.speed_mps > 0.0:
        depth_m = 40.0 - car.x_m - Camera().forward_m
        views.append(person_at(depth_m, 0.0) if depth_m - 0.225 <= reach_m else ())
        late = len(views) - 1 - steps
        time_s = 0.05 * (len(views) - 1)
        now = brake.step(seen_at(time_s, views[late] if late >= 0 else (), 0.05 * late, car.speed_mps))
        car.drive(now.accel_mps2, now.steer_rad, 5)
    assert 0.9 < 40.0 - 0.225 - car.x_m - 0.5 * car.length_m < 1.9


def test_what_stays_beside_the_region_in_the_image_does_not_trigger_the_brake() -> None:
    """At a constant bearing it would have to run; dirt on the lens does not."""
    brake = EmergencyBrake()
    dirt = Box(ObstacleLabel.PERSON, 0.0, 80.0, 300.0, 480.0)
    assert not any(
        brake.step(seen_at(0.05 * frame, (dirt,), 0.05 * frame - 0.1)).emergency for frame in range(5)
    )


def test_the_region_is_never_shorter_than_the_papers_and_longer_ones_keep_its_sides() -> None:
    assert Region.in_driving_image(warning=True, reach_m=5.0) == Region.in_driving_image(warning=True)
    longer = Region.in_driving_image(warning=True, reach_m=12.0)
    nearer, farther = (person_at(depth_m, 0.0)[0] for depth_m in (12.1, 12.3))  # of their centres
    assert longer.intersects(nearer)
    assert not longer.intersects(farther)
    assert longer.top_px / Camera().focal_px * 12.0 / 2.0 == pytest.approx(1.78, abs=0.02)


def test_two_persons_in_different_places_do_not_confirm_each_other() -> None:
    brake = EmergencyBrake()
    elsewhere = seen(box(100, 300, 180, 600))
    assert not brakes(brake, 0.0, [elsewhere])
    assert not brakes(brake, 0.05, [PERSON])
    assert brakes(brake, 0.1, [elsewhere, PERSON])
