from collections.abc import Iterator

import numpy as np
import pytest

from brink.sim.rendering import Light, Material, PictureCamera, Renderer, Viewpoint, visible_bodies
from brink.sim.rendering.street import FIRST_PARKED_ID, street_of
from brink.sim.world.road import Road, build_road
from brink.sim.world.scenario import RoadCurve, TimeOfDay, Weather
from brink.sim.world.scenery import fixtures


def roads() -> Iterator[Road]:
    for curve in RoadCurve:
        for road_id in range(3):
            yield build_road(curve, road_id, 0)


@pytest.mark.parametrize("road", list(roads()), ids=lambda road: f"{road.curve}-{road.style.lane_width_m}")
def test_every_road_becomes_a_street_with_all_that_stands_along_it(road: Road) -> None:
    street = street_of(road)
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


def test_parked_vehicles_are_seen_and_face_as_their_traffic_does() -> None:
    road = build_road(RoadCurve.STRAIGHT, 1, 0)
    street = street_of(road)
    assert all((np.cos(body.yaw_rad) > 0) == (body.y_m < 0) for body in street.parked)
    light = Light(time_of_day=TimeOfDay.NOON, weather=Weather.CLEAR)
    renderer = Renderer(street, light, PictureCamera(width_px=320, height_px=192), 1)
    x_m, y_m, yaw_rad = road.forward.pose_at(0.0)
    found = visible_bodies(renderer.frame(Viewpoint(x_m=x_m, y_m=y_m, yaw_rad=yaw_rad), (), 0.0))
    assert any(body.visible_share == 1.0 for body in found)
    assert any(body.visible_share < 1.0 for body in found)


def test_the_road_ahead_is_asphalt_and_what_lies_beside_it_is_not() -> None:
    road = build_road(RoadCurve.STRAIGHT, 0, 0)
    light = Light(time_of_day=TimeOfDay.NOON, weather=Weather.CLOUDY)
    renderer = Renderer(street_of(road), light, PictureCamera(width_px=320, height_px=192), 1)
    x_m, y_m, yaw_rad = road.forward.pose_at(0.0)
    image = renderer.frame(Viewpoint(x_m=x_m, y_m=y_m, yaw_rad=yaw_rad), (), 0.0).image.astype(int)
    asphalt, pavement = image[150:160, 150:170].mean(), image[150:160, 300:318].mean()
    assert pavement > 1.25 * asphalt
