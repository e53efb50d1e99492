import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from brink.sim.rendering import (
    Body,
    BodyKind,
    Building,
    Light,
    PictureCamera,
    Renderer,
    StreetScene,
    Viewpoint,
    VisibleBody,
    visible_bodies,
)
from brink.sim.rendering.buildings import footprint
from brink.sim.rendering.view import beyond_near, view_from
from brink.sim.world.scenario import TimeOfDay, Weather

CAMERA = PictureCamera(width_px=640, height_px=360)
ORIGIN = Viewpoint(x_m=0.0, y_m=0.0, yaw_rad=0.0)
GREY_NOON = Light(time_of_day=TimeOfDay.NOON, weather=Weather.CLOUDY)
EMPTY = Renderer(StreetScene(), GREY_NOON, CAMERA, 1)


def car(
    x_m: float, y_m: float, yaw_rad: float = 0.0, kind: BodyKind = BodyKind.VEHICLE, look: int = 3
) -> Body:
    return Body(
        id=7, kind=kind, x_m=x_m, y_m=y_m, yaw_rad=yaw_rad, length_m=4.4, width_m=1.8, height_m=1.5, look=look
    )


def only(renderer: Renderer, body: Body, viewpoint: Viewpoint = ORIGIN) -> VisibleBody:
    (found,) = visible_bodies(renderer.frame(viewpoint, [body], 0.0))
    return found


def test_a_car_seen_from_its_side_covers_the_pixels_worked_out_by_hand() -> None:
    # Ten metres ahead of the camera, across its axis; focal length 320 px, eye 1.7 m high, horizon in row 180.
    box = only(EMPTY, car(11.3, 0.0, math.pi / 2)).whole_box
    nose_px = 320 - 320 * 2.2 / (10 - 0.84 * 0.9)
    tail_px = 320 + 320 * 2.2 / (10 - 0.88 * 0.9)
    wheels_px = 180 + 320 * 1.7 / (10 - 0.9)
    roof_px = 180 + 320 * 0.2 / (10 + 0.8 * 0.76 * 0.9)
    assert abs(box.x_min_px - nose_px) <= 1
    assert abs(box.x_max_px - tail_px) <= 1
    assert abs(box.y_max_px - wheels_px) <= 1
    assert abs(box.y_min_px - roof_px) <= 1


def test_a_person_is_as_high_in_the_picture_as_worked_out_by_hand() -> None:
    body = Body(
        id=7,
        kind=BodyKind.PERSON,
        x_m=9.3,
        y_m=2.0,
        yaw_rad=1.0,
        length_m=0.5,
        width_m=0.5,
        height_m=1.8,
        look=4,
    )
    box = only(EMPTY, body).whole_box
    assert abs(box.y_max_px - (180 + 320 * 1.7 / 8)) <= 1.5
    assert abs(box.y_min_px - (180 - 320 * 0.1 / 8)) <= 1.5
    assert abs((box.x_min_px + box.x_max_px) / 2 - (320 - 320 * 2.0 / 8)) <= 2


def test_pitch_moves_the_picture_down_by_the_focal_length_times_its_tangent() -> None:
    level = only(EMPTY, car(31.3, 0.0)).whole_box
    up = only(EMPTY, car(31.3, 0.0), Viewpoint(x_m=0.0, y_m=0.0, yaw_rad=0.0, pitch_rad=0.05)).whole_box
    assert abs((up.y_min_px - level.y_min_px) - 320 * math.tan(0.05)) <= 1.5


def test_the_viewpoint_turns_with_the_ego() -> None:
    ahead = only(EMPTY, car(20.0, 1.0, 0.4)).whole_box
    turn = 2.1
    x_m, y_m = 20 * math.cos(turn) - math.sin(turn), 20 * math.sin(turn) + math.cos(turn)
    turned = only(EMPTY, car(x_m, y_m, 0.4 + turn), Viewpoint(x_m=0.0, y_m=0.0, yaw_rad=turn)).whole_box
    assert np.abs(np.subtract(ahead, turned)).max() <= 1


def test_the_edge_of_a_house_cuts_a_car_at_the_column_worked_out_by_hand() -> None:
    # The house's near face is 10 m ahead and ends 1 m left of the axis: column 320 - 320 * 1 / 10.
    house = Building(x_m=14.3, y_m=-4.0, yaw_rad=0.0, length_m=6.0, width_m=10.0, height_m=9.0, look=1)
    renderer = Renderer(StreetScene(buildings=(house,)), GREY_NOON, CAMERA, 1)
    box = only(renderer, car(24.0, 1.8, math.pi / 2)).box
    assert box is not None
    assert abs(box.x_max_px - 288) <= 1


@settings(max_examples=60, deadline=None)
@given(
    x_m=st.floats(5.5, 60),
    y_m=st.floats(-25, 25),
    yaw_rad=st.floats(-4, 4),
    look=st.integers(0, 400),
    overturned=st.booleans(),
)
def test_a_silhouette_stays_within_its_box_in_the_world(
    x_m: float, y_m: float, yaw_rad: float, look: int, overturned: bool
) -> None:
    body = car(x_m, y_m, yaw_rad, BodyKind.OVERTURNED_VEHICLE if overturned else BodyKind.VEHICLE, look)
    view = view_from(CAMERA, ORIGIN)
    corners = footprint(x_m, y_m, yaw_rad, body.length_m, body.width_m)
    prism = np.vstack([np.column_stack((corners, np.full(4, z_m))) for z_m in (0.0, body.height_m)])
    pixels = view.pixels(view.to_camera(prism)) + 0.5
    (left, top), (right, bottom) = pixels.min(axis=0), pixels.max(axis=0)
    found = visible_bodies(EMPTY.frame(ORIGIN, [body], 0.0))
    if left > 638 or right < 2:
        return
    if left > 2 and right < 638:
        assert len(found) == 1
    for seen in found:
        box = seen.whole_box
        assert left - 1.6 <= box.x_min_px
        assert box.x_max_px <= right + 1.6
        assert top - 1.6 <= box.y_min_px
        assert box.y_max_px <= bottom + 1.6
        if left > 2 and right < 638:
            assert (box.y_max_px - box.y_min_px) >= 0.5 * (min(bottom, 360) - max(top, 0)) - 2


@settings(max_examples=100, deadline=None)
@given(st.lists(st.tuples(*[st.floats(-9, 9)] * 3), min_size=3, max_size=7), st.floats(0.1, 2))
def test_what_is_left_of_a_polygon_lies_beyond_the_near_plane(
    points: list[tuple[float, float, float]], near_m: float
) -> None:
    corners = np.array(points)
    kept = beyond_near(corners, near_m)
    assert (kept[:, 0] >= near_m - 1e-9).all()
    inside = corners[corners[:, 0] >= near_m]
    assert all((np.abs(kept - corner).sum(axis=1) == 0).any() for corner in inside)


def test_a_van_that_reaches_behind_the_camera_is_cut_and_not_turned_over() -> None:
    van = Body(
        id=7,
        kind=BodyKind.VEHICLE,
        x_m=2.0,
        y_m=1.7,
        yaw_rad=0.0,
        length_m=5.6,
        width_m=2.0,
        height_m=2.3,
        look=1,
    )
    frame = EMPTY.frame(ORIGIN, [van], 0.0)
    (found,) = visible_bodies(frame)
    assert found.depth_m == 0.0
    assert found.box is not None
    # Its front corner is 3.5 m ahead of the camera and 0.7 m or more to the left.
    assert found.box.x_min_px == 0
    assert found.box.x_max_px <= 320 - 320 * 0.7 / 3.5 + 2
    assert found.visible_px > 0.15 * frame.ids.size


@pytest.mark.parametrize("x_m", [-6.0, -3.0])
def test_what_is_behind_the_camera_is_not_seen(x_m: float) -> None:
    frame = EMPTY.frame(ORIGIN, [car(x_m, 0.0)], 0.0)
    assert visible_bodies(frame) == ()
    assert not frame.ids.any()


@pytest.mark.parametrize("size", [(640, 360), (320, 192), (1280, 720), (800, 600), (101, 37)])
def test_any_size_shows_the_same_street(size: tuple[int, int]) -> None:
    camera = PictureCamera(width_px=size[0], height_px=size[1])
    frame = Renderer(StreetScene(), GREY_NOON, camera, 1).frame(ORIGIN, [car(11.3, 1.0)], 0.0)
    assert frame.image.shape == (size[1], size[0], 3)
    assert frame.image.dtype == np.uint8
    assert frame.ids.shape == (size[1], size[0])
    assert frame.ids.dtype == np.int32
    (found,) = visible_bodies(frame)
    wide = only(EMPTY, car(11.3, 1.0)).whole_box
    scale = size[0] / 640
    assert (
        abs((found.whole_box.x_max_px - found.whole_box.x_min_px) - scale * (wide.x_max_px - wide.x_min_px))
        <= 2
    )
