import math

import pytest
from driving_loop import road
from hypothesis import given
from hypothesis import strategies as st

from brink.sim.driving.camera import Body, Camera
from brink.sim.driving.interface import Box, EgoState, ObstacleLabel
from brink.sim.driving.localisation import GroundPlaneLocaliser, Place
from brink.sim.driving.settings import LocalisationSettings
from brink.sim.world.line import Piece

CAMERA = Camera()
LOCALISER = GroundPlaneLocaliser(road(), CAMERA, LocalisationSettings())
EGO = EgoState(x_m=0.0, y_m=0.0, yaw_rad=0.0, speed_mps=8.0, accel_mps2=0.0, station_m=0.0, offset_m=0.0)


def box(label: ObstacleLabel, x_min: float, x_max: float, y_min: float, y_max: float) -> Box:
    return Box(label=label, x_min_px=x_min, x_max_px=x_max, y_min_px=y_min, y_max_px=y_max)


def place(*args: float, label: ObstacleLabel = ObstacleLabel.VEHICLE) -> Place:
    (found,) = LOCALISER.locate(EGO, (box(label, *args),))
    return found


def test_the_bottom_edge_gives_the_distance_and_the_sides_the_extent() -> None:
    # 68 px below the horizon is 10 m ahead; 40 px left and right of the axis is 1 m there. The centre is half a
    # vehicle's length farther.
    found = place(360.0, 440.0, 300.0, 368.0)
    assert (found.x_m, found.y_m) == pytest.approx((1.3 + 10.0 + 2.25, 0.0))
    assert (found.width_m, found.length_m) == pytest.approx((2.0, 4.5))


def test_a_lower_bottom_edge_is_nearer() -> None:
    distances = [place(360.0, 440.0, 200.0, y_px).x_m for y_px in (320.0, 360.0, 420.0, 500.0, 600.0)]
    assert distances == sorted(distances, reverse=True)


@pytest.mark.parametrize(("label", "expected_m"), [(ObstacleLabel.VEHICLE, 6.0), (ObstacleLabel.PERSON, 6.8)])
def test_a_box_above_the_horizon_is_placed_by_its_size_and_label(
    label: ObstacleLabel, expected_m: float
) -> None:
    # 100 px high: 400 * 1.5 / 100 for a vehicle, 400 * 1.7 / 100 for a person.
    found = place(350.0, 450.0, 100.0, 200.0, label=label)
    assert found.x_m - found.length_m / 2 - CAMERA.forward_m == pytest.approx(expected_m)


def test_a_bottom_edge_a_hair_below_the_horizon_is_placed_by_its_size_too() -> None:
    found = place(350.0, 450.0, 203.0, 303.0)
    assert found.x_m - found.length_m / 2 - CAMERA.forward_m == pytest.approx(6.0)


@given(
    ahead_m=st.floats(6.0, 60.0),
    left_m=st.floats(-6.0, 6.0),
    x_m=st.floats(0.0, 50.0),
    turned_rad=st.floats(-0.8, 0.8),
)
def test_a_projected_car_is_found_where_it_stands_from_any_angle(
    ahead_m: float, left_m: float, x_m: float, turned_rad: float
) -> None:
    """The car points along the road; the ego looks at it from an angle."""
    ego = EGO._replace(x_m=x_m, station_m=x_m, yaw_rad=turned_rad)
    body = Body(ObstacleLabel.VEHICLE, x_m + ahead_m, left_m, 0.0, 4.5, 1.9, 1.5)
    seen = CAMERA.project(x_m, 0.0, turned_rad, body)
    if seen is None or seen[1] < 3.0 or seen[0].x_min_px < 2.5 or seen[0].x_max_px > 797.5:
        return
    (found,) = LOCALISER.locate(ego, (seen[0],))
    assert (found.x_m, found.y_m) == pytest.approx((body.x_m, body.y_m), abs=0.1)
    assert (found.width_m, found.length_m) == pytest.approx((1.9, 4.5), abs=0.25)


def test_a_waiting_car_seen_from_a_side_street_is_not_in_our_lane() -> None:
    route = road(Piece(20.0), Piece(10.0, -1 / 8), Piece(60.0))
    station_m = 35.0
    x_m, y_m, yaw_rad = route.pose_at(station_m, 3.5)
    ego = EGO._replace(x_m=18.0, station_m=18.0)
    seen = CAMERA.project(18.0, 0.0, 0.0, Body(ObstacleLabel.VEHICLE, x_m, y_m, yaw_rad, 4.5, 1.9, 1.5))
    assert seen is not None
    (found,) = GroundPlaneLocaliser(route, CAMERA, LocalisationSettings()).locate(ego, (seen[0],))
    _, offset_m = route.project(found.x_m, found.y_m, station_m)
    assert offset_m == pytest.approx(3.5, abs=0.3)
    assert found.width_m == pytest.approx(1.9, abs=0.3)


def test_a_wider_box_is_a_wider_obstacle() -> None:
    widths = [place(400.0 - half, 400.0 + half, 300.0, 368.0).width_m for half in (25.0, 40.0, 100.0, 300.0)]
    assert widths == sorted(widths)
    assert widths[0] < 1.5
    assert widths[-1] > 10.0


@pytest.mark.parametrize("left_m", [2.8, 3.5, 5.0])
def test_a_car_that_is_partly_out_of_the_picture_is_placed_by_its_inner_edge(left_m: float) -> None:
    for side in (1.0, -1.0):
        for x_m in (3.0, 4.0, 5.0):
            body = Body(ObstacleLabel.VEHICLE, x_m, side * left_m, 0.0, 4.5, 1.9, 1.5)
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


def test_a_car_that_shows_its_side_does_not_reach_into_our_lane() -> None:
    # In the oncoming lane, its inner side 2.6 m to the left; at 8 m its box is three times as wide as its front.
    seen = CAMERA.project(0.0, 0.0, 0.0, Body(ObstacleLabel.VEHICLE, 11.0, 3.5, 0.0, 4.5, 1.8, 1.5))
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
def test_a_box_without_extent_is_left_out(broken: tuple[float, float, float, float]) -> None:
    assert LOCALISER.locate(EGO, (box(ObstacleLabel.VEHICLE, *broken),)) == []


@given(
    x=st.tuples(st.floats(0.0, 799.0), st.floats(1.0, 800.0)),
    y=st.tuples(st.floats(0.0, 599.0), st.floats(1.0, 600.0)),
    label=st.sampled_from(ObstacleLabel),
)
def test_every_place_is_finite_ahead_of_the_camera_and_has_a_width(
    x: tuple[float, float], y: tuple[float, float], label: ObstacleLabel
) -> None:
    for found in LOCALISER.locate(EGO, (box(label, *x, *y),)):
        # Of a body that the border cuts only some part need be ahead: it may stand beside the camera.
        foremost_m = found.x_m + (0.5 * found.length_m if found.is_cut else 0.0)
        assert foremost_m - CAMERA.forward_m >= 0.5
        assert found.x_m - CAMERA.forward_m <= 80.0 + found.length_m
        assert found.width_m >= 0.4
        assert math.isfinite(found.y_m)
