"""Writes a recorded drive as ASAM OpenSCENARIO XML 1.2, with the library scenariogeneration.

Every road user follows the polyline of its recorded positions at their recorded times. Positions are those of the
standard's reference point on the ground: the middle of a vehicle's rear axle, the middle of all other bodies.
"""

import math
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scenariogeneration import xosc

from brink.scenarios.environment import FRICTION_PARAMETER, environment, friction_scale
from brink.scenarios.exportable import EgoControl
from brink.scenarios.network import RoadNetwork
from brink.scenarios.urban_network import MAIN_LIGHTS
from brink.scenarios.worlds import BodyKind, Dimensions, ExportWorld, spec_of
from brink.sim.driving.interface import LightState
from brink.sim.trace import FloatArray, Trace
from brink.sim.world.ego import EGO_CAR
from brink.sim.world.road import ALL_RED_S, AMBER_S, CYCLE_S, MAIN_GREEN_S, SIDE_GREEN_S, SignalPlan

VERSION: Final = "1.2"
EGO: Final = "ego"
SPEED_PARAMETER: Final = "ego_start_speed_mps"
"""Parameter of the scenario: speed of the ego at the start."""
PLACES: Final = 6
"""Decimal places of positions, angles and times."""
TOP_SPEED_MPS: Final = 50.0
PEDESTRIAN_KG: Final = 75.0
OBSTACLE_KG: Final = 500.0
WHEEL_DIAMETER_M: Final = 0.65
TRACK_SHARE: Final = 0.86
"""Distance between the wheels of an axle, as a share of the body's width."""
LAMPS: Final = {LightState.RED: "on;off;off", LightState.AMBER: "off;on;off", LightState.GREEN: "off;off;on"}
"""State of a traffic light: its red, amber and green lamp."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Track:
    """A road user with its recorded motion.

    Attributes:
        name: Name of the entity.
        body: Its body.
        time_s: Times of the samples, strictly ascending, shape ``(n,)``.
        motion: x_m, y_m, yaw_rad and speed_mps of its centre, shape ``(n, 4)``; NaN while it is absent.
    """

    name: str
    body: Dimensions
    time_s: NDArray[np.float64]
    motion: NDArray[np.float64]

    def runs(self) -> Iterator[tuple[int, int]]:
        """Yield the first sample and the one after the last of each interval during which it is present."""
        present = np.isfinite(self.motion).all(axis=1)
        changes = np.flatnonzero(np.diff(np.concatenate([[False], present, [False]]))).tolist()
        yield from zip(changes[::2], changes[1::2], strict=True)


def tracks_of(trace: Trace, world: ExportWorld) -> list[Track]:
    """Return the ego and all other road users of a drive, the ego first.

    The last of several samples with the same time counts.
    """
    time_s = trace.time_s.astype(np.float64).round(PLACES)
    kept = np.flatnonzero(np.append(np.diff(time_s) > 0.0, True))
    length_m, width_m = trace.ego_size_m
    ego = Dimensions(kind=BodyKind.CAR, length_m=length_m, width_m=width_m, height_m=EGO_CAR.height_m)

    def track(name: str, body: Dimensions, motion: FloatArray) -> Track:
        return Track(name=name, body=body, time_s=time_s[kept], motion=motion[kept, :4].astype(np.float64))

    others = [track(actor.name, world.bodies[actor.name], actor.motion) for actor in trace.actors]
    return [track(EGO, ego, trace.ego), *others]


def openscenario(
    trace: Trace, world: ExportWorld, *, ego: EgoControl, road_file: str, title: str, created_at: datetime
) -> ET.Element:
    """Return the root element of an OpenSCENARIO file.

    Args:
        trace: The drive.
        world: Its world.
        ego: What moves the ego.
        road_file: Name of the OpenDRIVE file beside it.
        title: Description in a line.
        created_at: When the file was made.
    """
    return _ScenarioBuilder(trace, world, ego).element(road_file, title, created_at)


class _ScenarioBuilder:
    def __init__(self, trace: Trace, world: ExportWorld, ego: EgoControl) -> None:
        self._trace = trace
        self._world = world
        self._control = ego
        self._tracks = tracks_of(trace, world)

    def element(self, road_file: str, title: str, created_at: datetime) -> ET.Element:
        """Return the root element."""
        network = xosc.RoadNetwork(road_file)
        if self._world.signals is not None:
            for controller in signal_controllers(self._world.signals, self._world.network):
                network.add_traffic_signal_controller(controller)
        spec = spec_of(self._trace)
        weather = environment(self._world.time_of_day, self._world.weather, spec.seed)
        end = xosc.ValueTrigger(
            "end of the recording",
            0.0,
            xosc.ConditionEdge.none,
            xosc.SimulationTimeCondition(float(self._tracks[0].time_s[-1]), xosc.Rule.greaterOrEqual),
            triggeringpoint="stop",
        )
        storyboard = xosc.StoryBoard(self._init(weather), end)
        if story := self._story():
            storyboard.add_story(story)
        scenario = xosc.Scenario(
            title,
            "Brink",
            self._parameters(),
            self._entities(),
            storyboard,
            network,
            xosc.Catalog(),
            osc_minor_version=2,
            creation_date=created_at,
        )
        root: ET.Element = scenario.get_element()
        return root

    def _parameters(self) -> xosc.ParameterDeclarations:
        parameters = xosc.ParameterDeclarations()
        scale = friction_scale(self._world.time_of_day, self._world.weather)
        for name, value in (
            (FRICTION_PARAMETER, scale),
            (SPEED_PARAMETER, round(float(self._trace.ego[0, 3]), PLACES)),
        ):
            parameters.add_parameter(xosc.Parameter(name, xosc.ParameterType.double, str(value)))
        return parameters

    def _entities(self) -> xosc.Entities:
        entities = xosc.Entities()
        for track in self._tracks:
            entities.add_scenario_object(track.name, entity_of(track.name, track.body))
        for name, (body, _) in self._world.parked.items():
            entities.add_scenario_object(name, entity_of(name, body))
        return entities

    def _init(self, weather: xosc.Environment) -> xosc.Init:
        init = xosc.Init()
        init.add_global_action(xosc.EnvironmentAction(weather))
        for track in self._tracks:
            if np.isfinite(track.motion[0]).all():
                init.add_init_action(track.name, xosc.TeleportAction(self._position(track, 0)))
                ego = track.name == EGO
                speed = f"${SPEED_PARAMETER}" if ego else round(float(track.motion[0, 3]), PLACES)
                at_once = xosc.TransitionDynamics(xosc.DynamicsShapes.step, xosc.DynamicsDimension.time, 0.0)
                if track.body.kind is not BodyKind.OBSTACLE:
                    init.add_init_action(track.name, xosc.AbsoluteSpeedAction(speed, at_once))
        if self._control is EgoControl.CONTROLLED:
            init.add_init_action(EGO, xosc.AssignControllerAction(_external_controller()))
            init.add_init_action(EGO, xosc.AssignRouteAction(self._route()))
        for name, (body, pose) in self._world.parked.items():
            init.add_init_action(name, xosc.TeleportAction(self._place(body, *pose)))
        return init

    def _route(self) -> xosc.Route:
        route = xosc.Route("route of the ego")
        for pose in self._world.route:
            x_m, y_m, yaw_rad = pose
            height_m, _ = self._world.ground.at(x_m, y_m, yaw_rad, on_foot=False)
            place = xosc.WorldPosition(
                *(round(value, PLACES) for value in (x_m, y_m, height_m)), h=round(yaw_rad, PLACES)
            )
            route.add_waypoint(place, xosc.RouteStrategy.shortest)
        return route

    def _story(self) -> xosc.Story | None:
        act = xosc.Act("drive", _at_time("start", 0.0), xosc.Trigger("stop"))
        for track in self._tracks:
            if track.name == EGO and self._control is EgoControl.CONTROLLED:
                continue
            maneuver = xosc.Maneuver(f"motion of {track.name}")
            for event in self._events(track):
                maneuver.add_event(event)
            if maneuver.events:
                group = xosc.ManeuverGroup(track.name)
                group.add_actor(track.name)
                group.add_maneuver(maneuver)
                act.add_maneuver_group(group)
        if not act.maneuvergroup:
            return None
        story = xosc.Story("recorded drive", xosc.ParameterDeclarations())
        story.add_act(act)
        return story

    def _events(self, track: Track) -> Iterator[xosc.Event]:
        """Yield the events of a road user: it enters, moves and leaves, as often as it was recorded."""
        moves_ever = track.body.kind is not BodyKind.OBSTACLE
        for number, (first, end) in enumerate(track.runs(), start=1):
            begins_s = float(track.time_s[first])
            trigger = _at_time(f"{track.name} moves {number}", begins_s)
            if first > 0:
                enters = f"{track.name} enters {number}"
                yield _event(
                    enters,
                    xosc.AddEntityAction(track.name, self._position(track, first)),
                    _at_time(enters, begins_s),
                )
                trigger = _after(enters)
            if moves_ever and end - first > 1:
                yield _event(f"{track.name} moves {number}", self._follow(track, first, end, number), trigger)
            if end < len(track.time_s):
                leaves = f"{track.name} leaves {number}"
                yield _event(
                    leaves, xosc.DeleteEntityAction(track.name), _at_time(leaves, float(track.time_s[end]))
                )

    def _follow(self, track: Track, first: int, end: int, number: int) -> xosc.FollowTrajectoryAction:
        trajectory = xosc.Trajectory(f"trajectory {number} of {track.name}", False)
        yaws = np.unwrap(track.motion[first:end, 2]).tolist()
        places = [self._position(track, first + index, yaw_rad) for index, yaw_rad in enumerate(yaws)]
        trajectory.add_shape(xosc.Polyline(track.time_s[first:end].tolist(), places))
        return xosc.FollowTrajectoryAction(
            trajectory, xosc.FollowingMode.position, xosc.ReferenceContext.absolute, 1.0, 0.0
        )

    def _position(self, track: Track, sample: int, yaw_rad: float | None = None) -> xosc.WorldPosition:
        x_m, y_m, recorded_rad, _ = track.motion[sample].tolist()
        return self._place(track.body, x_m, y_m, recorded_rad if yaw_rad is None else yaw_rad)

    def _place(self, body: Dimensions, x_m: float, y_m: float, yaw_rad: float) -> xosc.WorldPosition:
        """Return the reference point of a body, given its centre."""
        x_m -= body.reference_m * math.cos(yaw_rad)
        y_m -= body.reference_m * math.sin(yaw_rad)
        on_foot = body.kind is BodyKind.PEDESTRIAN
        height_m, slope = self._world.ground.at(x_m, y_m, yaw_rad, on_foot=on_foot)
        # Pitch turns the nose down, to the standard's axes; people stand upright.
        pitch_rad = 0.0 if on_foot else -math.atan(slope)
        x, y, z, h, p = (round(value, PLACES) + 0.0 for value in (x_m, y_m, height_m, yaw_rad, pitch_rad))
        return xosc.WorldPosition(x, y, z, h, p, 0.0)


def entity_of(name: str, body: Dimensions) -> Any:
    """Return the entity of a body: a vehicle, a pedestrian or another object."""
    box = xosc.BoundingBox(
        *(round(value, PLACES) for value in (body.width_m, body.length_m, body.height_m)),
        body.reference_m,
        0.0,
        0.5 * body.height_m,
    )
    if body.kind is BodyKind.PEDESTRIAN:
        return xosc.Pedestrian(name, PEDESTRIAN_KG, xosc.PedestrianCategory.pedestrian, box)
    if body.kind is BodyKind.OBSTACLE:
        return xosc.MiscObject(name, OBSTACLE_KG, xosc.MiscObjectCategory.obstacle, box)
    track_m, wheel_m = TRACK_SHARE * body.width_m, WHEEL_DIAMETER_M
    vehicle = xosc.Vehicle(
        name,
        xosc.VehicleCategory.van if body.kind is BodyKind.VAN else xosc.VehicleCategory.car,
        box,
        xosc.Axle(EGO_CAR.steer_limit_rad, wheel_m, track_m, body.wheelbase_m, 0.5 * wheel_m),
        xosc.Axle(0.0, wheel_m, track_m, 0.0, 0.5 * wheel_m),
        TOP_SPEED_MPS,
        EGO_CAR.engine_mps2,
        EGO_CAR.brake_mps2,
        mass=EGO_CAR.mass_kg if name == EGO else None,
    )
    # CARLA's ScenarioRunner finds the ego by this property.
    vehicle.add_property("type", "ego_vehicle" if name == EGO else "simulation")
    return vehicle


def _external_controller() -> xosc.Controller:
    # The property is how CARLA's ScenarioRunner knows that something else drives.
    return xosc.Controller("system under test", xosc.Properties().add_property("module", "external_control"))


def signal_controllers(plan: SignalPlan, network: RoadNetwork) -> list[xosc.TrafficSignalController]:
    """Return a controller for each group of traffic lights. It repeats the plan's cycle, which begins at time 0.

    Args:
        plan: The plan of the lights.
        network: The network with the lights.
    """
    controllers = []
    for group in network.signal_groups:
        # Named by its id: that is how the standard refers to a controller of the road network.
        controller = xosc.TrafficSignalController(str(group.id))
        for number, (state, lasts_s) in enumerate(light_phases(plan, main=group.id == MAIN_LIGHTS), start=1):
            phase = xosc.Phase(f"{number} {state.value}", round(lasts_s, PLACES))
            for light in group.lights:
                phase.add_signal_state(str(light), LAMPS[state])
            controller.add_phase(phase)
        controllers.append(controller)
    return controllers


def light_phases(plan: SignalPlan, *, main: bool) -> list[tuple[LightState, float]]:
    """Return states and durations of a light from time 0, over one cycle.

    Args:
        plan: The plan of the lights.
        main: Whether the light is for the main road; otherwise for its side streets.
    """
    side_begins_s = MAIN_GREEN_S + AMBER_S + ALL_RED_S
    green_s = MAIN_GREEN_S if main else SIDE_GREEN_S
    begins_s = -plan.phase_s if main else side_begins_s - plan.phase_s
    changes = [(begins_s, LightState.GREEN), (begins_s + green_s, LightState.AMBER)]
    changes.append((begins_s + green_s + AMBER_S, LightState.RED))
    starts = sorted((at_s % CYCLE_S, state.value) for at_s, state in changes)
    now = plan.main_at(0.0) if main else plan.side_at(0.0)
    edges = [(0.0, now), *((at_s, LightState(word)) for at_s, word in starts if at_s > 0.0)]
    ends_s = [*(at_s for at_s, _ in edges[1:]), CYCLE_S]
    return [(state, end_s - at_s) for (at_s, state), end_s in zip(edges, ends_s, strict=True)]


def _event(name: str, action: Any, trigger: Any) -> xosc.Event:
    event = xosc.Event(name, xosc.Priority.parallel)
    event.add_action(name, action)
    event.add_trigger(trigger)
    return event


def _at_time(name: str, time_s: float) -> xosc.ValueTrigger:
    return xosc.ValueTrigger(
        f"{name}: time",
        0.0,
        xosc.ConditionEdge.none,
        xosc.SimulationTimeCondition(round(time_s, PLACES), xosc.Rule.greaterOrEqual),
    )


def _after(event: str) -> xosc.ValueTrigger:
    return xosc.ValueTrigger(
        f"after {event}",
        0.0,
        xosc.ConditionEdge.none,
        xosc.StoryboardElementStateCondition(
            xosc.StoryboardElementType.event, event, xosc.StoryboardElementState.completeState
        ),
    )
