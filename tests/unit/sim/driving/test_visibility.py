"""Visible shares against scenes whose share is known, and against rays through each pixel."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from brink.sim.driving.camera import Camera, Solid
from brink.sim.driving.interface import Box, ObstacleLabel
from brink.sim.driving.visibility import Screens
from brink.sim.plane import Rectangle

CAMERA = Camera()
WITHIN = 0.05


def person(x_m: float, y_m: float) -> Solid:
    return Solid(ObstacleLabel.PERSON, x_m, y_m, 0.0, 0.5, 0.5, 1.75)


def vehicle(
    x_m: float, y_m: float, height_m: float = 1.5, length_m: float = 4.4, yaw_rad: float = 0.0
) -> Solid:
    return Solid(ObstacleLabel.VEHICLE, x_m, y_m, yaw_rad, length_m, 1.8, height_m)


def screens(*bodies: Solid) -> Screens:
    footprints = [Rectangle.of(body) for body in bodies]
    return Screens(footprints, [body.height_m for body in bodies])


def visible(body: Solid, *others: Solid, still: Screens | None = None) -> float:
    """Return the visible share of a body from a camera at the origin that looks along x."""
    sights = CAMERA.sights(-CAMERA.forward_m, 0.0, 0.0, [body, *others], still)
    return {sight.body: sight.visible for sight in sights}[0]


def test_nothing_in_between_hides_nothing() -> None:
    assert visible(person(20.0, 0.0)) == 1.0
    assert visible(person(20.0, 0.0), vehicle(30.0, 0.0), still=screens(vehicle(20.0, 4.0))) == 1.0


def test_a_van_hides_a_person_right_behind_it() -> None:
    assert visible(person(20.0, 0.0), vehicle(12.0, 0.0, height_m=2.3)) == 0.0


def test_a_parked_car_leaves_the_upper_body_of_a_person_behind_it_visible() -> None:
    # The back edge of the roof is 1.5 m high and 2.2 m behind the car's middle, the person's front at 14.75 m.
    share = visible(person(15.0, 0.0), still=screens(vehicle(12.0, 0.0)))
    roof_m = 1.7 - 0.2 * 14.75 / 14.2
    assert share == pytest.approx((1.75 - roof_m) / 1.75, abs=WITHIN)


@pytest.mark.parametrize("shift_m", [-0.6, -0.45, -0.3, 0.0])
def test_a_wall_hides_the_part_that_is_beyond_its_edge(shift_m: float) -> None:
    # A wall from the camera's axis to the right hides what is right of the axis at twice its distance.
    wall = Solid(ObstacleLabel.VEHICLE, 10.0, -5.0 + 0.5 * shift_m, 0.0, 0.1, 10.0, 5.0)
    edge_m = 20.0 * 0.5 * shift_m / 10.05
    body = Solid(ObstacleLabel.VEHICLE, 21.0, 0.0, 0.0, 2.0, 1.8, 1.5)
    assert visible(body, still=screens(wall)) == pytest.approx((0.9 - edge_m) / 1.8, abs=WITHIN)


def test_a_car_around_a_corner_is_hidden_by_the_building_and_seen_once_the_corner_is_passed() -> None:
    building = Solid(ObstacleLabel.VEHICLE, 15.0, -10.0, 0.0, 10.0, 10.0, 12.0)
    crossing = vehicle(24.0, -16.0, yaw_rad=0.5 * math.pi)
    assert visible(crossing, still=screens(building)) == 0.0
    assert visible(vehicle(24.0, -3.0, yaw_rad=0.5 * math.pi), still=screens(building)) > 0.95


def test_a_body_is_seen_from_the_least_visible_share_on() -> None:
    wall = Solid(ObstacleLabel.VEHICLE, 10.0, -5.2, 0.0, 0.1, 10.0, 5.0)
    body = Solid(ObstacleLabel.VEHICLE, 21.0, 0.0, 0.0, 2.0, 1.8, 1.5)
    share = visible(body, still=screens(wall))
    for least, seen in ((share - 0.01, 1), (share + 0.01, 0)):
        camera = Camera(least_visible=least)
        assert len(camera.look(-camera.forward_m, 0.0, 0.0, [body], screens(wall))) == seen


def test_shares_agree_with_rays_through_every_part_of_the_image() -> None:
    rng = np.random.default_rng(4)
    errors = []
    for _ in range(25):
        bodies = [
            Solid(
                ObstacleLabel.VEHICLE,
                float(rng.uniform(6.0, 60.0)),
                float(rng.uniform(-12.0, 12.0)),
                float(rng.uniform(-math.pi, math.pi)),
                *(float(size) for size in rng.uniform((0.4, 0.4, 1.0), (6.0, 3.0, 4.0))),
            )
            for _ in range(8)
        ]
        apart = [body for body in bodies if abs(body.y_m) > 3.0 or body.x_m > 12.0]
        moving, still = apart[: len(apart) // 2], apart[len(apart) // 2 :]
        for sight in CAMERA.sights(-CAMERA.forward_m, 0.0, 0.0, moving, screens(*still)):
            others = [body for body in apart if body is not moving[sight.body]]
            errors.append(sight.visible - share_by_rays(sight.box, moving[sight.body], others))
    assert len(errors) > 40
    assert np.mean(np.abs(errors)) < 0.015
    assert np.mean(np.abs(errors) <= WITHIN) > 0.95


def share_by_rays(box: Box, body: Solid, others: list[Solid]) -> float:
    """Return the share of the pixels of a body, rendered alone, that show it among others."""
    _, x_min, x_max, y_min, y_max = box
    steps = (np.arange(60) + 0.5) / 60
    columns, rows = np.meshgrid(x_min + (x_max - x_min) * steps, y_min + (y_max - y_min) * steps)
    left = (CAMERA.centre_x_px - columns.ravel()) / CAMERA.focal_px
    up = (CAMERA.horizon_px - rows.ravel()) / CAMERA.focal_px
    rays = np.stack([np.ones_like(left), left, up], axis=1)
    own = first_hits_m(rays, body)
    nearest = np.min([first_hits_m(rays, other) for other in others], axis=0, initial=np.inf)
    return float((own < nearest)[np.isfinite(own)].mean())


def first_hits_m(rays: NDArray[np.float64], body: Solid) -> NDArray[np.float64]:
    """Return how far along each ray from the camera a body is hit; infinite if it is not."""
    cos_yaw, sin_yaw = math.cos(body.yaw_rad), math.sin(body.yaw_rad)
    turn = np.array([[cos_yaw, sin_yaw, 0.0], [-sin_yaw, cos_yaw, 0.0], [0.0, 0.0, 1.0]])
    origin = turn @ np.array([-body.x_m, -body.y_m, CAMERA.height_m])
    directions = rays @ turn.T
    low = np.array([-0.5 * body.length_m, -0.5 * body.width_m, 0.0])
    high = np.array([0.5 * body.length_m, 0.5 * body.width_m, body.height_m])
    with np.errstate(divide="ignore"):
        sides = np.stack([(low - origin) / directions, (high - origin) / directions])
    enters, leaves = sides.min(axis=0).max(axis=1), sides.max(axis=0).min(axis=1)
    return np.where((leaves >= enters) & (enters > 0.0), enters, np.inf)
