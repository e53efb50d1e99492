"""Replays an exported drive in CARLA: builds the road from road.xodr and moves all road users as in scenario.xosc.

This script was written against the documentation of CARLA's Python client (0.9.15). It has never been run in CARLA.

    python replay_in_carla.py --host 127.0.0.1 --port 2000

It needs nothing but the Python package `carla` and the two files beside it. CARLA's axes are left-handed: y, heading
and pitch change their signs. CARLA places vehicles by the middle of the body, and people by the middle of their
height; the scenario places vehicles by their rear axle.
"""

import argparse
import math
import sys
import xml.etree.ElementTree as ET
from bisect import bisect_right
from dataclasses import dataclass
from pathlib import Path
from typing import Any

STEP_S = 0.05
CLEARANCE_M = 0.05
"""Everything is placed this far above the road, so that it does not touch it when it appears."""
BLUEPRINTS = {
    "car": ("vehicle.tesla.model3", "vehicle.*"),
    "van": ("vehicle.mercedes.sprinter", "vehicle.*"),
    "pedestrian": ("walker.pedestrian.0001", "walker.pedestrian.*"),
    "obstacle": ("static.prop.constructioncone", "static.prop.*"),
}
"""Preferred blueprint of each kind of body, and the pattern of what replaces it."""
LAMPS = {"on;off;off": "Red", "off;on;off": "Yellow", "off;off;on": "Green"}


@dataclass(frozen=True)
class Pose:
    """A reference point in the scenario's right-handed axes; pitch turns the nose down."""

    x_m: float
    y_m: float
    z_m: float
    heading_rad: float
    pitch_rad: float


@dataclass(frozen=True)
class Entity:
    """A road user or a parked vehicle.

    Attributes:
        name: Its name.
        kind: ``car``, ``van``, ``pedestrian`` or ``obstacle``.
        centre_m: Distance from its reference point forward to its middle.
        height_m: Its height.
        runs: Times and poses of each time during which it is present; a single pose never moves.
    """

    name: str
    kind: str
    centre_m: float
    height_m: float
    runs: list[tuple[list[float], list[Pose]]]

    def pose_at(self, time_s: float) -> Pose | None:
        """Return its pose at a time; None while it is absent."""
        for times_s, poses in self.runs:
            if len(times_s) == 1:
                return poses[0]
            if times_s[0] - 1e-6 <= time_s <= times_s[-1] + 1e-6:
                after = min(max(bisect_right(times_s, time_s), 1), len(times_s) - 1)
                span_s = times_s[after] - times_s[after - 1]
                share = min(max((time_s - times_s[after - 1]) / span_s, 0.0), 1.0)
                return between(poses[after - 1], poses[after], share)
        return None


def between(one: Pose, other: Pose, share: float) -> Pose:
    """Return the pose interpolated between two poses."""
    turn_rad = math.remainder(other.heading_rad - one.heading_rad, 2.0 * math.pi)
    return Pose(
        one.x_m + share * (other.x_m - one.x_m),
        one.y_m + share * (other.y_m - one.y_m),
        one.z_m + share * (other.z_m - one.z_m),
        one.heading_rad + share * turn_rad,
        one.pitch_rad + share * (other.pitch_rad - one.pitch_rad),
    )


def read_pose(position: ET.Element) -> Pose:
    """Return the pose in a WorldPosition."""
    x, y, z, h, p = (float(position.get(name, "0")) for name in "xyzhp")
    return Pose(x, y, z, h, p)


def read_entities(root: ET.Element) -> list[Entity]:
    """Return all entities of a scenario that are placed or follow a trajectory."""
    entities = []
    for element in root.iter("ScenarioObject"):
        name, body = element.get("name", ""), element[0]
        centre, size = body.find("BoundingBox/Center"), body.find("BoundingBox/Dimensions")
        assert centre is not None
        assert size is not None
        runs = [read_trajectory(one) for one in trajectories_of(root, name)]
        start = root.find(f".//Private[@entityRef='{name}']//TeleportAction/Position/WorldPosition")
        if not runs and start is not None:
            runs = [([0.0], [read_pose(start)])]
        kind = {"Vehicle": body.get("vehicleCategory", "car"), "Pedestrian": "pedestrian"}.get(
            body.tag, "obstacle"
        )
        entities.append(Entity(name, kind, float(centre.get("x", "0")), float(size.get("height", "0")), runs))
    return entities


def trajectories_of(root: ET.Element, name: str) -> list[ET.Element]:
    """Return the trajectories that an entity follows, in order."""
    groups = [
        group
        for group in root.iter("ManeuverGroup")
        if any(actor.get("entityRef") == name for actor in group.findall("Actors/EntityRef"))
    ]
    return [trajectory for group in groups for trajectory in group.iter("Trajectory")]


def read_trajectory(trajectory: ET.Element) -> tuple[list[float], list[Pose]]:
    """Return times and poses of a trajectory."""
    times_s, poses = [], []
    for vertex in trajectory.iter("Vertex"):
        position = vertex.find("Position/WorldPosition")
        assert position is not None
        times_s.append(float(vertex.get("time", "0")))
        poses.append(read_pose(position))
    return times_s, poses


def read_lights(root: ET.Element) -> list[list[tuple[float, dict[str, str]]]]:
    """Return the phases of each traffic-light controller: duration, and states by signal."""
    return [
        [
            (
                float(phase.get("duration", "0")),
                {
                    state.get("trafficSignalId", ""): state.get("state", "")
                    for state in phase.findall("TrafficSignalState")
                },
            )
            for phase in controller.findall("Phase")
        ]
        for controller in root.iter("TrafficSignalController")
    ]


def lights_at(controllers: list[list[tuple[float, dict[str, str]]]], time_s: float) -> dict[str, str]:
    """Return the state of each signal at a time; the phases of a controller repeat."""
    states: dict[str, str] = {}
    for phases in controllers:
        cycle_s = sum(lasts_s for lasts_s, _ in phases)
        left_s = time_s % cycle_s
        for lasts_s, shown in phases:
            if left_s < lasts_s:
                states.update(shown)
                break
            left_s -= lasts_s
    return states


def carla_transform(carla: Any, entity: Entity, pose: Pose) -> Any:
    """Return where CARLA places an entity."""
    x_m = pose.x_m + entity.centre_m * math.cos(pose.heading_rad)
    y_m = pose.y_m + entity.centre_m * math.sin(pose.heading_rad)
    rise_m = -entity.centre_m * math.tan(pose.pitch_rad)
    if entity.kind == "pedestrian":
        rise_m += 0.5 * entity.height_m
    return carla.Transform(
        carla.Location(x=x_m, y=-y_m, z=pose.z_m + rise_m + CLEARANCE_M),
        carla.Rotation(pitch=-math.degrees(pose.pitch_rad), yaw=-math.degrees(pose.heading_rad), roll=0.0),
    )


def spawn(carla: Any, world: Any, entity: Entity, pose: Pose) -> Any:
    """Return a new actor without physics; None if there is no room for it."""
    library = world.get_blueprint_library()
    preferred, pattern = BLUEPRINTS.get(entity.kind, BLUEPRINTS["car"])
    found = list(library.filter(preferred)) or list(library.filter(pattern))
    actor = world.try_spawn_actor(found[0], carla_transform(carla, entity, pose))
    if actor is None:
        sys.stdout.write(f"no room for {entity.name}: it is left out\n")
    else:
        actor.set_simulate_physics(False)
    return actor


class Replay:
    """Moves the actors of a world.

    Args:
        carla: The module `carla`.
        world: The world.
        root: The scenario.
        skipped: Names of entities that something else moves.
    """

    def __init__(self, carla: Any, world: Any, root: ET.Element, skipped: set[str]) -> None:
        self.carla = carla
        self.world = world
        self.entities = [one for one in read_entities(root) if one.runs and one.name not in skipped]
        self.lights = read_lights(root)
        self.actors: dict[str, Any] = {}
        ends_s = [run[0][-1] for entity in self.entities for run in entity.runs]
        self.end_s = max(ends_s, default=0.0)

    def show(self, time_s: float) -> None:
        """Place all actors and set all lights as they are at a time."""
        for entity in self.entities:
            pose = entity.pose_at(time_s)
            actor = self.actors.get(entity.name)
            if pose is None:
                if actor is not None:
                    self.actors.pop(entity.name).destroy()
            elif entity.name not in self.actors:
                self.actors[entity.name] = spawn(self.carla, self.world, entity, pose)
            elif actor is not None:
                actor.set_transform(carla_transform(self.carla, entity, pose))
        for signal, lamps in lights_at(self.lights, time_s).items():
            # CARLA may know no ids of lights in worlds that it made from an OpenDRIVE file.
            light = self.world.get_traffic_light_from_opendrive_id(signal)
            if light is not None:
                light.set_state(getattr(self.carla.TrafficLightState, LAMPS[lamps]))
                light.freeze(True)

    def clear(self) -> None:
        """Remove all actors."""
        for actor in self.actors.values():
            if actor is not None:
                actor.destroy()
        self.actors.clear()


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--host", default="127.0.0.1")
    parser.add_argument("--port", type=int, default=2000)
    parser.add_argument("--skip", action="append", default=[], help="entity that something else moves")
    given = parser.parse_args()
    import carla

    folder = Path(__file__).resolve().parent
    client = carla.Client(given.host, given.port)
    client.set_timeout(60.0)
    world = client.generate_opendrive_world(
        (folder / "road.xodr").read_text(encoding="utf-8"),
        carla.OpendriveGenerationParameters(
            vertex_distance=1.0,
            max_road_length=500.0,
            wall_height=0.0,
            additional_width=0.0,
            smooth_junctions=True,
            enable_mesh_visibility=True,
        ),
    )
    settings = world.get_settings()
    synchronous = world.get_settings()
    synchronous.synchronous_mode = True
    synchronous.fixed_delta_seconds = STEP_S
    world.apply_settings(synchronous)
    replay = Replay(carla, world, ET.parse(folder / "scenario.xosc").getroot(), set(given.skip))
    try:
        for step in range(math.ceil(replay.end_s / STEP_S) + 1):
            replay.show(step * STEP_S)
            world.tick()
    finally:
        replay.clear()
        world.apply_settings(settings)


if __name__ == "__main__":
    main()
