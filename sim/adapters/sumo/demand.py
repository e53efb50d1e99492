"""The vehicles on the networks that ship with Brink: who drives where, as a demand in SUMO's format.

The roads are full from the first step on: vehicles drive in line with the headways of the demand, each with a jitter
of its own, and more of them enter at the edges of the network. The ego alone always begins in the same place.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from itertools import count, pairwise, product
from typing import Final

import numpy as np

from brink.sim.adapters.sumo.specification import HARDEST_BRAKING_MPS2, Drive, Network

EGO: Final = "ego"
CAR_M: Final = (4.6, 1.8)
"""Length and width of a car."""
TRUCK_M: Final = (12.0, 2.5)
TRUCKS_MPS: Final = 24.5
"""Highest speed of trucks."""
STANDSTILL_GAP_M: Final = 2.5
"""Gap that vehicles keep when they stand: ``minGap`` of SUMO."""
COMFORTABLE_BRAKING_MPS2: Final = 4.5
PEOPLES_HEADWAY_S: Final = 1.2
TURNING_SHARE: Final = 0.2
"""Share of the vehicles that leave or join the arterial road, or turn right at a crossroads of the grid."""
_JITTER: Final = 0.25
"""How far headways may be from their mean, as a share of it."""
_STRAIGHT_ON: Final = round(1.0 / TURNING_SHARE) - 1
_CROSSROADS: Final = 6
_GRID: Final = 5


class Stream(IntEnum):
    """Purpose of a random stream. Changing a value changes the outcome of episodes."""

    SUMO = 0
    LANE = 1
    ENTRY = 2
    OWN_DEMAND = 3
    WAYS = 4


def generator(seed: int, stream: Stream, index: int = 0) -> np.random.Generator:
    """Return the random generator for one part of an episode's demand."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(int(stream), index)))


@dataclass(frozen=True, slots=True, kw_only=True)
class Lane:
    """A lane that is full of vehicles when the episode begins.

    Attributes:
        edge: Its edge.
        lane: Its index, from the right.
        length_m: Length of the part that is full.
        speed_mps: Speed of the vehicles there.
        headway_s: Mean time between two vehicles, when the network is as full as it can be.
        routes: The ways on from there: lists of edges, the lane's own first. One is drawn for each vehicle.
        trucks: Whether trucks use it.
    """

    edge: str
    lane: int
    length_m: float
    speed_mps: float
    headway_s: float
    routes: tuple[tuple[str, ...], ...]
    trucks: bool = True


@dataclass(frozen=True, slots=True, kw_only=True)
class Ego:
    """The ego's start: edge, lane, position of its front bumper, speed and route."""

    lane: int
    position_m: float
    speed_mps: float
    route: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Roads:
    """The traffic of a network.

    Attributes:
        ego: Where the ego begins.
        full: Lanes that are full when the episode begins.
        entries: Lanes at whose beginning vehicles enter.
        repeat: How often a route is driven; above 1 on a ring.
    """

    ego: Ego
    full: tuple[Lane, ...]
    entries: tuple[Lane, ...]
    repeat: int = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class _Vehicle:
    """A vehicle that waits in a queue or enters the network.

    Attributes:
        name: Its id.
        kind: Its type: ``car``, ``truck`` or ``automated``.
        route: Its edges.
        repeat: How often it drives them.
        lane: Lane on the first of them.
        depart_s: When it departs.
        start: Place of its front bumper and speed; None if it enters at the beginning of the lane when there is room.
    """

    name: str
    kind: str
    route: tuple[str, ...]
    repeat: int
    lane: int
    depart_s: float
    start: tuple[float, float] | None = None

    @property
    def xml(self) -> str:
        """The vehicle in SUMO's format."""
        where = 'departPos="base" departSpeed="max"'
        if self.start is not None:
            # It is there whatever happens, or the ego would not always meet the same traffic.
            place_m, speed_mps = self.start
            where = f'departPos="{place_m:.2f}" departSpeed="{speed_mps:.2f}" insertionChecks="none"'
        again = f' repeat="{self.repeat}"' if self.repeat > 1 else ""
        return (
            f'<vehicle id="{self.name}" type="{self.kind}" depart="{self.depart_s:.2f}" departLane="{self.lane}" '
            f'{where}><route edges="{" ".join(self.route)}"{again}/></vehicle>'
        )


def demand_xml(drive: Drive, seed: int, duration_s: float) -> str:
    """Return the demand of an episode on a network that ships with Brink, in SUMO's format.

    Args:
        drive: The episode.
        seed: Its seed.
        duration_s: Simulated time from the beginning of the traffic.
    """
    roads = ROADS[Network(drive.traffic.network)]
    begin_s, ego = drive.traffic.begin_s, roads.ego
    vehicles = [
        _Vehicle(
            name=EGO,
            kind="automated",
            route=ego.route,
            repeat=roads.repeat,
            lane=ego.lane,
            depart_s=begin_s,
            start=(ego.position_m, ego.speed_mps),
        )
    ]
    if drive.traffic.demand > 0.0:
        vehicles += _in_line(roads, drive, seed, begin_s)
        vehicles += _entering(roads, drive, seed, begin_s, duration_s)
    lines = [*_types(drive), *(vehicle.xml for vehicle in vehicles)]
    return "<routes>\n" + "\n".join(lines) + "\n</routes>\n"


def _in_line(roads: Roads, drive: Drive, seed: int, begin_s: float) -> Iterator[_Vehicle]:
    numbers = count(1)
    for index, lane in enumerate(roads.full):
        for place_m, kind, route in _standing(lane, drive, generator(seed, Stream.LANE, index), roads.ego):
            speed_mps = min(lane.speed_mps, TRUCKS_MPS) if kind == "truck" else lane.speed_mps
            yield _Vehicle(
                name=f"{kind}-{next(numbers)}",
                kind=kind,
                route=route,
                repeat=roads.repeat,
                lane=lane.lane,
                depart_s=begin_s,
                start=(place_m, speed_mps),
            )


def _entering(roads: Roads, drive: Drive, seed: int, begin_s: float, duration_s: float) -> Iterator[_Vehicle]:
    arrivals = [
        (at_s, index, kind, route)
        for index, lane in enumerate(roads.entries)
        for at_s, kind, route in _arriving(lane, drive, generator(seed, Stream.ENTRY, index), duration_s)
    ]
    # SUMO wants vehicles in order of departure.
    for number, (at_s, index, kind, route) in enumerate(sorted(arrivals, key=lambda one: one[:2]), start=1):
        yield _Vehicle(
            name=f"{kind}-in-{number}",
            kind=kind,
            route=route,
            repeat=roads.repeat,
            lane=roads.entries[index].lane,
            depart_s=begin_s + at_s,
        )


def _types(drive: Drive) -> Iterator[str]:
    traffic = drive.traffic
    people = f'sigma="{traffic.imperfection!r}" tau="{PEOPLES_HEADWAY_S}" speedDev="0.1"'
    automated = f'sigma="0" tau="{drive.headway_s!r}" speedDev="0"'
    truck = f'{people} maxSpeed="{TRUCKS_MPS}" vClass="truck"'
    equipped = '<param key="has.driverstate.device" value="true"/>'
    hardest_mps2 = HARDEST_BRAKING_MPS2[traffic.surface]
    braking = (
        f'decel="{comfortable_braking_mps2(hardest_mps2)!r}" emergencyDecel="{hardest_mps2!r}" '
        f'minGap="{STANDSTILL_GAP_M}"'
    )
    for name, (length_m, width_m), accel_mps2, driver, inside in (
        ("car", CAR_M, 2.6, people, ""),
        ("truck", TRUCK_M, 1.0, truck, ""),
        ("automated", CAR_M, 2.6, automated, equipped),
    ):
        size = f'length="{length_m}" width="{width_m}"'
        yield f'<vType id="{name}" {size} accel="{accel_mps2}" {braking} {driver}>{inside}</vType>'


def comfortable_braking_mps2(hardest_mps2: float) -> float:
    """Return the deceleration at which drivers brake comfortably."""
    return min(COMFORTABLE_BRAKING_MPS2, 0.75 * hardest_mps2)


def _standing(
    lane: Lane, drive: Drive, rng: np.random.Generator, ego: Ego
) -> Iterator[tuple[float, str, tuple[str, ...]]]:
    """Yield position, kind and route of the vehicles on a lane, from its end to its beginning."""
    at_m = lane.length_m - _spacing_m(lane, drive, rng) * float(rng.uniform(0.5, 1.0))
    begins = lane.edge == ego.route[0] and lane.lane == ego.lane
    while at_m > TRUCK_M[0]:
        kind, route = _kind(lane, drive, rng), lane.routes[int(rng.integers(len(lane.routes)))]
        length_m = (TRUCK_M if kind == "truck" else CAR_M)[0]
        if not begins or not _in_the_way(at_m, length_m, lane, ego):
            yield at_m, kind, route
        at_m -= max(_spacing_m(lane, drive, rng), _closest_m(length_m, lane.speed_mps))


def _in_the_way(at_m: float, length_m: float, lane: Lane, ego: Ego) -> bool:
    behind, ahead = _closest_m(CAR_M[0], ego.speed_mps), _closest_m(length_m, lane.speed_mps)
    return ego.position_m - behind < at_m < ego.position_m + ahead


def _closest_m(length_m: float, speed_mps: float) -> float:
    """Return the minimum distance between the front bumpers of two vehicles."""
    return length_m + STANDSTILL_GAP_M + PEOPLES_HEADWAY_S * speed_mps


def _spacing_m(lane: Lane, drive: Drive, rng: np.random.Generator) -> float:
    return _headway_s(lane, drive, rng) * lane.speed_mps


def _headway_s(lane: Lane, drive: Drive, rng: np.random.Generator) -> float:
    return float(lane.headway_s / drive.traffic.demand * rng.uniform(1.0 - _JITTER, 1.0 + _JITTER))


def _kind(lane: Lane, drive: Drive, rng: np.random.Generator) -> str:
    # Two draws in any case: a change of one share must not change who the other vehicles are.
    truck, automated = rng.random() < drive.traffic.trucks, rng.random() < drive.traffic.automated
    if truck and lane.trucks:
        return "truck"
    return "automated" if automated else "car"


def _arriving(
    lane: Lane, drive: Drive, rng: np.random.Generator, duration_s: float
) -> Iterator[tuple[float, str, tuple[str, ...]]]:
    """Yield time, kind and route of the vehicles that enter a lane."""
    at_s = _headway_s(lane, drive, rng) * float(rng.uniform(0.2, 1.0))
    while at_s < duration_s:
        yield at_s, _kind(lane, drive, rng), lane.routes[int(rng.integers(len(lane.routes)))]
        at_s += _headway_s(lane, drive, rng)


def _motorway() -> Roads:
    way = ("before", "merge", "after")
    speeds_mps = (25.0, 28.0, 31.0)
    full = [
        # The merging lane is the rightmost one of its edge.
        Lane(
            edge=edge,
            lane=lane + (edge == "merge"),
            length_m=length_m,
            speed_mps=speed_mps,
            headway_s=2.0,
            routes=(way[way.index(edge) :],),
            trucks=lane < 2,
        )
        for edge, length_m in (("before", 1525.0), ("merge", 264.0), ("after", 2000.0))
        for lane, speed_mps in enumerate(speeds_mps)
    ]
    slip = Lane(
        edge="ramp", lane=0, length_m=402.0, speed_mps=20.0, headway_s=4.0, routes=(("ramp", *way[1:]),)
    )
    return Roads(
        ego=Ego(lane=0, position_m=700.0, speed_mps=25.0, route=way),
        full=(*full, slip),
        entries=(*full[: len(speeds_mps)], slip),
    )


def _arterial() -> Roads:
    east = tuple(f"a{index}_a{index + 1}" for index in range(_CROSSROADS + 1))
    west = tuple(f"a{index + 1}_a{index}" for index in reversed(range(_CROSSROADS + 1)))
    along = [
        Lane(
            edge=way[place],
            lane=lane,
            length_m=260.0,
            speed_mps=10.0,
            headway_s=4.0,
            routes=_ways_on(way[place:], side) if lane == 0 else (way[place:],),
            trucks=lane == 0,
        )
        for way, side in ((east, "s"), (west, "n"))
        for place in range(len(way))
        for lane in range(2)
    ]
    across = []
    for index in range(1, _CROSSROADS + 1):
        # Those from the south turn right to the east, those from the north to the west.
        for one, other, main in (("s", "n", east[index:]), ("n", "s", west[_CROSSROADS + 1 - index :])):
            begin, end = f"{one}{index}_a{index}", f"a{index}_{other}{index}"
            routes = (*(((begin, end),) * _STRAIGHT_ON), (begin, *main))
            across.append(
                Lane(edge=begin, lane=0, length_m=180.0, speed_mps=8.0, headway_s=9.0, routes=routes)
            )
    return Roads(
        ego=Ego(lane=0, position_m=120.0, speed_mps=10.0, route=east),
        full=(*along, *across),
        entries=(*(lane for lane in along if lane.edge in (east[0], west[0])), *across),
    )


def _ways_on(on: tuple[str, ...], side: str) -> tuple[tuple[str, ...], ...]:
    """Return the routes of vehicles in the arterial road's right lane: straight on, or right at a crossroads soon."""
    leaving = []
    for step in range(min(2, len(on) - 1)):
        crossroads = on[step].partition("_")[2]
        leaving.append((*on[: step + 1], f"{crossroads}_{side}{crossroads[1:]}"))
    return (*((on,) * max(1, _STRAIGHT_ON * len(leaving))), *leaving)


_STEPS: Final[Mapping[str, tuple[int, int]]] = {"n": (0, 1), "e": (1, 0), "s": (0, -1), "w": (-1, 0)}
"""Headings, each to the right of the one before."""


def _grid() -> Roads:
    rng = generator(0, Stream.WAYS)  # the same ways through the grid for every episode
    full, entries = [], []
    for column, row in product(range(_GRID + 2), repeat=2):
        for heading, (right, up) in _STEPS.items():
            one, other = (column, row), (column + right, row + up)
            if not (_is_node(*one) and _is_node(*other)) or not (_is_inside(*one) or _is_inside(*other)):
                continue
            routes = tuple(_wander(one, heading, rng) for _ in range(4))
            edge = _edge(one, other)
            full.append(Lane(edge=edge, lane=0, length_m=120.0, speed_mps=7.0, headway_s=4.5, routes=routes))
            if not _is_inside(*one):
                entries.append(replace(full[-1], headway_s=7.0))
    # To the east, and then once around to the right.
    corners = ((0, 3), (3, 3), (3, 1), (1, 1), (1, 5), (5, 5))
    ego = Ego(lane=0, position_m=60.0, speed_mps=7.0, route=_way_along(corners))
    return Roads(ego=ego, full=tuple(full), entries=tuple(entries))


def _way_along(corners: Sequence[tuple[int, int]]) -> tuple[str, ...]:
    """Return the edges of a route through the grid with these corners."""
    edges = []
    for one, other in pairwise(corners):
        right, up = (int(np.sign(b - a)) for a, b in zip(one, other, strict=True))
        while one != other:
            following = one[0] + right, one[1] + up
            edges.append(_edge(one, following))
            one = following
    return tuple(edges)


def _is_inside(column: int, row: int) -> bool:
    return 1 <= column <= _GRID and 1 <= row <= _GRID


def _is_node(column: int, row: int) -> bool:
    on_grid = 0 <= column <= _GRID + 1 and 0 <= row <= _GRID + 1
    return on_grid and (1 <= column <= _GRID or 1 <= row <= _GRID)


def _edge(one: tuple[int, int], other: tuple[int, int]) -> str:
    return f"g{one[0]}{one[1]}_g{other[0]}{other[1]}"


def _wander(begin: tuple[int, int], heading: str, rng: np.random.Generator) -> tuple[str, ...]:
    """Return a route through the grid: straight on or right, until it leaves the grid or is twelve streets long.

    Nobody turns left: on such small crossroads, a truck that waits to turn left stands in the way of the traffic
    behind it, which SUMO would count as collisions.
    """
    headings = tuple(_STEPS)
    edges = []
    at = begin
    for _ in range(12):
        right, up = _STEPS[heading]
        following = at[0] + right, at[1] + up
        edges.append(_edge(at, following))
        at = following
        if not _is_inside(*at):
            break
        turns = int(rng.random() < TURNING_SHARE)
        heading = headings[(headings.index(heading) + turns) % len(headings)]
    return tuple(edges)


def _ring() -> Roads:
    edges = ("q0", "q1", "q2", "q3")
    length_m = math.tau * 200.0 / len(edges)
    full = [
        Lane(
            edge=edge,
            lane=0,
            length_m=length_m,
            speed_mps=8.0,
            headway_s=2.4,
            routes=((*edges[place:], *edges[:place]),),
        )
        for place, edge in enumerate(edges)
    ]
    ego = Ego(lane=0, position_m=150.0, speed_mps=8.0, route=edges)
    return Roads(ego=ego, full=tuple(full), entries=(), repeat=10)


ROADS: Final[Mapping[Network, Roads]] = {
    Network.MOTORWAY: _motorway(),
    Network.ARTERIAL: _arterial(),
    Network.GRID: _grid(),
    Network.RING: _ring(),
}
