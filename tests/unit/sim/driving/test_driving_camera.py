import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from brink.sim.driving.camera import Body, Camera
from brink.sim.driving.interface import ObstacleLabel

CAMERA = Camera()


def car(x_m: float, y_m: float, yaw_rad: float = 0.0) -> Body:
    return Body(ObstacleLabel.VEHICLE, x_m, y_m, yaw_rad, 4.5, 1.8, 1.5)


def test_a_car_straight_ahead_is_where_pin_hole_arithmetic_puts_it() -> None:
    # Near face 10 m ahead of the camera: 400 px * 0.9 / 10 = 36 px to each side, 400 * 1.7 / 10 = 68 px below the
    # horizon; the roof is 0.2 m below the camera and so seen highest at the far end: 400 * 0.2 / 14.5 = 5.52 px.
    seen = CAMERA.project(0.0, 0.0, 0.0, car(1.3 + 10.0 + 2.25, 0.0))
    assert seen is not None
    box, depth_m = seen
    assert depth_m == pytest.approx(10.0)
    assert (box.x_min_px, box.x_max_px) == pytest.approx((364.0, 436.0))
    assert box.y_max_px == pytest.approx(368.0)
    assert box.y_min_px == pytest.approx(300.0 + 80.0 / 14.5)


def test_left_is_to_the_left_in_the_image() -> None:
    seen = CAMERA.project(0.0, 0.0, 0.0, car(20.0, 4.0))
    assert seen is not None
    assert seen[0].x_max_px < 400.0


def test_the_camera_turns_and_moves_with_the_ego() -> None:
    straight = CAMERA.project(0.0, 0.0, 0.0, car(20.0, 2.0))
    turned = CAMERA.project(5.0, -3.0, math.pi / 2, car(5.0 - 2.0, -3.0 + 20.0, math.pi / 2))
    assert straight is not None
    assert turned is not None
    assert turned[0][1:] == pytest.approx(straight[0][1:])


@pytest.mark.parametrize("body", [car(-10.0, 0.0), car(5.0, 40.0), car(300.0, 0.0), car(-3.0, 0.0)])
def test_what_is_behind_beside_or_too_far_is_not_seen(body: Body) -> None:
    assert CAMERA.project(0.0, 0.0, 0.0, body) is None


def test_a_car_that_reaches_behind_the_camera_is_cut_at_the_image_border() -> None:
    seen = CAMERA.project(0.0, 0.0, 0.0, car(3.0, 2.6))
    assert seen is not None
    box, depth_m = seen
    # Its right side, 1.7 m to the left, comes into view where it is as far ahead as to the side.
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


@given(
    x_m=st.floats(-20.0, 100.0),
    y_m=st.floats(-50.0, 50.0),
    yaw_rad=st.floats(-math.pi, math.pi),
)
def test_every_box_lies_in_the_image_and_its_bottom_edge_is_the_nearest_visible_ground(
    x_m: float, y_m: float, yaw_rad: float
) -> None:
    seen = CAMERA.project(0.0, 0.0, 0.0, car(x_m, y_m, yaw_rad))
    if seen is None:
        return
    box, depth_m = seen
    assert 0.0 <= box.x_min_px < box.x_max_px <= 800.0
    assert 0.0 <= box.y_min_px < box.y_max_px <= 600.0
    assert CAMERA.ground_depth_m(box.y_max_px) == pytest.approx(max(depth_m, 400 * 1.7 / 300))


def test_the_horizon_and_above_have_no_ground() -> None:
    assert CAMERA.ground_depth_m(300.0) is None
    assert CAMERA.ground_depth_m(10.0) is None


def test_what_stands_behind_a_nearer_body_is_hidden_and_the_rest_comes_nearest_first() -> None:
    van = Body(ObstacleLabel.VEHICLE, 15.0, 0.0, 0.0, 5.0, 2.0, 2.5)
    hidden = Body(ObstacleLabel.PERSON, 22.0, 0.0, 0.0, 0.5, 0.5, 1.7)
    beside = Body(ObstacleLabel.PERSON, 10.0, 4.0, 0.0, 0.5, 0.5, 1.7)
    sights = CAMERA.look(0.0, 0.0, 0.0, [hidden, van, beside])
    assert [sight.body for sight in sights] == [2, 1]


def test_a_field_of_view_of_half_a_circle_is_refused() -> None:
    with pytest.raises(ValueError, match="fov_deg"):
        Camera(fov_deg=180.0)
