"""The images of the detector's camera: brake lights, traffic lights, ids, and where things are in them."""

import math

import numpy as np
import pytest

from brink.sim.aeb.street import Actor
from brink.sim.driving.camera import Camera, Solid
from brink.sim.driving.interface import LightState, ObstacleLabel
from brink.sim.perception.detector import find_detector
from brink.sim.rendering.canvas import visible_bodies
from brink.sim.rendering.renderer import Renderer
from brink.sim.rendering.scene import (
    Body,
    BodyKind,
    Building,
    FloatArray,
    Lamp,
    Light,
    Picture,
    PictureCamera,
    SignalGroup,
    StreetScene,
    TrafficLight,
    Viewpoint,
)
from brink.sim.rendering.signals import lit_lamp
from brink.sim.rendering.street import FIRST_PARKED_ID, street_from_road
from brink.sim.rendering.view import PITCHES_KEPT, make_view
from brink.sim.urban.camera import RoadCamera
from brink.sim.world.ego import EgoCar
from brink.sim.world.road import CYCLE_S, SignalPlan, build_road, ego_route
from brink.sim.world.scenario import DrivingTask, RoadCurve, TimeOfDay, UrbanScenario, Weather
from brink.sim.world.vehicle import brake_lights_on
from brink.sim.world.world import UrbanWorld, make_world

NOON = Light(time_of_day=TimeOfDay.NOON, weather=Weather.CLEAR)
NIGHT = Light(time_of_day=TimeOfDay.NIGHT, weather=Weather.CLEAR)
PICTURE = PictureCamera(width_px=640, height_px=360)
EMPTY = StreetScene()
ORIGIN = Viewpoint(x_m=0.0, y_m=0.0, yaw_rad=0.0)


def car(x_m: float = 12.0, y_m: float = 0.0, *, braking: bool = False, height_m: float = 1.5) -> Body:
    return Body(
        id=1,
        kind=BodyKind.VEHICLE,
        x_m=x_m,
        y_m=y_m,
        yaw_rad=0.0,
        length_m=4.4,
        width_m=1.8,
        height_m=height_m,
        look=3,
        braking=braking,
    )


def world_of(curve: RoadCurve, *, road_id: int = 1) -> UrbanWorld:
    scenario = UrbanScenario(
        time_of_day=TimeOfDay.NOON,
        weather=Weather.CLEAR,
        pedestrians=18,
        road_curve=curve,
        road_id=road_id,
        road_length=0,
        driving_task=DrivingTask.FOLLOW_ROAD,
    )
    return make_world(scenario, 3)


def eyes_of(world: UrbanWorld, light: Light = NOON) -> RoadCamera:
    detector = find_detector("brink-det@2")
    return RoadCamera(world, light, seed=3, detector=detector, threshold=0.5, camera=Camera())


@pytest.mark.parametrize(
    ("speed_mps", "accel_mps2", "on"),
    [(8.0, 0.0, False), (8.0, -0.6, False), (8.0, -0.8, True), (8.0, -5.0, True), (0.0, 0.0, True)],
)
def test_brake_lights_are_on_above_the_deceleration_of_the_regulation_and_at_a_standstill(
    speed_mps: float, accel_mps2: float, on: bool
) -> None:
    assert brake_lights_on(speed_mps, accel_mps2) is on


def red(image: Picture) -> FloatArray:
    """Return by how much each pixel is red rather than grey, shape ``(h, w)``."""
    channels = image.astype(np.float64)
    more: FloatArray = np.maximum(channels[..., 0] - channels[..., 1:].max(axis=2), 0.0)
    return more


@pytest.mark.parametrize("light", [NOON, NIGHT], ids=["noon", "night"])
@pytest.mark.parametrize("x_m", [8.0, 15.0, 40.0])
def test_a_braking_car_shows_more_red_at_its_rear(light: Light, x_m: float) -> None:
    renderer = Renderer(EMPTY, light, PICTURE, 1)
    off, on = (renderer.frame(ORIGIN, [car(x_m, braking=state)], 0.0) for state in (False, True))
    assert np.array_equal(off.ids, on.ids)
    body = on.ids == 1
    assert red(on.image)[body].sum() > 1.3 * red(off.image)[body].sum()


def test_brake_lights_have_a_halo_at_night_alone() -> None:
    for light, glows in ((NOON, False), (NIGHT, True)):
        renderer = Renderer(EMPTY, light, PICTURE, 1)
        off, on = (renderer.frame(ORIGIN, [car(8.0, braking=state)], 0.0) for state in (False, True))
        around = on.ids == 0
        assert bool(red(on.image)[around].sum() > 1.1 * red(off.image)[around].sum()) is glows


def test_brake_lights_are_not_seen_from_the_front() -> None:
    oncoming = [Viewpoint(x_m=24.0, y_m=0.0, yaw_rad=math.pi)]
    renderer = Renderer(EMPTY, NIGHT, PICTURE, 1)
    off, on = (renderer.frame(oncoming[0], [car(braking=state)], 0.0) for state in (False, True))
    assert np.array_equal(off.image, on.image)


def test_the_camera_shows_which_vehicles_brake() -> None:
    world = world_of(RoadCurve.STRAIGHT)
    eyes = eyes_of(world)
    lead = world.vehicles[0]
    lead.speed_mps, lead.accel_mps2 = 6.0, 0.0
    drives = eyes.frame(0.0).image
    lead.accel_mps2 = -2.0
    brakes = eyes.frame(0.0).image
    lead.speed_mps, lead.accel_mps2 = 0.0, 0.0
    held = eyes.frame(0.0).image
    assert not np.array_equal(drives, brakes)
    assert np.array_equal(brakes, held)


def test_an_oncoming_car_that_yields_brakes_visibly_in_the_emergency_braking_street() -> None:
    actor = Actor("oncoming-1", car(), speed_mps=9.0, cruise_mps=9.0)
    actor.advance(0.0, 0.01)
    assert not actor.current_body().braking
    actor.advance(0.01, 0.01, waits=True)
    assert actor.current_body().braking


@pytest.mark.parametrize("road_id", [0, 1, 2])
def test_traffic_lights_stand_at_the_stop_lines_and_face_the_traffic(road_id: int) -> None:
    road = build_road(RoadCurve.CROSSROAD, road_id, 1)
    lights = street_from_road(road).traffic_lights
    assert [light.group for light in lights] == [SignalGroup.MAIN] * 2 + [SignalGroup.SIDE] * 2
    (line_m,) = ego_route(road, DrivingTask.FOLLOW_ROAD).stop_line_stations_m
    x_m, y_m, yaw_rad = road.forward.pose_at(line_m)
    ahead = lights[0]
    along = (ahead.x_m - x_m) * math.cos(yaw_rad) + (ahead.y_m - y_m) * math.sin(yaw_rad)
    left = (ahead.y_m - y_m) * math.cos(yaw_rad) - (ahead.x_m - x_m) * math.sin(yaw_rad)
    assert along == pytest.approx(0.0, abs=1e-6)
    assert left == pytest.approx(0.5 * road.style.lane_width_m - road.kerb_m - 0.5)
    for light in lights:
        # Seen from the middle, each stands in the direction that it faces, and to its own left.
        turn_rad = light.yaw_rad - math.atan2(
            light.y_m - road.junctions[0].y_m, light.x_m - road.junctions[0].x_m
        )
        assert -math.pi / 4 < math.remainder(turn_rad, math.tau) < 0.0


def test_roads_without_a_lit_junction_have_no_traffic_lights() -> None:
    assert street_from_road(build_road(RoadCurve.LEFT, 0, 0)).traffic_lights == ()


COLOURS = {LightState.RED: (1, 0, 0), LightState.AMBER: (1, 1, 0), LightState.GREEN: (0, 1, 0)}


@pytest.mark.parametrize("light", [NOON, NIGHT], ids=["noon", "night"])
def test_traffic_lights_show_the_state_of_the_signal_plan_in_both_directions(light: Light) -> None:
    road = build_road(RoadCurve.CROSSROAD, 0, 0)
    street = street_from_road(road)
    renderer = Renderer(StreetScene(traffic_lights=street.traffic_lights), light, PICTURE, 1)
    plan = SignalPlan(phase_s=0.0)
    seen = set()
    for time_s in np.arange(0.5, CYCLE_S, 1.0).tolist():
        shown = {SignalGroup.MAIN: plan.main_at(time_s), SignalGroup.SIDE: plan.side_at(time_s)}
        for post in street.traffic_lights:
            state = shown[post.group]
            place, _ = lit_lamp(post, state)
            yaw_rad = post.yaw_rad + math.pi
            viewpoint = Viewpoint(
                x_m=post.x_m - 15.0 * math.cos(yaw_rad),
                y_m=post.y_m - 15.0 * math.sin(yaw_rad),
                yaw_rad=yaw_rad,
            )
            frame = renderer.frame(viewpoint, [], 0.0, shown)
            (column, row) = np.rint(_pixel(viewpoint, place)).astype(int).tolist()
            assert tuple((frame.image[row, column] > 128).astype(int).tolist())[:2] == COLOURS[state][:2]
            assert not frame.ids.any()
            seen.add((post.group, state))
    assert len(seen) == 6


def _pixel(viewpoint: Viewpoint, place: tuple[float, float, float]) -> FloatArray:
    view = make_view(PICTURE, viewpoint)
    pixel: FloatArray = view.project(view.to_camera(np.array([place])))[0]
    return pixel


def test_traffic_lights_are_dark_from_behind_and_without_a_state() -> None:
    post = TrafficLight(group=SignalGroup.MAIN, x_m=12.0, y_m=0.0, yaw_rad=math.pi)
    renderer = Renderer(StreetScene(traffic_lights=(post,)), NIGHT, PICTURE, 1)
    lit = {SignalGroup.MAIN: LightState.RED}
    behind = Viewpoint(x_m=24.0, y_m=0.0, yaw_rad=math.pi)
    assert red(renderer.frame(ORIGIN, [], 0.0, lit).image).max() > 150.0
    assert red(renderer.frame(ORIGIN, [], 0.0).image).max() < 60.0
    assert red(renderer.frame(behind, [], 0.0, lit).image).max() < 60.0


def test_the_glow_of_a_lamp_does_not_shine_through_a_house() -> None:
    house = Building(x_m=14.0, y_m=0.0, yaw_rad=0.0, length_m=4.0, width_m=30.0, height_m=12.0, look=1)
    lamp = Lamp(x_m=30.0, y_m=0.0, yaw_rad=0.0)
    post = TrafficLight(group=SignalGroup.MAIN, x_m=25.0, y_m=2.0, yaw_rad=math.pi)
    scenes = (
        StreetScene(buildings=(house,)),
        StreetScene(buildings=(house,), traffic_lights=(post,)),
        StreetScene(buildings=(house,), lamps=(lamp,)),
    )
    signals = {SignalGroup.MAIN: LightState.RED}
    above = slice(0, 180)
    bare, *others = (
        Renderer(scene, NIGHT, PICTURE, 1).frame(ORIGIN, [], 0.0, signals).image[above] for scene in scenes
    )
    for other in others:
        assert np.abs(other.astype(int) - bare).max() < 25


def test_no_road_user_has_the_id_of_a_parked_vehicle() -> None:
    world = world_of(RoadCurve.STRAIGHT)
    frame = eyes_of(world).frame(0.0)
    found = {body.id for body in visible_bodies(frame)}
    road_users = len(world.vehicles) + len(world.walkers)
    assert any(number >= FIRST_PARKED_ID for number in found)
    assert {number for number in found if number < FIRST_PARKED_ID} <= set(range(1, road_users + 1))
    assert 1 in found


@pytest.mark.parametrize("pitch_deg", [0.0, 2.0, -2.0])
@pytest.mark.parametrize(("x_m", "y_m"), [(14.0, -2.0), (22.0, 3.0), (35.0, 0.0)])
@pytest.mark.parametrize("height_m", [1.5, 2.3], ids=["car", "van"])
def test_the_picture_agrees_with_the_boxes_of_the_pitched_camera(
    pitch_deg: float, x_m: float, y_m: float, height_m: float
) -> None:
    camera = Camera(width_px=PICTURE.width_px, height_px=PICTURE.height_px)
    pitch_rad = math.radians(pitch_deg)
    body = car(x_m, y_m, height_m=height_m)
    solid = Solid(ObstacleLabel.VEHICLE, x_m, y_m, 0.0, body.length_m, body.width_m, height_m)

    def sides(pitch_rad: float) -> tuple[FloatArray, FloatArray]:
        viewpoint = Viewpoint(x_m=0.0, y_m=0.0, yaw_rad=0.0, pitch_rad=pitch_rad)
        frame = Renderer(EMPTY, NOON, PICTURE, 1).frame(viewpoint, [body], 0.0)
        rows, columns = np.nonzero(frame.ids == 1)
        pixels = np.array([columns.min(), columns.max() + 1, rows.min(), rows.max() + 1], np.float64)
        (sight,) = camera.look(0.0, 0.0, 0.0, [solid])
        (box,) = camera.all_tilted([sight.box], pitch_rad)
        return pixels, np.array(box[1:], np.float64)

    pixels, box = sides(pitch_rad)
    level_pixels, level_box = sides(0.0)
    # A vehicle's ends are rounded, and its lower edge is above the ground: its box is a little larger.
    assert np.abs(pixels[:2] - box[:2]).max() < 2.5
    assert -2.5 < pixels[2] - box[2] < 4.0
    assert -1.0 < box[3] - pixels[3] < 6.0
    assert (pixels - level_pixels) == pytest.approx(box - level_box, abs=1.0)
    shift_px = PICTURE.focal_px * math.tan(pitch_rad)
    assert (pixels - level_pixels)[2:] == pytest.approx([shift_px, shift_px], abs=1.0)


def test_images_do_not_depend_on_the_pitches_before_and_few_tables_are_kept() -> None:
    steps = [5e-4 * number for number in range(-2 * PITCHES_KEPT, 2 * PITCHES_KEPT)]
    used = Renderer(street_from_road(build_road(RoadCurve.RIGHT, 0, 0)), NIGHT, PICTURE, 1)
    fresh = Renderer(street_from_road(build_road(RoadCurve.RIGHT, 0, 0)), NIGHT, PICTURE, 1)
    nod = Viewpoint(x_m=3.0, y_m=-1.7, yaw_rad=0.0, pitch_rad=steps[5])
    for pitch_rad in steps:
        viewpoint = Viewpoint(x_m=3.0, y_m=-1.7, yaw_rad=0.0, pitch_rad=pitch_rad)
        view = make_view(PICTURE, viewpoint)
        used._ground._rows_of(view)
        used._sky.paint(np.empty((360, 640, 3), np.uint8), view)
    assert len(used._ground._rows) == len(used._sky._rays) == PITCHES_KEPT
    assert np.array_equal(used.frame(nod, [], 1.0).image, fresh.frame(nod, [], 1.0).image)


def test_the_camera_follows_the_pitch_of_the_ego() -> None:
    world = world_of(RoadCurve.STRAIGHT)
    eyes = eyes_of(world)
    assert isinstance(world.ego, EgoCar)
    level = eyes.frame(0.0)
    world.ego.pitch_rad = -math.radians(1.5)
    dives = eyes.frame(0.0)
    tops = [int(np.nonzero(frame.ids == 1)[0].min()) for frame in (level, dives)]
    assert tops[0] - tops[1] == pytest.approx(320 * math.tan(math.radians(1.5)), abs=1.0)
