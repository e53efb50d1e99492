"""Pictures and labels: where bodies appear, how much of them is visible, and how the mask follows the picture."""

import math

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.sample_street import fallen_tree, sample_street, sample_traffic
from brink.sim.rendering import (
    Body,
    BodyKind,
    Building,
    Frame,
    Light,
    PictureCamera,
    Renderer,
    StreetScene,
    Viewpoint,
    VisibleBody,
    visible_bodies,
)
from brink.sim.rendering.canvas import seen_bodies
from brink.sim.rendering.scene import footprint
from brink.sim.rendering.view import clip_near, make_view
from brink.sim.world.scenario import TimeOfDay, Weather

CAMERA = PictureCamera(width_px=640, height_px=360)
ORIGIN = Viewpoint(x_m=0.0, y_m=0.0, yaw_rad=0.0)
GREY_NOON = Light(time_of_day=TimeOfDay.NOON, weather=Weather.CLOUDY)
EMPTY = Renderer(StreetScene(), GREY_NOON, CAMERA, 1)
CAR_M = (4.4, 1.8, 1.5)


def body(
    number: int,
    kind: BodyKind,
    x_m: float,
    y_m: float,
    size: tuple[float, float, float],
    yaw_rad: float = 0.0,
    *,
    braking: bool = False,
    look: int | None = None,
) -> Body:
    return Body(
        id=number,
        kind=kind,
        x_m=x_m,
        y_m=y_m,
        yaw_rad=yaw_rad,
        length_m=size[0],
        width_m=size[1],
        height_m=size[2],
        look=number if look is None else look,
        braking=braking,
    )


def car(
    x_m: float, y_m: float, yaw_rad: float = 0.0, kind: BodyKind = BodyKind.VEHICLE, look: int = 3
) -> Body:
    return body(7, kind, x_m, y_m, CAR_M, yaw_rad, look=look)


def van(number: int, x_m: float, y_m: float, yaw_rad: float = 0.0, length_m: float = 5.6) -> Body:
    return body(number, BodyKind.VEHICLE, x_m, y_m, (length_m, 2.0, 2.4), yaw_rad)


def person(number: int, x_m: float, y_m: float) -> Body:
    return body(number, BodyKind.PERSON, x_m, y_m, (0.5, 0.5, 1.7), math.pi / 2)


def draw(*bodies: Body) -> tuple[Frame, dict[int, VisibleBody]]:
    frame = EMPTY.frame(ORIGIN, bodies, 0.0)
    return frame, {found.id: found for found in visible_bodies(frame)}


def only(renderer: Renderer, one: Body, viewpoint: Viewpoint = ORIGIN) -> VisibleBody:
    (found,) = visible_bodies(renderer.frame(viewpoint, [one], 0.0))
    return found


def test_a_car_seen_from_the_side_covers_the_pixels_computed_by_hand() -> None:
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


def test_a_person_has_the_position_and_height_computed_by_hand() -> None:
    walker = body(7, BodyKind.PERSON, 9.3, 2.0, (0.5, 0.5, 1.8), 1.0, look=4)
    box = only(EMPTY, walker).whole_box
    assert abs(box.y_max_px - (180 + 320 * 1.7 / 8)) <= 1.5
    assert abs(box.y_min_px - (180 - 320 * 0.1 / 8)) <= 1.5
    assert abs((box.x_min_px + box.x_max_px) / 2 - (320 - 320 * 2.0 / 8)) <= 2


@settings(max_examples=60, deadline=None)
@given(
    look=st.integers(0, 4000),
    yaw_rad=st.floats(-4, 4),
    phase=st.floats(0, 7),
    height_m=st.floats(1.1, 1.9),
    x_m=st.floats(4, 40),
)
def test_people_of_all_looks_are_as_tall_as_they_should_be_and_stand_on_the_ground(
    look: int, yaw_rad: float, phase: float, height_m: float, x_m: float
) -> None:
    walker = Body(
        id=7,
        kind=BodyKind.PERSON,
        x_m=x_m,
        y_m=0.0,
        yaw_rad=yaw_rad,
        length_m=0.45,
        width_m=0.55,
        height_m=height_m,
        look=look,
        phase=phase,
    )
    box = only(EMPTY, walker).whole_box
    depth_m = x_m - 1.3
    assert abs(box.y_min_px - (180 - 320 * (height_m - 1.7) / depth_m)) <= 2.5
    feet_px = 180 + 320 * 1.7 / depth_m
    # A foot of a long stride is nearer to the camera than the body's middle, or farther away.
    assert abs(min(box.y_max_px, 360) - min(feet_px, 360)) <= 2.5 + 320 * 1.7 * 0.6 / depth_m**2
    assert (box.x_max_px - box.x_min_px) <= 320 * 1.3 * height_m / depth_m + 3


def test_pitch_moves_the_picture_by_the_focal_length_times_its_tangent() -> None:
    level = only(EMPTY, car(31.3, 0.0)).whole_box
    up = only(EMPTY, car(31.3, 0.0), Viewpoint(x_m=0.0, y_m=0.0, yaw_rad=0.0, pitch_rad=0.05)).whole_box
    assert abs((up.y_min_px - level.y_min_px) - 320 * math.tan(0.05)) <= 1.5


def test_the_viewpoint_turns_with_the_ego() -> None:
    ahead = only(EMPTY, car(20.0, 1.0, 0.4)).whole_box
    turn = 2.1
    x_m, y_m = 20 * math.cos(turn) - math.sin(turn), 20 * math.sin(turn) + math.cos(turn)
    turned = only(EMPTY, car(x_m, y_m, 0.4 + turn), Viewpoint(x_m=0.0, y_m=0.0, yaw_rad=turn)).whole_box
    assert np.abs(np.subtract(ahead, turned)).max() <= 1


def test_the_edge_of_a_house_hides_a_car_from_the_column_computed_by_hand() -> None:
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
def test_silhouette_stays_in_its_box(
    x_m: float, y_m: float, yaw_rad: float, look: int, overturned: bool
) -> None:
    kind = BodyKind.OVERTURNED_VEHICLE if overturned else BodyKind.VEHICLE
    vehicle = car(x_m, y_m, yaw_rad, kind, look)
    view = make_view(CAMERA, ORIGIN)
    corners = footprint(x_m, y_m, yaw_rad, vehicle.length_m, vehicle.width_m)
    prism = np.vstack([np.column_stack((corners, np.full(4, z_m))) for z_m in (0.0, vehicle.height_m)])
    pixels = view.project(view.to_camera(prism)) + 0.5
    (left, top), (right, bottom) = pixels.min(axis=0), pixels.max(axis=0)
    found = visible_bodies(EMPTY.frame(ORIGIN, [vehicle], 0.0))
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
def test_clipped_polygon_lies_past_near_plane(
    points: list[tuple[float, float, float]], near_m: float
) -> None:
    corners = np.array(points)
    kept = clip_near(corners, near_m)
    assert (kept[:, 0] >= near_m - 1e-9).all()
    inside = corners[corners[:, 0] >= near_m]
    assert all((np.abs(kept - corner).sum(axis=1) == 0).any() for corner in inside)


def test_a_van_that_extends_behind_the_camera_is_clipped_and_not_inverted() -> None:
    near = body(7, BodyKind.VEHICLE, 2.0, 1.7, (5.6, 2.0, 2.3), look=1)
    frame = EMPTY.frame(ORIGIN, [near], 0.0)
    (found,) = visible_bodies(frame)
    assert found.depth_m == 0.0
    assert found.box is not None
    # Its front corner is 3.5 m ahead of the camera and 0.7 m or more to the left.
    assert found.box.x_min_px == 0
    assert found.box.x_max_px <= 320 - 320 * 0.7 / 3.5 + 2
    assert found.visible_px > 0.15 * frame.ids.size


@pytest.mark.parametrize("x_m", [-6.0, -3.0])
def test_bodies_behind_the_camera_are_not_visible(x_m: float) -> None:
    frame = EMPTY.frame(ORIGIN, [car(x_m, 0.0)], 0.0)
    assert visible_bodies(frame) == ()
    assert not frame.ids.any()


@pytest.mark.parametrize("kind", list(BodyKind))
def test_a_single_body_is_fully_visible_and_tightly_boxed(kind: BodyKind) -> None:
    size = (0.5, 0.5, 1.7) if kind is BodyKind.PERSON else CAR_M
    frame, found = draw(body(5, kind, 12.0, 0.5, size, 0.4))
    assert found[5].visible_share == 1.0
    assert set(np.unique(frame.ids).tolist()) == {0, 5}
    rows, columns = np.nonzero(frame.ids == 5)
    tight = (columns.min(), rows.min(), columns.max() + 1, rows.max() + 1)
    assert found[5].box == found[5].whole_box == tight
    assert found[5].visible_px == len(rows)


def test_a_person_behind_a_van_is_hidden_and_still_labelled() -> None:
    frame, found = draw(van(1, 10.0, 0.0), person(2, 16.0, 0.0))
    assert 2 not in frame.ids
    assert found[2].visible_share == 0.0
    assert found[2].box is None
    assert found[2].whole_px > 100
    assert found[1].visible_share == 1.0


def test_a_person_in_front_of_a_van_is_fully_visible() -> None:
    alone, _ = draw(van(1, 16.0, 0.0))
    frame, found = draw(van(1, 16.0, 0.0), person(2, 10.0, 0.0))
    assert found[2].visible_share == 1.0
    covered = int(((alone.ids == 1) & (frame.ids == 2)).sum())
    assert covered > 100
    assert found[1].whole_px - found[1].visible_px == covered


def test_a_partly_covered_van_has_the_visible_share_that_geometry_predicts() -> None:
    # The far van stands across the axis, its side 19 m away; the near van's edge cuts its silhouette.
    far = van(1, 21.3, 0.0, math.pi / 2)
    near = van(2, 12.3, -1.2)
    _, found = draw(far, near)
    edge = found[2].whole_box.x_min_px
    whole = found[1].whole_box
    expected = (edge - whole.x_min_px) / (whole.x_max_px - whole.x_min_px)
    assert 0.2 < expected < 0.8
    assert found[1].visible_share == pytest.approx(expected, abs=0.06)


@pytest.mark.parametrize(("y_m", "share"), [(-1.7, 1.0), (-4.9, 0.0)])
def test_a_person_beside_a_long_bus_is_visible_only_on_the_near_side(y_m: float, share: float) -> None:
    # The bus's centre is nearer than the person in both cases, so distance alone would not tell them apart.
    bus = body(1, BodyKind.VEHICLE, 9.5, -3.2, (12.0, 2.5, 3.0))
    _, found = draw(bus, person(2, 13.5, y_m))
    assert found[2].visible_share == share


def test_the_mask_follows_the_picture() -> None:
    dark = body(1, BodyKind.VEHICLE, 12.0, 0.4, CAR_M, 0.2)
    bright = body(1, BodyKind.VEHICLE, 12.0, 0.4, CAR_M, 0.2, braking=True)
    (before, _), (after, _) = draw(dark), draw(bright)
    changed = (before.image != after.image).any(axis=2)
    grown = cv2.dilate((before.ids == 1).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    assert changed.sum() > 50
    assert not (changed & ~grown).any()


def test_parked_vehicles_have_labels() -> None:
    parked = van(40, 14.0, -3.0)
    renderer = Renderer(StreetScene(parked=(parked,)), GREY_NOON, CAMERA, 1)
    found = {item.id: item for item in visible_bodies(renderer.frame(ORIGIN, [person(2, 10.0, 1.0)], 0.0))}
    assert set(found) == {2, 40}
    assert found[40].depth_m == pytest.approx(14.0 - 2.8 - 1.3)


def test_seen_bodies_are_the_visible_ones_with_the_same_boxes_and_shares() -> None:
    renderer = Renderer(sample_street(), GREY_NOON, CAMERA, 3)
    clear = 0
    for step in range(6):
        viewpoint = Viewpoint(x_m=5.0 * step, y_m=-1.75, yaw_rad=0.4 * step, pitch_rad=0.02 * step)
        crowd = (*sample_traffic(0.3 * step), fallen_tree(51, 14.0, 1.5, yaw_rad=0.4))
        frame = renderer.frame(viewpoint, crowd, 0.0)
        expected = [
            (found.id, found.kind, found.box, box.y_max_px - box.y_min_px >= 9 and found.visible_share >= 0.3)
            for found in visible_bodies(frame)
            if (box := found.box) is not None
        ]
        assert list(seen_bodies(frame, least_px=(0.0, 9), least_share=0.3)) == expected
        clear += sum(row[-1] for row in expected)
    assert clear > 10


def test_a_house_that_covers_half_of_a_car_leaves_half_of_it_visible() -> None:
    house = Building(x_m=14.3, y_m=-5.0, yaw_rad=0.0, length_m=6.0, width_m=10.0, height_m=9.0, look=1)
    renderer = Renderer(StreetScene(buildings=(house,)), GREY_NOON, CAMERA, 1)
    car = body(1, BodyKind.VEHICLE, 25.0, 0.0, CAR_M)
    (found,) = visible_bodies(renderer.frame(ORIGIN, [car], 0.0))
    assert found.visible_share == pytest.approx(0.5, abs=0.03)
