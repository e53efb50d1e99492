"""The street of an emergency-braking episode, and the road users on it.

The street runs along x. The ego's lane lies around y = -1.75 m and the oncoming lane around y = +1.75 m; each side
has a strip with parked vehicles, a pavement and buildings. Everything that the scenario leaves open (appearances,
gaps, people on the pavement) comes from the episode's seed.
"""

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from brink.sim.aeb.braking import CRUISE_MPS
from brink.sim.aeb.specification import AebScenario, Obstacle, Occluder
from brink.sim.driving.interface import CONTROL_STEP_S
from brink.sim.rendering.furniture import FURNITURE_SIZE_M
from brink.sim.rendering.scene import (
    Body,
    BodyKind,
    Building,
    Furniture,
    FurnitureKind,
    Ground,
    Lamp,
    Material,
    StreetScene,
    Tree,
)
from brink.sim.trace import Surface
from brink.sim.world.ego import EGO_CAR, CarModel, EgoCar, EgoMotion
from brink.sim.world.line import Piece, ReferenceLine
from brink.sim.world.pedestrians import WALK_ACCEL_MPS2
from brink.sim.world.road import Fixture, LaneRoute, Road, RoadStyle, Scenery, SignalPlan
from brink.sim.world.scenario import RoadCurve
from brink.sim.world.streams import Stream, generator
from brink.sim.world.vehicle import CAR, VAN, VehicleSize, brake_lights_on
from brink.sim.world.weather import Conditions, conditions

LANE_M: Final = 3.5
LANE_Y_M: Final = -0.5 * LANE_M
WALKING_MPS: Final = 2.0
STRIP_M: Final = 2.2
KERB_M: Final = LANE_M + STRIP_M
PAVEMENT_M: Final = 3.0
BEGIN_M: Final = -40.0
END_M: Final = 160.0
EGO_FRONT_M: Final = 2.25
"""From the ego's centre to its front bumper."""
PERSON_SIZE_M: Final = (0.45, 0.55, 1.75)
TREE_SIZE_M: Final = (2.6, 1.0, 0.9)
OVERTURNED_SIZE_M: Final = (4.4, 1.8, 1.35)
TRUNK_M: Final = 0.4
GAP_M: Final = 1.6
"""Gap between the two parked vehicles that the pedestrian steps out of."""
BRAKES_MPS2: Final = 5.0
STARTS_MPS2: Final = 1.5
PAST_LINE_M: Final = 15.0
"""The ego's goal is this far beyond the pedestrian's line."""
YIELDS_WITHIN_M: Final = 16.0
"""Oncoming vehicles closer than this to a crossing pedestrian brake."""


class Actor:
    """A body that moves along its heading. Stateful; created for each episode.

    Args:
        name: Unique in the episode.
        body: Its appearance, size and initial pose.
        speed_mps: Speed at the start, along its heading.
        cruise_mps: Target speed.
        starts_s: When it begins to move.
        stops_after_m: Distance after which it stops.
    """

    def __init__(
        self,
        name: str,
        body: Body,
        *,
        speed_mps: float = 0.0,
        cruise_mps: float = 0.0,
        starts_s: float = 0.0,
        stops_after_m: float = math.inf,
    ) -> None:
        self.name = name
        self.body = body
        self.x_m, self.y_m, self.yaw_rad = body.x_m, body.y_m, body.yaw_rad
        self.length_m, self.width_m = body.length_m, body.width_m
        self.size = VehicleSize(body.length_m, body.width_m, body.height_m)
        self.is_person = body.kind is BodyKind.PERSON
        self.is_vehicle = body.kind is BodyKind.VEHICLE
        self.speed_mps = speed_mps
        self.accel_mps2 = 0.0
        self._cruise_mps = cruise_mps
        self._starts_s = starts_s
        self._stops_after_m = stops_after_m
        self._travelled_m = 0.0
        self._braking_mps2, self._starting_mps2 = (
            (WALK_ACCEL_MPS2, WALK_ACCEL_MPS2) if self.is_person else (BRAKES_MPS2, STARTS_MPS2)
        )

    @property
    def is_on_the_way(self) -> bool:
        """Whether it has begun to move and not yet arrived."""
        return 0.0 < self._travelled_m < self._stops_after_m

    def advance(self, time_s: float, dt_s: float, *, waits: bool = False) -> None:
        """Advance by one step.

        Args:
            time_s: Start of the step.
            dt_s: Length of the step.
            waits: Whether it yields.
        """
        moves = time_s >= self._starts_s - 1e-9 and self._travelled_m < self._stops_after_m and not waits
        slowest_mps = self.speed_mps - self._braking_mps2 * dt_s
        fastest_mps = self.speed_mps + self._starting_mps2 * dt_s
        speed_mps = min(max(self._cruise_mps if moves else 0.0, slowest_mps), fastest_mps)
        self.accel_mps2 = (speed_mps - self.speed_mps) / dt_s
        self.speed_mps = speed_mps
        step_m = self.speed_mps * dt_s
        self._travelled_m += step_m
        self.x_m += step_m * math.cos(self.yaw_rad)
        self.y_m += step_m * math.sin(self.yaw_rad)

    def current_body(self) -> Body:
        """Return the actor's body at its current position."""
        phase = self._travelled_m * 2.0 * math.pi / 1.4 if self.is_person else 0.0
        braking = self.is_vehicle and brake_lights_on(self.speed_mps, self.accel_mps2)
        return replace(self.body, x_m=self.x_m, y_m=self.y_m, phase=phase, braking=braking)


@dataclass(frozen=True, slots=True, kw_only=True)
class Street:
    """The street of one episode.

    Attributes:
        scene: Everything that does not move.
        actors: All road users except the ego, the pedestrian first; stateful.
    """

    scene: StreetScene
    actors: tuple[Actor, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class StreetWorld:
    """The world of an emergency-braking episode; its members are stateful.

    Attributes:
        street: What is seen of it, and the actors.
        road: The road.
        route: The ego's route, which ends beyond the pedestrian's line.
        weather: Effects of time of day and weather.
        ego: The car under test.
        vehicles: All actors except people: vehicles and the obstacle.
        walkers: The pedestrian and the stroller.
        signals: None: there are no traffic lights.
        leaves_road_m: Infinite: the ego's route stays on the road.
    """

    street: Street
    road: Road
    route: LaneRoute
    weather: Conditions
    ego: EgoMotion
    vehicles: tuple[Actor, ...]
    walkers: tuple[Actor, ...]
    signals: SignalPlan | None = None
    leaves_road_m: float = math.inf

    def advance(self, step: int) -> None:
        """Advance all actors by one step; oncoming vehicles yield to the pedestrian."""
        pedestrian = self.street.actors[0]
        for actor in self.street.actors:
            waits = actor.name.startswith("oncoming") and _gives_way(actor, pedestrian)
            actor.advance(step * CONTROL_STEP_S, CONTROL_STEP_S, waits=waits)

    def grade_at(self, station_m: float) -> float:
        """Return the grade of the ego's route, which is level."""
        return 0.0


def _gives_way(vehicle: Actor, pedestrian: Actor) -> bool:
    ahead_m = vehicle.x_m - 0.5 * vehicle.length_m - pedestrian.x_m
    return pedestrian.is_on_the_way and 0.0 < ahead_m < YIELDS_WITHIN_M and pedestrian.y_m < vehicle.y_m + 2.0


def make_street_world(scenario: AebScenario, seed: int, car: CarModel = EGO_CAR) -> StreetWorld:
    """Return the world of an episode at time 0.

    Args:
        scenario: The scenario.
        seed: The episode's seed.
        car: The ego's car.
    """
    street = make_street(scenario, seed)
    weather = conditions(scenario.time_of_day, scenario.weather)
    road = _road(street.scene)
    goal_m = EGO_FRONT_M + scenario.crossing_m + PAST_LINE_M
    return StreetWorld(
        street=street,
        road=road,
        route=LaneRoute(
            line=road.forward.up_to(goal_m),
            lane_width_m=LANE_M,
            speed_limit_mps=CRUISE_MPS + 2.0,
            oncoming=((BEGIN_M, END_M),),
        ),
        weather=weather,
        ego=EgoCar(road.forward.pose_at(0.0), CRUISE_MPS, friction=weather.friction, model=car),
        vehicles=tuple(actor for actor in street.actors if not actor.is_person),
        walkers=tuple(actor for actor in street.actors if actor.is_person),
    )


_STYLE: Final = RoadStyle(0.0, 0.0, LANE_M, parking=True, main_stream=0, pace=1.0)
_SURFACES: Final = {Material.ASPHALT: "road", Material.PAVEMENT: "pavement", Material.MARKING: "marking"}


def _road(scene: StreetScene) -> Road:
    """Return the road, a straight line along x, with the scenery of a scene."""
    centre = ReferenceLine(0.0, 0.0, 0.0, (Piece(END_M),))
    still: list[tuple[str, Building | Body | Tree, float, float, float]] = [
        ("building", body, body.yaw_rad, body.length_m, body.width_m) for body in scene.buildings
    ]
    still += [("parked-car", body, body.yaw_rad, body.length_m, body.width_m) for body in scene.parked]
    still += [("tree", tree, 0.0, TRUNK_M, TRUNK_M) for tree in scene.trees]
    fixtures = tuple(
        Fixture(
            kind=kind,
            x_m=one.x_m,
            y_m=one.y_m,
            yaw_rad=yaw_rad,
            length_m=length_m,
            width_m=width_m,
            height_m=one.height_m,
        )
        for kind, one, yaw_rad, length_m, width_m in still
    )
    return Road(
        curve=RoadCurve.STRAIGHT,
        style=_STYLE,
        length_m=END_M,
        centre=centre,
        forward=centre.parallel(LANE_Y_M),
        backward=centre.parallel(-LANE_Y_M).backwards(),
        junctions=(),
        crossing_m=math.inf,
        scenery=Scenery(
            fixtures=fixtures,
            surfaces=tuple(
                Surface(
                    kind=_SURFACES[ground.material],
                    points=ground.points.astype(np.float32),
                    closed=True,
                    width_m=0.0,
                )
                for ground in scene.ground
                if ground.material in _SURFACES
            ),
        ),
    )


def make_street(scenario: AebScenario, seed: int) -> Street:
    """Return the street of an episode at time 0.

    The ego starts with its centre at x = 0; its bumper reaches the pedestrian's line after `crossing_m`.
    """
    line_x_m = EGO_FRONT_M + scenario.crossing_m
    parked = _parked(scenario, seed, line_x_m)
    return Street(
        scene=StreetScene(
            ground=_ground(),
            buildings=_buildings(seed),
            trees=_trees(seed),
            parked=parked,
            lamps=_lamps(),
            furniture=_furniture(seed, line_x_m),
        ),
        actors=_actors(scenario, seed, line_x_m, first_id=len(parked) + 1),
    )


def _strip(
    y_low: float, y_high: float, material: Material, x_low: float = BEGIN_M, x_high: float = END_M
) -> Ground:
    points = np.array([[x_low, y_low], [x_high, y_low], [x_high, y_high], [x_low, y_high]])
    return Ground(material=material, points=points)


def _ground() -> tuple[Ground, ...]:
    far_m = KERB_M + PAVEMENT_M
    surfaces = [_strip(-60.0, 60.0, Material.GRASS), _strip(-far_m, far_m, Material.PAVEMENT)]
    surfaces.append(_strip(-KERB_M - 0.15, KERB_M + 0.15, Material.KERB))
    surfaces.append(_strip(-KERB_M, KERB_M, Material.ASPHALT))
    for side in (-1.0, 1.0):
        edge = side * LANE_M
        surfaces.append(_strip(edge - 0.05, edge + 0.05, Material.MARKING))
    dashes = np.arange(BEGIN_M, END_M, 6.0).tolist()
    surfaces += [_strip(-0.06, 0.06, Material.MARKING, start_m, start_m + 3.0) for start_m in dashes]
    return tuple(surfaces)


def _buildings(seed: int) -> tuple[Building, ...]:
    rng = generator(seed, Stream.STREET)
    houses = []
    for side in (-1.0, 1.0):
        x_m = BEGIN_M
        while x_m < END_M + 20.0:
            length_m, depth_m = float(rng.uniform(9.0, 17.0)), float(rng.uniform(8.0, 12.0))
            houses.append(
                Building(
                    x_m=x_m + 0.5 * length_m,
                    y_m=side * (KERB_M + PAVEMENT_M + 0.3 + 0.5 * depth_m),
                    yaw_rad=0.0 if side < 0 else math.pi,
                    length_m=length_m,
                    width_m=depth_m,
                    height_m=float(rng.uniform(6.0, 14.0)),
                    look=int(rng.integers(1_000)),
                )
            )
            x_m += length_m + float(rng.choice([0.2, 0.2, 3.0]))
    return tuple(houses)


def _trees(seed: int) -> tuple[Tree, ...]:
    rng = generator(seed, Stream.STREET, 1)
    return tuple(
        Tree(
            x_m=x_m + float(rng.uniform(-2.0, 2.0)), y_m=side * (KERB_M + 0.7),
            height_m=float(rng.uniform(5.0, 7.5)), crown_m=float(rng.uniform(2.4, 3.6)),
            look=int(rng.integers(1_000)),
        )
        for side in (-1.0, 1.0)
        for x_m in np.arange(BEGIN_M + 5.0, END_M, 19.0).tolist()
    )  # fmt: skip


def _lamps() -> tuple[Lamp, ...]:
    return tuple(
        Lamp(x_m=x_m, y_m=-KERB_M - 0.5, yaw_rad=0.5 * math.pi)
        for x_m in np.arange(BEGIN_M, END_M, 28.0).tolist()
    )


_BY_THE_KERB: Final = (
    FurnitureKind.BICYCLE,
    FurnitureKind.BIN,
    *[FurnitureKind.BOLLARD] * 2,
    FurnitureKind.POST_BOX,
    *[FurnitureKind.SIGN] * 2,
    *[FurnitureKind.METER] * 2,
)
_BY_THE_WALL: Final = (
    FurnitureKind.BICYCLE,
    FurnitureKind.BIN,
    *[FurnitureKind.PLANTER] * 2,
    FurnitureKind.BENCH,
    FurnitureKind.BOARD,
)
_IN_ROWS: Final = {FurnitureKind.BICYCLE: (0.15, 0.5), FurnitureKind.BOLLARD: (1.2, 1.6)}
"""Gaps between items that stand in rows, in m."""
_FACING_TRAFFIC: Final = (FurnitureKind.SIGN, FurnitureKind.BOARD, FurnitureKind.METER)


def _furniture(seed: int, line_x_m: float) -> tuple[Furniture, ...]:
    """Return street furniture, which is only seen: on the pavements and away from the paths of both pedestrians."""
    rng = generator(seed, Stream.STREET, 2)
    posts = [(tree.x_m, tree.y_m) for tree in _trees(seed)] + [(lamp.x_m, lamp.y_m) for lamp in _lamps()]
    found: list[Furniture] = []
    for side in (-1.0, 1.0):
        by_the_kerb = [(line_x_m, 0.5), *((x_m, 0.0) for x_m, y_m in posts if y_m * side > 0)]
        for kinds, from_kerb_m, taken in (
            (_BY_THE_KERB, 0.55, by_the_kerb),
            (_BY_THE_WALL, PAVEMENT_M - 0.05, by_the_kerb[:1]),
        ):
            x_m = BEGIN_M + 2.0
            while x_m < END_M:
                kind = kinds[int(rng.integers(len(kinds)))]
                count = int(rng.integers(1, 4)) if kind in _IN_ROWS else 1
                for _ in range(count):
                    item = _item(kind, x_m, side, from_kerb_m, rng)
                    if all(abs(x_m - at_m) > 0.5 * item.length_m + 0.5 + more_m for at_m, more_m in taken):
                        found.append(item)
                    x_m += item.length_m + float(rng.uniform(*_IN_ROWS.get(kind, (0.2, 0.2))))
                x_m += float(rng.uniform(4.0, 16.0))
    return tuple(found)


def _item(
    kind: FurnitureKind, x_m: float, side: float, from_kerb_m: float, rng: np.random.Generator
) -> Furniture:
    length_m, width_m, height_m = FURNITURE_SIZE_M[kind]
    # Signs, boards and meters face those who come along the street.
    yaw_rad = (math.pi if side < 0 else 0.0) if kind in _FACING_TRAFFIC else (0.0 if side < 0 else math.pi)
    yaw_rad += float(rng.uniform(-0.08, 0.08))
    return Furniture(
        kind=kind,
        x_m=x_m,
        y_m=side * (KERB_M + from_kerb_m),
        yaw_rad=yaw_rad,
        length_m=length_m,
        width_m=width_m,
        height_m=height_m * float(rng.uniform(0.92, 1.08)),
        look=int(rng.integers(1_000)),
    )


def _parked(scenario: AebScenario, seed: int, line_x_m: float) -> tuple[Body, ...]:
    """Return parked vehicles on both sides; on the ego's side, two of them enclose the pedestrian's gap."""
    rng = generator(seed, Stream.LOOKS)
    places: list[tuple[float, float, VehicleSize]] = []
    before = VAN if scenario.occluder is Occluder.VAN else CAR
    first_x_m = line_x_m - 0.5 * GAP_M - 0.5 * before.length_m
    places += [(first_x_m, -1.0, before), (line_x_m + 0.5 * (GAP_M + CAR.length_m), -1.0, CAR)]
    for side in (-1.0, 1.0):
        x_m = BEGIN_M + 4.0
        while x_m < END_M - 10.0:
            size = VAN if rng.random() < 0.15 else CAR
            free = rng.random() < 0.25
            near_gap = side < 0 and first_x_m - 5.2 - before.length_m / 2 < x_m < line_x_m + 10.5
            if not (free or near_gap):
                places.append((x_m, side, size))
            x_m += size.length_m + float(rng.uniform(0.8, 1.6))
    return tuple(
        Body(
            id=index + 1,
            kind=BodyKind.VEHICLE,
            x_m=x_m,
            y_m=side * (LANE_M + 0.5 * STRIP_M + 0.05),
            yaw_rad=0.0 if side < 0 else math.pi,
            length_m=size.length_m,
            width_m=size.width_m,
            height_m=size.height_m,
            look=int(rng.integers(1_000)),
        )
        for index, (x_m, side, size) in enumerate(places)
    )


def _actors(scenario: AebScenario, seed: int, line_x_m: float, first_id: int) -> tuple[Actor, ...]:
    people, traffic = generator(seed, Stream.STROLLERS), generator(seed, Stream.OTHER_TRAFFIC)
    actors = [_pedestrian(scenario, people, line_x_m, first_id), _stroller(people, first_id + 1)]
    for index, ahead_m in enumerate(
        (scenario.oncoming_m, scenario.oncoming_m + float(traffic.uniform(25.0, 45.0)))
    ):
        size = VAN if traffic.random() < 0.3 else CAR
        actors.append(
            _vehicle(
                f"oncoming-{index + 1}", first_id + 2 + index, traffic, size, ahead_m, 0.5 * LANE_M, math.pi
            )
        )
    ahead_m = float(traffic.uniform(38.0, 50.0))
    actors.append(_vehicle("ahead", first_id + 4, traffic, CAR, ahead_m, LANE_Y_M, 0.0))
    if scenario.obstacle is not Obstacle.NONE:
        actors.append(_obstacle(scenario.obstacle, people, line_x_m, first_id + 5))
    return tuple(actors)


def _pedestrian(scenario: AebScenario, rng: np.random.Generator, line_x_m: float, number: int) -> Actor:
    """Return the pedestrian, whose arrival in the middle of the lane is timed for an ego that does not brake."""
    from_y_m = -(LANE_M + STRIP_M - 0.3)
    travelled_m = LANE_Y_M - from_y_m
    arrival_s = scenario.crossing_m / CRUISE_MPS + scenario.arrival_s
    length_m, width_m, height_m = PERSON_SIZE_M
    body = Body(
        id=number,
        kind=BodyKind.PERSON,
        x_m=line_x_m,
        y_m=from_y_m,
        yaw_rad=0.5 * math.pi,
        length_m=length_m,
        width_m=width_m,
        height_m=height_m + float(rng.uniform(-0.1, 0.1)),
        look=int(rng.integers(1_000)),
    )
    return Actor(
        "pedestrian",
        body,
        cruise_mps=WALKING_MPS,
        starts_s=arrival_s - travelled_m / WALKING_MPS - 0.5 * WALKING_MPS / WALK_ACCEL_MPS2,
        stops_after_m=2.0 * (KERB_M + 0.8),
    )


def _stroller(rng: np.random.Generator, number: int) -> Actor:
    """Return the second pedestrian, who stays on the pavement."""
    length_m, width_m, height_m = PERSON_SIZE_M
    along = float(rng.choice([0.0, math.pi]))
    x_m, y_m = float(rng.uniform(15.0, 50.0)), -(KERB_M + float(rng.uniform(1.3, 2.3)))
    body = Body(
        id=number,
        kind=BodyKind.PERSON,
        x_m=x_m,
        y_m=y_m,
        yaw_rad=along,
        length_m=length_m,
        width_m=width_m,
        height_m=height_m,
        look=int(rng.integers(1_000)),
    )
    speed_mps = float(rng.uniform(1.0, 1.5))
    return Actor("stroller", body, speed_mps=speed_mps, cruise_mps=speed_mps)


def _vehicle(
    name: str,
    number: int,
    rng: np.random.Generator,
    size: VehicleSize,
    x_m: float,
    y_m: float,
    yaw_rad: float,
) -> Actor:
    body = Body(
        id=number,
        kind=BodyKind.VEHICLE,
        x_m=x_m,
        y_m=y_m,
        yaw_rad=yaw_rad,
        length_m=size.length_m,
        width_m=size.width_m,
        height_m=size.height_m,
        look=int(rng.integers(1_000)),
    )
    cruise_mps = float(rng.uniform(8.2, 9.5))
    return Actor(name, body, speed_mps=cruise_mps, cruise_mps=cruise_mps)


def _obstacle(obstacle: Obstacle, rng: np.random.Generator, line_x_m: float, number: int) -> Actor:
    """Return the obstacle, at a random position in the ego's lane before the pedestrian's line."""
    tree = obstacle is Obstacle.NOVELTY
    length_m, width_m, height_m = TREE_SIZE_M if tree else OVERTURNED_SIZE_M
    x_m, y_m = float(rng.uniform(25.0, line_x_m - 12.0)), LANE_Y_M + float(rng.uniform(-0.5, 0.5))
    body = Body(
        id=number,
        kind=BodyKind.FALLEN_TREE if tree else BodyKind.OVERTURNED_VEHICLE,
        x_m=x_m,
        y_m=y_m,
        yaw_rad=float(rng.uniform(1.2, 1.9)),
        length_m=length_m,
        width_m=width_m,
        height_m=height_m,
        look=int(rng.integers(1_000)),
    )
    return Actor(obstacle.value, body)
