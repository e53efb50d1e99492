"""Street furniture: on the pavements, out of everybody's way, and only seen."""

from dataclasses import replace

import numpy as np
import pytest

from brink.sim.aeb.specification import CROSSING_M, AebScenario, Occluder
from brink.sim.aeb.street import EGO_FRONT_M, KERB_M, LANE_Y_M, PAVEMENT_M, PERSON_SIZE_M, make_street
from brink.sim.rendering import Light, PictureCamera, Renderer, Viewpoint, visible_bodies
from brink.sim.rendering.scene import FurnitureKind, footprint
from brink.sim.world.scenario import TimeOfDay, Weather

SEEDS = range(40)
SCENARIO = AebScenario(
    time_of_day=TimeOfDay.NOON,
    weather=Weather.CLOUDY,
    occluder=Occluder.CAR,
    crossing_m=50.0,
    arrival_s=0.0,
    oncoming_m=60.0,
)


@pytest.mark.parametrize("crossing_m", CROSSING_M)
def test_furniture_stands_on_the_pavements_and_in_nobodys_way(crossing_m: float) -> None:
    line_x_m = EGO_FRONT_M + crossing_m
    kinds = set()
    for seed in SEEDS:
        street = make_street(replace(SCENARIO, crossing_m=crossing_m), seed)
        stroller = street.actors[1].body
        for item in street.scene.furniture:
            corners = footprint(item.x_m, item.y_m, item.yaw_rad, item.length_m, item.width_m)
            beside_m = np.abs(corners[:, 1])
            assert beside_m.min() > KERB_M
            assert beside_m.max() < KERB_M + PAVEMENT_M + 0.3
            assert np.abs(corners[:, 0] - line_x_m).min() > 0.6
            if item.y_m < 0:
                low_m, high_m = corners[:, 1].min() - stroller.y_m, stroller.y_m - corners[:, 1].max()
                assert max(low_m, high_m) > 0.5 * PERSON_SIZE_M[1]
            kinds.add(item.kind)
    assert kinds == set(FurnitureKind)


def test_furniture_hides_bodies_and_has_no_label() -> None:
    street = make_street(SCENARIO, 5)
    light = Light(time_of_day=TimeOfDay.NOON, weather=Weather.CLOUDY)
    camera = PictureCamera(width_px=320, height_px=192)
    view = Viewpoint(x_m=0.0, y_m=LANE_Y_M, yaw_rad=0.0)
    bodies = [actor.current_body() for actor in street.actors]
    bare = Renderer(replace(street.scene, furniture=()), light, camera, 1).frame(view, bodies, 0.0)
    frame = Renderer(street.scene, light, camera, 1).frame(view, bodies, 0.0)
    assert not np.array_equal(frame.image, bare.image)
    assert set(np.unique(frame.ids)) <= set(np.unique(bare.ids))
    changed = frame.ids != bare.ids
    assert not frame.ids[changed].any()
    whole = {body.id: body.whole_box for body in visible_bodies(bare)}
    assert whole == {body.id: body.whole_box for body in visible_bodies(frame)}
