"""Owns who walks along a road: most keep to the pavement, some use the crossing, some cross elsewhere."""

import math

from brink.sim.urban.scenario import DrivingTask
from brink.sim.world.lights import SignalPlan
from brink.sim.world.road import Road
from brink.sim.world.streams import Stream, generator
from brink.sim.world.walker import GoAhead, Walker
from brink.sim.world.weather import Conditions

ZEBRA_SHARE = 1.0 / 3.0
ELSEWHERE_SHARE = 1.0 / 6.0
CLEAR_OF_JUNCTION_M = 6.0
NEEDED_RED_S = 4.0
"""People start over a lit crossing only if the light stays with them for this long."""


def make_people(
    road: Road, weather: Conditions, signals: SignalPlan | None, *, count: int, seed: int, task: DrivingTask
) -> list[Walker]:
    """Return all walkers of an episode.

    Args:
        road: Where they walk.
        weather: Makes them hurry.
        signals: The lights, if the crossing has some.
        count: How many.
        seed: The episode's seed.
        task: What the ego does; people who cross elsewhere do so where it passes.
    """
    walkers = []
    at_zebra, elsewhere = round(count * ZEBRA_SHARE), round(count * ELSEWHERE_SHARE)
    reach_m = road.length_m if task is DrivingTask.FOLLOW_ROAD else 0.8 * road.length_m
    go_ahead: GoAhead | None = None
    if signals is not None:
        go_ahead = _with_light(signals)
    for index in range(count):
        rng = generator(seed, Stream.PEDESTRIAN, index)
        speed = weather.walking_mps * float(rng.uniform(0.92, 1.08))
        ahead = index % 2 == 0
        side = 1.0 if index % 4 < 2 else -1.0
        direction = 1.0 if ahead else -1.0
        crosses_at_m: float | None = None
        if index < at_zebra:
            crosses_at_m = road.crossing_m + float(rng.uniform(-0.8, 0.8))
            arrives_s = 1.0 + 9.0 * (index // 2) + 0.8 * (index % 2) + float(rng.uniform(-0.5, 0.5))
            station_m = crosses_at_m - direction * speed * arrives_s
        elif index < at_zebra + elsewhere:
            place = (index - at_zebra + 1) / (elsewhere + 1)
            wanted_m = reach_m * (0.30 + 0.65 * place) + float(rng.uniform(-1.5, 1.5))
            crosses_at_m = _clear_of_junctions(road, wanted_m)
            arrives_s = crosses_at_m / 7.0 + 3.0 + float(rng.uniform(-1.0, 1.0))
            station_m = crosses_at_m - direction * speed * arrives_s
        else:
            station_m = road.length_m * index / count + float(rng.uniform(-3.0, 3.0))
        walkers.append(
            Walker(
                name=f"pedestrian-{index + 1}",
                centre=road.centre,
                station_m=station_m,
                offset_m=side * (road.walkway_m + float(rng.uniform(-0.4, 0.4))),
                speed_mps=speed,
                ahead=ahead,
                crosses_at_m=crosses_at_m,
                kerb_m=road.kerb_m,
                patience_s=weather.patience_s,
                go_ahead=go_ahead if index < at_zebra else None,
                on_zebra=index < at_zebra and signals is None,
            )
        )
    return walkers


def _clear_of_junctions(road: Road, station_m: float) -> float:
    """Return the nearest place to cross that is not in a junction."""
    reach_m = road.kerb_m + road.style.pavement_m + CLEAR_OF_JUNCTION_M
    for junction in road.junctions:
        beyond_m = station_m - junction.station_m
        if abs(beyond_m) < reach_m:
            return junction.station_m + math.copysign(reach_m, beyond_m)
    return station_m


def _with_light(signals: SignalPlan) -> GoAhead:
    def go_ahead(time_s: float) -> bool:
        return signals.main_red_for_s(time_s) > NEEDED_RED_S

    return go_ahead
