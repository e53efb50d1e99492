"""How well reference drivers drive: collisions on empty roads, and where the driving system is safe.

A reference driver decides what was avoidable, so it should cope wherever the system under test does.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from benchmarks.measurement import Progress, Row, at_most
from benchmarks.trials import mapped, run_record
from brink.server.problems.npc_actions import NpcActions, NpcActionsParams
from brink.sim.encounter.reference import COLLISION, Driver
from brink.sim.episode import EpisodeSpec

MAX_SHARE: Final[dict[Driver, float]] = {Driver.CAREFUL: 0.05, Driver.IDEAL: 0.0}
"""Largest acceptable share of drives with a collision, among drives that are safe for the system."""
EMPTY_ROADS: Final = 5


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What happened to one candidate.

    Attributes:
        weather: The weather.
        safe: Whether the driving system violated nothing.
        hit: The reference drivers who had a collision; nobody drives if the system is not safe.
    """

    weather: str
    safe: bool
    hit: frozenset[Driver]


def drive(spec: EpisodeSpec) -> Outcome:
    """Drive with the system, and with the reference drivers where it is safe."""
    weather = str(spec.scenario["weather"])
    if run_record(spec).unsafe:
        return Outcome(weather=weather, safe=False, hit=frozenset())
    return Outcome(weather=weather, safe=True, hit=frozenset(who for who in Driver if _collides(spec, who)))


def _collides(spec: EpisodeSpec, driver: Driver) -> bool:
    its = replace(spec, behaviour={"mode": "reference", "driver": driver.value}, options={})
    return run_record(its).robustness[COLLISION] < 0


def specs(candidates: int, weathers: Sequence[str], seed: int) -> list[EpisodeSpec]:
    """Return random candidates of `npc-actions@1` in each weather; the first of each are on empty roads."""
    problem = NpcActions(NpcActionsParams())
    rng = np.random.default_rng(seed)
    drawn = [problem.episode(problem.space.sample(rng), seed * 10_000 + place) for place in range(candidates)]
    empty = [replace(spec, scenario={**spec.scenario, "road_users": []}) for spec in drawn[:EMPTY_ROADS]]
    return [
        replace(spec, scenario={**spec.scenario, "weather": weather}, options={})
        for weather in weathers
        for spec in (*empty, *drawn)
    ]


def measure_drivers(
    *, candidates: int, weathers: Sequence[str], seed: int, processes: int, progress: Progress
) -> list[Row]:
    """Measure in how many drives the reference drivers collide.

    Args:
        candidates: Number of random candidates in each weather.
        weathers: The weathers.
        seed: Seed of the candidates.
        processes: Number of processes.
        progress: Progress callback.
    """
    wanted = specs(candidates, weathers, seed)
    outcomes = mapped(drive, wanted, processes=processes, part="candidates", progress=progress, chunk=4)
    return rows_of(outcomes, weathers)


def rows_of(outcomes: Sequence[Outcome], weathers: Sequence[str]) -> list[Row]:
    """Return the rows for outcomes in the order of `specs`."""
    rows = []
    each = len(outcomes) // len(weathers)
    for place, weather in enumerate(weathers):
        found = outcomes[place * each : (place + 1) * each]
        empty, safe = found[:EMPTY_ROADS], [one for one in found[EMPTY_ROADS:] if one.safe]
        words = weather.replace("_", " ")
        for driver in Driver:
            hits = sum(driver in one.hit for one in empty)
            rows.append(
                at_most(f"collisions on empty roads, {driver}, {words}", hits, 0, f"{len(empty)} drives")
            )
            hits = sum(driver in one.hit for one in safe)
            share = hits / len(safe) if safe else 0.0
            note = f"{hits} of {len(safe)} drives that are safe for the system"
            rows.append(
                at_most(
                    f"share of drives with a collision, {driver}, {words}", share, MAX_SHARE[driver], note
                )
            )
    return rows
