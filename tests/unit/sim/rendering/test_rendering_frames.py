"""Frames: reproducible, valid, lit as their light says; and roads as streets that can be rendered."""

from collections.abc import Iterator
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rendered_pictures import CAMERA, NIGHT_RAIN, STREET, UNUSUAL, night

from benchmarks.sample_street import EGO, sample_traffic, vehicle
from brink.sim.rendering import (
    Body,
    BodyKind,
    Frame,
    Ground,
    InvalidCamera,
    InvalidScene,
    Light,
    Material,
    PictureCamera,
    Renderer,
    StreetScene,
    Tree,
    Viewpoint,
    visible_bodies,
)
from brink.sim.rendering.street import FIRST_PARKED_ID, street_from_road
from brink.sim.world.road import Road, build_road
from brink.sim.world.scenario import RoadCurve, TimeOfDay, Weather
from brink.sim.world.scenery import fixtures

NOON = Renderer(STREET, Light(time_of_day=TimeOfDay.NOON, weather=Weather.CLEAR), CAMERA, 5)


@cache
def expected(*bodies: Body) -> Frame:
    """Return the first frame at noon with some bodies."""
    return NOON.frame(EGO, bodies, 0.0)


@settings(max_examples=8, deadline=None)
@given(st.permutations((*sample_traffic(), *UNUSUAL)))
def test_the_order_of_the_bodies_does_not_matter(bodies: list[Body]) -> None:
    sorted_ = expected(*sample_traffic(), *UNUSUAL)
    found = NOON.frame(EGO, bodies, 0.0)
    assert np.array_equal(found.image, sorted_.image)
    assert np.array_equal(found.ids, sorted_.ids)


@pytest.mark.long("draws many pictures")
def test_light_and_weather_change_the_picture_and_never_the_mask() -> None:
    noon = expected(*sample_traffic())
    for time_of_day in TimeOfDay:
        for weather in Weather:
            if (time_of_day, weather) == (TimeOfDay.NOON, Weather.CLEAR):
                continue
            light = Light(time_of_day=time_of_day, weather=weather)
            found = Renderer(STREET, light, CAMERA, 5).frame(EGO, sample_traffic(), 0.0)
            assert np.array_equal(found.ids, noon.ids)
            assert not np.array_equal(found.image, noon.image)


def test_rain_falls_with_time_and_leaves_the_mask_alone() -> None:
    first, second = (night().frame(EGO, sample_traffic(), time_s) for time_s in (0.0, 0.1))
    assert not np.array_equal(first.image, second.image)
    assert np.array_equal(first.ids, second.ids)


def test_a_frame_does_not_depend_on_the_frames_before_it() -> None:
    far = Viewpoint(x_m=40.0, y_m=-1.0, yaw_rad=0.7, pitch_rad=0.04)
    night().frame(EGO, sample_traffic(), 0.0)
    fresh = Renderer(STREET, NIGHT_RAIN, CAMERA, 5)
    assert np.array_equal(night().frame(far, UNUSUAL, 2.0).image, fresh.frame(far, UNUSUAL, 2.0).image)


def test_the_seed_changes_the_picture_and_not_the_mask() -> None:
    other = Renderer(STREET, Light(time_of_day=TimeOfDay.NOON, weather=Weather.CLEAR), CAMERA, 6)
    noon, found = expected(*sample_traffic()), other.frame(EGO, sample_traffic(), 0.0)
    assert not np.array_equal(found.image, noon.image)
    assert np.array_equal(found.ids, noon.ids)


@pytest.mark.parametrize("name", ["length_m", "width_m", "height_m"])
@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf")])
def test_impossible_sizes_are_refused(name: str, value: float) -> None:
    sizes = {"length_m": 4.0, "width_m": 2.0, "height_m": 1.5, name: value}
    with pytest.raises(InvalidScene, match=name):
        Body(id=1, kind=BodyKind.VEHICLE, x_m=0.0, y_m=0.0, yaw_rad=0.0, look=0, **sizes)  # type: ignore[arg-type]


def test_impossible_trees_and_surfaces_are_refused() -> None:
    with pytest.raises(InvalidScene, match="crown_m"):
        Tree(x_m=0.0, y_m=0.0, height_m=5.0, crown_m=0.0, look=1)
    with pytest.raises(InvalidScene, match="points"):
        Ground(material=Material.GRASS, points=np.zeros((2, 2)))


@pytest.mark.parametrize("number", [0, -3, 2**31])
def test_ids_must_be_positive_and_fit_the_mask(number: int) -> None:
    with pytest.raises(InvalidScene, match=r"body\.id"):
        vehicle(number, 10.0, 0.0)


def test_ids_must_be_unique_including_parked_vehicles() -> None:
    twice = vehicle(9, 10.0, 0.0)
    with pytest.raises(InvalidScene, match="9 twice"):
        NOON.frame(EGO, [twice, twice], 0.0)
    with pytest.raises(InvalidScene, match="1001 twice"):
        NOON.frame(EGO, [vehicle(1001, 10.0, 0.0)], 0.0)
    with pytest.raises(InvalidScene, match="9 twice"):
        StreetScene(parked=(twice, twice))


@pytest.mark.parametrize(
    "arguments",
    [
        {"width_px": 0, "height_px": 10},
        {"width_px": 10, "height_px": -1},
        {"width_px": 10, "height_px": 10, "fov_deg": 180.0},
        {"width_px": 10, "height_px": 10, "height_m": 0.0},
    ],
)
def test_impossible_cameras_are_refused(arguments: dict[str, float]) -> None:
    with pytest.raises(InvalidCamera):
        PictureCamera(**arguments)  # type: ignore[arg-type]


def test_a_viewpoint_must_be_finite() -> None:
    with pytest.raises(InvalidCamera):
        Viewpoint(x_m=float("nan"), y_m=0.0, yaw_rad=0.0)


def roads() -> Iterator[Road]:
    for curve in RoadCurve:
        for road_id in range(3):
            yield build_road(curve, road_id, 0)


@pytest.mark.parametrize("road", list(roads()), ids=lambda road: f"{road.curve}-{road.style.lane_width_m}")
def test_every_road_becomes_a_street_with_all_its_fixtures(road: Road) -> None:
    street = street_from_road(road)
    kinds = [fixture.kind for fixture in fixtures(road)]
    assert len(street.buildings) == kinds.count("building")
    assert len(street.trees) == kinds.count("tree")
    assert [body.id for body in street.parked] == list(
        range(FIRST_PARKED_ID, FIRST_PARKED_ID + kinds.count("parked-car"))
    )
    materials = {surface.material for surface in street.ground}
    assert materials >= {
        Material.ASPHALT,
        Material.PAVEMENT,
        Material.KERB,
        Material.MARKING,
        Material.CROSSING,
    }


def test_parked_vehicles_are_visible_and_face_with_their_traffic() -> None:
    road = build_road(RoadCurve.STRAIGHT, 1, 0)
    street = street_from_road(road)
    assert all((np.cos(body.yaw_rad) > 0) == (body.y_m < 0) for body in street.parked)
    light = Light(time_of_day=TimeOfDay.NOON, weather=Weather.CLEAR)
    renderer = Renderer(street, light, PictureCamera(width_px=320, height_px=192), 1)
    x_m, y_m, yaw_rad = road.forward.pose_at(0.0)
    found = visible_bodies(renderer.frame(Viewpoint(x_m=x_m, y_m=y_m, yaw_rad=yaw_rad), (), 0.0))
    assert any(body.visible_share == 1.0 for body in found)
    assert any(body.visible_share < 1.0 for body in found)
