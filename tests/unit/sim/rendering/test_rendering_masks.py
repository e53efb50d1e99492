import math

import cv2
import numpy as np
import pytest

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
from brink.sim.world.scenario import TimeOfDay, Weather

CAMERA = PictureCamera(width_px=640, height_px=360)
ORIGIN = Viewpoint(x_m=0.0, y_m=0.0, yaw_rad=0.0)
GREY_NOON = Light(time_of_day=TimeOfDay.NOON, weather=Weather.CLOUDY)
EMPTY = Renderer(StreetScene(), GREY_NOON, CAMERA, 1)


def body(
    number: int,
    kind: BodyKind,
    x_m: float,
    y_m: float,
    size: tuple[float, float, float],
    yaw_rad: float = 0.0,
    *,
    braking: bool = False,
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
        look=number,
        braking=braking,
    )


def van(number: int, x_m: float, y_m: float, yaw_rad: float = 0.0, length_m: float = 5.6) -> Body:
    return body(number, BodyKind.VEHICLE, x_m, y_m, (length_m, 2.0, 2.4), yaw_rad)


def person(number: int, x_m: float, y_m: float) -> Body:
    return body(number, BodyKind.PERSON, x_m, y_m, (0.5, 0.5, 1.7), math.pi / 2)


def draw(*bodies: Body) -> tuple[Frame, dict[int, VisibleBody]]:
    frame = EMPTY.frame(ORIGIN, bodies, 0.0)
    return frame, {found.id: found for found in visible_bodies(frame)}


@pytest.mark.parametrize("kind", list(BodyKind))
def test_a_body_alone_is_wholly_visible_and_boxed_by_its_pixels(kind: BodyKind) -> None:
    size = (0.5, 0.5, 1.7) if kind is BodyKind.PERSON else (4.4, 1.8, 1.5)
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


def test_a_person_before_a_van_is_wholly_visible() -> None:
    alone, _ = draw(van(1, 16.0, 0.0))
    frame, found = draw(van(1, 16.0, 0.0), person(2, 10.0, 0.0))
    assert found[2].visible_share == 1.0
    covered = int(((alone.ids == 1) & (frame.ids == 2)).sum())
    assert covered > 100
    assert found[1].whole_px - found[1].visible_px == covered


def test_a_house_over_half_of_a_car_leaves_half_of_it() -> None:
    house = Building(x_m=14.3, y_m=-5.0, yaw_rad=0.0, length_m=6.0, width_m=10.0, height_m=9.0, look=1)
    renderer = Renderer(StreetScene(buildings=(house,)), GREY_NOON, CAMERA, 1)
    car = body(1, BodyKind.VEHICLE, 25.0, 0.0, (4.4, 1.8, 1.5))
    (found,) = visible_bodies(renderer.frame(ORIGIN, [car], 0.0))
    assert found.visible_share == pytest.approx(0.5, abs=0.03)


def test_a_van_over_a_third_of_a_wall_of_a_van_leaves_what_geometry_says() -> None:
    # The far van stands across the axis, its side 19 m away; the near one ends level with a column through it.
    far = van(1, 21.3, 0.0, math.pi / 2)
    near = van(2, 12.3, -1.2)
    _, found = draw(far, near)
    edge = found[2].whole_box.x_min_px
    whole = found[1].whole_box
    expected = (edge - whole.x_min_px) / (whole.x_max_px - whole.x_min_px)
    assert 0.2 < expected < 0.8
    assert found[1].visible_share == pytest.approx(expected, abs=0.06)


@pytest.mark.parametrize(("y_m", "share"), [(-1.7, 1.0), (-4.9, 0.0)])
def test_a_person_beside_a_long_bus_is_ordered_by_the_side_they_are_on(y_m: float, share: float) -> None:
    # The bus's middle is nearer than the person either way: distances alone would give the same order twice.
    bus = body(1, BodyKind.VEHICLE, 9.5, -3.2, (12.0, 2.5, 3.0))
    _, found = draw(bus, person(2, 13.5, y_m))
    assert found[2].visible_share == share


def test_the_mask_follows_the_picture() -> None:
    dark = body(1, BodyKind.VEHICLE, 12.0, 0.4, (4.4, 1.8, 1.5), 0.2)
    bright = body(1, BodyKind.VEHICLE, 12.0, 0.4, (4.4, 1.8, 1.5), 0.2, braking=True)
    (before, _), (after, _) = draw(dark), draw(bright)
    changed = (before.image != after.image).any(axis=2)
    grown = cv2.dilate((before.ids == 1).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    assert changed.sum() > 50
    assert not (changed & ~grown).any()


def test_the_picture_changes_only_around_the_body_and_its_shadow() -> None:
    street, _ = draw()
    frame, found = draw(person(3, 9.0, 1.0))
    changed = (street.image != frame.image).any(axis=2)
    mask = frame.ids == 3
    assert changed[cv2.erode(mask.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0].mean() > 0.98
    box = found[3].whole_box
    above = changed.copy()
    above[box.y_min_px - 1 :] = False
    assert not above.any()


def test_parked_vehicles_have_ids_too() -> None:
    parked = van(40, 14.0, -3.0)
    renderer = Renderer(StreetScene(parked=(parked,)), GREY_NOON, CAMERA, 1)
    found = {item.id: item for item in visible_bodies(renderer.frame(ORIGIN, [person(2, 10.0, 1.0)], 0.0))}
    assert set(found) == {2, 40}
    assert found[40].depth_m == pytest.approx(14.0 - 2.8 - 1.3)
