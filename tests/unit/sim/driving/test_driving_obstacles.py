"""Camera, localisation, tracking and prediction."""

import math

import pytest
from driving_loop import road
from hypothesis import given
from hypothesis import strategies as st

from brink.sim.driving.camera import Camera, Solid
from brink.sim.driving.interface import Box, EgoState, ObstacleLabel
from brink.sim.driving.obstacles import (
    AlphaBetaTracker,
    ConstantVelocityPredictor,
    GroundPlaneLocaliser,
    Place,
    RoadObstacle,
    Track,
)
from brink.sim.driving.settings import LocalisationSettings, PredictionSettings, TrackingSettings
from brink.sim.world.line import Piece

CAMERA = Camera()


def car(x_m: float, y_m: float, yaw_rad: float = 0.0) -> Solid:
    return Solid(ObstacleLabel.VEHICLE, x_m, y_m, yaw_rad, 4.5, 1.8, 1.5)


def test_a_car_straight_ahead_has_the_box_of_pinhole_arithmetic() -> None:
    # Near face 10 m ahead of the camera: 400 px * 0.9 / 10 = 36 px to each side, 400 * 1.7 / 10 = 68 px below the
    # horizon; the roof is 0.2 m below the camera and so seen highest at the far end: 400 * 0.2 / 14.5 = 5.52 px.
    seen = CAMERA.project(0.0, 0.0, 0.0, car(1.3 + 10.0 + 2.25, 0.0))
    assert seen is not None
    box, depth_m = seen
    assert depth_m == pytest.approx(10.0)
    assert (box.x_min_px, box.x_max_px) == pytest.approx((364.0, 436.0))
    assert box.y_max_px == pytest.approx(368.0)
    assert box.y_min_px == pytest.approx(300.0 + 80.0 / 14.5)


def test_the_camera_turns_and_moves_with_the_ego() -> None:
    straight = CAMERA.project(0.0, 0.0, 0.0, car(20.0, 2.0))
    turned = CAMERA.project(5.0, -3.0, math.pi / 2, car(5.0 - 2.0, -3.0 + 20.0, math.pi / 2))
    assert straight is not None
    assert turned is not None
    assert turned[0][1:] == pytest.approx(straight[0][1:])


@pytest.mark.parametrize("body", [car(-10.0, 0.0), car(5.0, 40.0), car(300.0, 0.0), car(-3.0, 0.0)])
def test_bodies_behind_beside_or_too_far_away_are_not_visible(body: Solid) -> None:
    assert CAMERA.project(0.0, 0.0, 0.0, body) is None


def test_a_car_that_extends_behind_the_camera_is_clipped_at_the_image_border() -> None:
    seen = CAMERA.project(0.0, 0.0, 0.0, car(3.0, 2.6))
    assert seen is not None
    box, depth_m = seen
    # Its right side, 1.7 m to the left, becomes visible where it is as far ahead as to the side.
    assert depth_m == pytest.approx(1.7)
    assert box.x_min_px == 0.0
    assert box.y_max_px == 600.0
    assert box.x_max_px == pytest.approx(400.0 - 400.0 * 1.7 / (3.0 + 2.25 - 1.3))


@given(depth_m=st.floats(2.3, 100.0), left_m=st.floats(-30.0, 30.0))
def test_back_projection_inverts_projection_on_the_ground(depth_m: float, left_m: float) -> None:
    x_px = CAMERA.centre_x_px - CAMERA.focal_px * left_m / depth_m
    y_px = CAMERA.horizon_px + CAMERA.focal_px * CAMERA.height_m / depth_m
    found_m = CAMERA.ground_depth_m(y_px)
    assert found_m == pytest.approx(depth_m)
    assert CAMERA.left_m(x_px, depth_m) == pytest.approx(left_m, abs=1e-9)


@given(x_m=st.floats(-20.0, 100.0), y_m=st.floats(-50.0, 50.0), yaw_rad=st.floats(-math.pi, math.pi))
def test_every_box_lies_in_the_image_on_the_nearest_visible_ground(
    x_m: float, y_m: float, yaw_rad: float
) -> None:
    seen = CAMERA.project(0.0, 0.0, 0.0, car(x_m, y_m, yaw_rad))
    if seen is None:
        return
    box, depth_m = seen
    assert 0.0 <= box.x_min_px < box.x_max_px <= 800.0
    assert 0.0 <= box.y_min_px < box.y_max_px <= 600.0
    assert CAMERA.ground_depth_m(box.y_max_px) == pytest.approx(max(depth_m, 400 * 1.7 / 300))


def test_there_is_no_ground_at_or_above_the_horizon() -> None:
    assert CAMERA.ground_depth_m(300.0) is None
    assert CAMERA.ground_depth_m(10.0) is None


def test_visible_bodies_come_nearest_first_without_those_hidden_by_a_nearer_one() -> None:
    van = Solid(ObstacleLabel.VEHICLE, 15.0, 0.0, 0.0, 5.0, 2.0, 2.5)
    hidden = Solid(ObstacleLabel.PERSON, 22.0, 0.0, 0.0, 0.5, 0.5, 1.7)
    beside = Solid(ObstacleLabel.PERSON, 10.0, 4.0, 0.0, 0.5, 0.5, 1.7)
    sights = CAMERA.look(0.0, 0.0, 0.0, [hidden, van, beside])
    assert [sight.body for sight in sights] == [2, 1]


def test_a_field_of_view_of_180_degrees_is_rejected() -> None:
    with pytest.raises(ValueError, match="fov_deg"):
        Camera(fov_deg=180.0)


LOCALISER = GroundPlaneLocaliser(road(), CAMERA, LocalisationSettings())
EGO = EgoState(x_m=0.0, y_m=0.0, yaw_rad=0.0, speed_mps=8.0, accel_mps2=0.0, station_m=0.0, offset_m=0.0)


def box(label: ObstacleLabel, x_min: float, x_max: float, y_min: float, y_max: float) -> Box:
    return Box(label=label, x_min_px=x_min, x_max_px=x_max, y_min_px=y_min, y_max_px=y_max)


def located(*args: float, label: ObstacleLabel = ObstacleLabel.VEHICLE) -> Place:
    (found,) = LOCALISER.locate(EGO, (box(label, *args),))
    return found


def test_the_bottom_edge_gives_the_distance_and_the_sides_the_extent() -> None:
    # 68 px below the horizon is 10 m ahead; 40 px left and right of the axis is 1 m there. The centre is half a
    # vehicle's length farther.
    found = located(360.0, 440.0, 300.0, 368.0)
    assert (found.x_m, found.y_m) == pytest.approx((1.3 + 10.0 + 2.25, 0.0))
    assert (found.width_m, found.length_m) == pytest.approx((2.0, 4.5))


@pytest.mark.parametrize(("label", "expected_m"), [(ObstacleLabel.VEHICLE, 6.0), (ObstacleLabel.PERSON, 6.8)])
def test_box_above_the_horizon_is_placed_by_size_and_label(label: ObstacleLabel, expected_m: float) -> None:
    # 100 px high: 400 * 1.5 / 100 for a vehicle, 400 * 1.7 / 100 for a person.
    found = located(350.0, 450.0, 100.0, 200.0, label=label)
    assert found.x_m - found.length_m / 2 - CAMERA.forward_m == pytest.approx(expected_m)


@given(
    ahead_m=st.floats(6.0, 60.0),
    left_m=st.floats(-6.0, 6.0),
    x_m=st.floats(0.0, 50.0),
    turned_rad=st.floats(-0.8, 0.8),
)
def test_projected_car_is_found_at_any_angle(
    ahead_m: float, left_m: float, x_m: float, turned_rad: float
) -> None:
    """The car is aligned with the road; the ego is not."""
    ego = EGO._replace(x_m=x_m, station_m=x_m, yaw_rad=turned_rad)
    body = Solid(ObstacleLabel.VEHICLE, x_m + ahead_m, left_m, 0.0, 4.5, 1.9, 1.5)
    seen = CAMERA.project(x_m, 0.0, turned_rad, body)
    if seen is None or seen[1] < 3.0 or seen[0].x_min_px < 2.5 or seen[0].x_max_px > 797.5:
        return
    (found,) = LOCALISER.locate(ego, (seen[0],))
    tolerance_m = 0.1 if seen[1] > 4.5 else 0.25  # nearer, turned cars are placed less well
    assert (found.x_m, found.y_m) == pytest.approx((body.x_m, body.y_m), abs=tolerance_m)
    assert (found.width_m, found.length_m) == pytest.approx((1.9, 4.5), abs=0.25)


def test_a_waiting_car_seen_before_a_turn_is_not_in_the_ego_lane() -> None:
    route = road(Piece(20.0), Piece(10.0, -1 / 8), Piece(60.0))
    station_m = 35.0
    x_m, y_m, yaw_rad = route.pose_at(station_m, 3.5)
    ego = EGO._replace(x_m=18.0, station_m=18.0)
    seen = CAMERA.project(18.0, 0.0, 0.0, Solid(ObstacleLabel.VEHICLE, x_m, y_m, yaw_rad, 4.5, 1.9, 1.5))
    assert seen is not None
    (found,) = GroundPlaneLocaliser(route, CAMERA, LocalisationSettings()).locate(ego, (seen[0],))
    _, offset_m = route.project(found.x_m, found.y_m, station_m)
    assert offset_m == pytest.approx(3.5, abs=0.3)
    assert found.width_m == pytest.approx(1.9, abs=0.3)


@pytest.mark.parametrize("left_m", [2.8, 3.5, 5.0])
def test_a_car_partly_outside_the_image_is_placed_by_its_inner_edge(left_m: float) -> None:
    for side in (1.0, -1.0):
        for x_m in (3.0, 4.0, 5.0):
            body = Solid(ObstacleLabel.VEHICLE, x_m, side * left_m, 0.0, 4.5, 1.9, 1.5)
            seen = CAMERA.project(0.0, 0.0, 0.0, body)
            if (
                seen is None
                or seen[0].y_max_px == 600.0
                or not (seen[0].x_min_px == 0.0 or seen[0].x_max_px == 800.0)
            ):
                continue
            (found,) = LOCALISER.locate(EGO, (seen[0],))
            assert found.is_cut
            assert (found.x_m, found.y_m) == pytest.approx((x_m, side * left_m), abs=0.05)


def test_a_visible_side_does_not_widen_a_car_into_the_ego_lane() -> None:
    # In the oncoming lane, its inner side 2.6 m to the left; at 8 m its box is three times as wide as its front.
    seen = CAMERA.project(0.0, 0.0, 0.0, Solid(ObstacleLabel.VEHICLE, 11.0, 3.5, 0.0, 4.5, 1.8, 1.5))
    assert seen is not None
    (found,) = LOCALISER.locate(EGO, (seen[0],))
    assert found.y_m - found.width_m / 2 == pytest.approx(2.6, abs=0.15)


@pytest.mark.parametrize(
    "broken",
    [
        (400.0, 400.0, 100.0, 200.0),
        (400.0, 300.0, 100.0, 200.0),
        (300.0, 400.0, 200.0, 200.0),
        (300.0, 400.0, 200.0, 100.0),
        (math.nan, 400.0, 100.0, 200.0),
        (300.0, math.inf, 100.0, 200.0),
        (300.0, 400.0, 100.0, math.nan),
    ],
)
def test_a_box_without_positive_finite_extent_is_ignored(broken: tuple[float, float, float, float]) -> None:
    assert LOCALISER.locate(EGO, (box(ObstacleLabel.VEHICLE, *broken),)) == []


@given(
    x=st.tuples(st.floats(0.0, 799.0), st.floats(1.0, 800.0)),
    y=st.tuples(st.floats(0.0, 599.0), st.floats(1.0, 600.0)),
    label=st.sampled_from(ObstacleLabel),
)
def test_every_place_is_finite_ahead(
    x: tuple[float, float], y: tuple[float, float], label: ObstacleLabel
) -> None:
    for found in LOCALISER.locate(EGO, (box(label, *x, *y),)):
        # A body cut by the border may stand beside the camera; only part of it has to be ahead.
        foremost_m = found.x_m + (0.5 * found.length_m if found.is_cut else 0.0)
        assert foremost_m - CAMERA.forward_m >= 0.5
        assert found.x_m - CAMERA.forward_m <= 80.0 + found.length_m
        assert found.width_m >= 0.4
        assert math.isfinite(found.y_m)


SETTINGS = TrackingSettings()


def place(
    x_m: float,
    y_m: float = 0.0,
    *,
    label: ObstacleLabel = ObstacleLabel.VEHICLE,
    sigma_m: float = 0.1,
    column_px: float = 400.0,
) -> Place:
    box = Box(label=label, x_min_px=column_px, x_max_px=column_px + 60.0, y_min_px=300.0, y_max_px=360.0)
    return Place(label, x_m, y_m, 1.8, 4.5, sigma_m, False, box)


def run(tracker: AlphaBetaTracker, steps: range, *places_at: tuple[float, float]) -> list[Track]:
    """Run the tracker on places given as start position and speed."""
    tracks: list[Track] = []
    for step in steps:
        tracks = tracker.update(
            0.1 * step,
            [
                place(x_m + speed * 0.1 * step, column_px=100.0 * n)
                for n, (x_m, speed) in enumerate(places_at)
            ],
        )
    return tracks


def test_a_track_is_confirmed_at_its_second_hit() -> None:
    tracker = AlphaBetaTracker(SETTINGS)
    assert tracker.update(0.0, [place(20.0)]) == []
    assert len(tracker.update(0.1, [place(20.0)])) == 1


def test_boxes_without_consecutive_hits_never_become_tracks() -> None:
    tracker = AlphaBetaTracker(SETTINGS)
    for step in range(20):
        assert tracker.update(0.1 * step, [place(20.0)] if step % 2 == 0 else []) == []


def test_a_track_survives_four_misses_and_dies_at_the_fifth() -> None:
    tracker = AlphaBetaTracker(SETTINGS)
    run(tracker, range(5), (20.0, 0.0))
    alive = [len(tracker.update(0.5 + 0.1 * miss, [])) for miss in range(6)]
    assert alive == [1, 1, 1, 1, 0, 0]


@given(speed=st.floats(-15.0, 15.0))
def test_steady_velocity_is_estimated_within_half_a_second(speed: float) -> None:
    (track,) = run(AlphaBetaTracker(SETTINGS), range(5), (20.0, speed))
    assert track.vx_mps == pytest.approx(speed, abs=0.05)
    assert track.vy_mps == pytest.approx(0.0, abs=1e-9)


def test_distant_places_change_the_velocity_less_than_close_ones() -> None:
    def shaken(sigma_m: float) -> float:
        tracker = AlphaBetaTracker(SETTINGS)
        fastest = 0.0
        for step in range(40):
            x_m = 30.0 + (0.5 if step % 2 else -0.5)
            for track in tracker.update(0.1 * step, [place(x_m, sigma_m=sigma_m)]):
                fastest = max(fastest, abs(track.vx_mps)) if step > 20 else fastest
        return fastest

    assert shaken(3.0) < shaken(0.05)
    assert shaken(3.0) < 1.0


def test_a_track_has_a_single_label() -> None:
    tracker = AlphaBetaTracker(SETTINGS)
    run(tracker, range(3), (20.0, 0.0))
    person = place(20.0, label=ObstacleLabel.PERSON)
    tracker.update(0.3, [person])
    labels = [track.label for track in tracker.update(0.4, [person])]
    assert labels == [ObstacleLabel.VEHICLE, ObstacleLabel.PERSON]


def test_a_box_that_stays_put_in_the_image_stays_on_its_track_wherever_it_is_placed() -> None:
    tracker = AlphaBetaTracker(SETTINGS)
    run(tracker, range(3), (20.0, 0.0))
    (track,) = tracker.update(0.3, [place(28.0, column_px=0.0)])
    assert track.misses == 0


def test_a_standing_obstacle_is_marked_as_standing_until_it_moves() -> None:
    tracker = AlphaBetaTracker(SETTINGS)
    (track,) = run(tracker, range(40), (20.0, 0.0))
    assert track.standing_since_s == pytest.approx(0.2)
    for step in range(40, 70):
        (track,) = tracker.update(0.1 * step, [place(20.0 + 3.0 * 0.1 * (step - 39))])
    assert track.standing_since_s is None


def test_a_standing_vehicle_does_not_move_while_it_is_passed() -> None:
    tracker = AlphaBetaTracker(SETTINGS)
    run(tracker, range(10), (20.0, 0.0))
    for step in range(10, 20):
        (track,) = tracker.update(0.1 * step, [place(20.0 + 0.3 * (step - 9))._replace(is_cut=True)])
    assert (track.x_m, track.vx_mps) == pytest.approx((20.0, 0.0))


BOX = Box(label=ObstacleLabel.VEHICLE, x_min_px=0.0, x_max_px=1.0, y_min_px=0.0, y_max_px=1.0)


def obstacle(right_m: float, left_m: float, across_mps: float) -> RoadObstacle:
    return RoadObstacle(
        track=1,
        label=ObstacleLabel.PERSON,
        near_m=20.0,
        far_m=20.5,
        right_m=right_m,
        left_m=left_m,
        across_mps=across_mps,
    )


@given(right_m=st.floats(-8.0, 8.0), width_m=st.floats(0.1, 3.0), across_mps=st.floats(-5.0, 5.0))
def test_predicted_times_match_simulated_motion(right_m: float, width_m: float, across_mps: float) -> None:
    one = obstacle(right_m, right_m + width_m, across_mps)
    window = one.time_in(-1.0, 1.0)
    for step in range(31):
        time_s = 0.1 * step
        moved = obstacle(right_m + across_mps * time_s, right_m + width_m + across_mps * time_s, across_mps)
        is_in = moved.overlaps(-1.0 - 1e-9, 1.0 + 1e-9)
        if window is not None and window[0] + 1e-6 < time_s < window[1] - 1e-6:
            assert is_in
        if is_in and moved.overlaps(-1.0 + 1e-6, 1.0 - 1e-6) and time_s < 3.0:
            assert window is not None
            assert window[0] - 1e-6 <= time_s <= window[1] + 1e-6


def test_velocity_on_a_bend_is_split_along_and_across_the_route() -> None:
    route = road(Piece(20.0), Piece(30.0, 1 / 30), Piece(50.0))
    x_m, y_m, yaw_rad = route.pose_at(35.0, 3.5)
    track = Track(1, Place(ObstacleLabel.VEHICLE, x_m, y_m, 1.8, 4.5, 0.1, False, BOX))
    ego = EgoState(
        x_m=10.0, y_m=0.0, yaw_rad=0.0, speed_mps=8.0, accel_mps2=0.0, station_m=10.0, offset_m=0.0
    )
    track.vx_mps, track.vy_mps = -6.0 * math.cos(yaw_rad), -6.0 * math.sin(yaw_rad)
    (found,) = ConstantVelocityPredictor(route, PredictionSettings()).predict(1.0, ego, [track])
    assert (found.near_m, found.far_m) == pytest.approx((32.75, 37.25))
    assert (found.right_m, found.left_m) == pytest.approx((2.6, 4.4))
    assert (found.along_mps, found.across_mps) == pytest.approx((-6.0, 0.0))
