"""The guard in the loop: the same fresh drives without a guard, and with one and its fallback at several thresholds.

Drives are independent draws of scenario, behaviour and chance, so they are the same under every condition until the
first intervention. Nothing of them was in any training data if their seeds were not.
"""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from typing import Final, TypeVar

import numpy as np

from brink.guard.drives import check_problem, random_specs
from brink.guard.sight import Sight, sight_of
from brink.search.analysis.guard_drives import GuardedDrives, GuardWorth, guard_worth
from brink.search.space import BoolArray
from brink.server.problems.base import NamesRequirements
from brink.sim.catalogue import make_simulator
from brink.sim.episode import EpisodeSpec, Verdict
from brink.sim.guard.option import OPTION, GuardOption
from brink.sim.trace import Trace
from brink.worker.pool import process_pool, single_threaded

OnProgress = Callable[[str, int, int], None]
"""Called with the name of a part, its completed drives and their total."""

FIRST_SEED: Final = 9001
"""Campaigns usually have small seeds, so that these drives are fresh."""
MOST_LOST: Final = 0.05
"""Largest loss of mean distance that is acceptable for a condition to be recommended."""
_ODDS: Final = (0.25, 0.5, 1.0, 2.0, 4.0)
_CHUNK: Final = 4
_Result = TypeVar("_Result")


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """The outcome of a drive.

    Attributes:
        violated_at_s: Time of the first violation of each requirement that was violated.
        way_m: Distance along the route.
        time_s: Duration.
        alarms_s: When each alarm began; empty without a guard.
        intervention_s: How long the fallback intervened.
    """

    violated_at_s: Mapping[str, float]
    way_m: float
    time_s: float
    alarms_s: tuple[float, ...] = ()
    intervention_s: float = 0.0

    def violates(self, requirements: Sequence[str]) -> bool:
        """Return whether any of some requirements is violated."""
        return any(name in self.violated_at_s for name in requirements)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Condition:
    """Drives with a guard.

    Attributes:
        threshold: Probability from which it raises the alarm; None for its own.
        option: The guard and its fallback.
        outcomes: One for each drive.
    """

    threshold: float | None
    option: GuardOption
    outcomes: Sequence[Outcome]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GuardedLoop:
    """Drives without and with a guard.

    Attributes:
        requirements: Ids of the requirements that count.
        specs: The drives without the guard.
        seed: Seed of each drive's draw.
        without: Their outcomes.
        sights: What could have been known of each violation among them; None for the other drives.
        conditions: The same drives with the guard, in the order of the thresholds.
    """

    requirements: tuple[str, ...]
    specs: Sequence[EpisodeSpec]
    seed: Sequence[int]
    without: Sequence[Outcome]
    sights: Sequence[Sight | None]
    conditions: Sequence[Condition]

    def drives(self, condition: Condition) -> GuardedDrives:
        """Return the drives under a condition as arrays."""
        counted = self.requirements
        before, after = self.without, condition.outcomes
        others = [
            bool(set(now.violated_at_s) - set(then.violated_at_s) - set(counted))
            for then, now in zip(before, after, strict=True)
        ]
        return GuardedDrives(
            seed=np.array(self.seed, np.int64),
            violated_without=np.array([one.violates(counted) for one in before], bool),
            violated_with=np.array([one.violates(counted) for one in after], bool),
            other_with=np.array(others, bool),
            way_without_m=np.array([one.way_m for one in before]),
            way_with_m=np.array([one.way_m for one in after]),
            time_with_s=np.array([one.time_s for one in after]),
            alarms=np.array([len(one.alarms_s) for one in after], np.int64),
            intervention_s=np.array([one.intervention_s for one in after]),
        )

    def worth(self, condition: Condition, part: BoolArray | None = None) -> GuardWorth:
        """Return what the guard and its fallback did under a condition.

        Args:
            condition: The condition.
            part: Mask of the drives that count, shape ``(drives,)``; all by default.
        """
        drives = self.drives(condition)
        return guard_worth(drives if part is None else drives.of(part), np.random.default_rng(0))

    def recommended(self, most_lost: float = MOST_LOST) -> Condition:
        """Return the condition in which violations fall most while the mean distance falls by at most a share.

        Of several, that with the highest threshold, which has the fewest alarms. If the distance falls by more under
        every condition, that with the smallest loss.
        """
        worths = [(one, self.worth(one)) for one in self.conditions]
        within = [(one, worth) for one, worth in worths if (worth.distance_lost.value or 0.0) <= most_lost]
        if within:
            return max(within, key=lambda pair: (pair[1].reduction.value or 0.0, pair[0].threshold or 0.0))[0]
        return min(worths, key=lambda pair: pair[1].distance_lost.value or 0.0)[0]

    def prevented(self, condition: Condition) -> list[int]:
        """Return the numbers of the drives whose violation a guard prevents, those with a collision first.

        Drives that violate another requirement instead are left out.
        """
        found = [
            number
            for number, (before, after) in enumerate(zip(self.without, condition.outcomes, strict=True))
            if before.violates(self.requirements) and not after.violated_at_s
        ]
        return sorted(found, key=lambda number: (not _collides(self.without[number]), number))


def _collides(outcome: Outcome) -> bool:
    return any(name.startswith("no-collision@") for name in outcome.violated_at_s)


def drive_with_guard(
    problem: object,
    option: GuardOption,
    thresholds: Sequence[float | None],
    *,
    drives: int,
    seeds: Sequence[int],
    processes: int = 1,
    on_progress: OnProgress | None = None,
) -> GuardedLoop:
    """Run fresh drives of a problem without and with a guard.

    Args:
        problem: The problem.
        option: The guard and its fallback.
        thresholds: Thresholds of the alarm, each a condition; None is the guard's own.
        drives: Drives of each seed.
        seeds: Seeds of the draws, at least one.
        processes: Number of processes; 1 runs the drives in this process.
        on_progress: Progress callback.

    Raises:
        InvalidInput: The problem has no drives that a guard can watch.
        InvalidEpisode: The guard cannot run.
        SimulationCrashed: The physics engine failed.
    """
    simulated = check_problem(problem)
    assert isinstance(simulated, NamesRequirements), "urban problems name their requirements"
    requirements = simulated.requirements
    specs = [spec for seed in seeds for spec in random_specs(simulated, drives, seed)]
    with _Runs(processes, on_progress) as runs:
        without = runs.all("without a guard", run_drive, specs)
        violating = [index for index, one in enumerate(without) if one.violates(requirements)]
        sights: list[Sight | None] = [None] * len(specs)
        seen = runs.all("what was reported", _run_sight, [(specs[i], requirements) for i in violating])
        for index, sight in zip(violating, seen, strict=True):
            sights[index] = sight
        conditions = []
        for threshold in thresholds:
            own = replace(option, threshold=threshold)
            name = "with the guard" if threshold is None else f"threshold {threshold:.3g}"
            outcomes = runs.all(name, run_drive, [guarded_spec(spec, own) for spec in specs])
            conditions.append(Condition(threshold=threshold, option=own, outcomes=outcomes))
    return GuardedLoop(
        requirements=requirements,
        specs=specs,
        seed=[seed for seed in seeds for _ in range(drives)],
        without=without,
        sights=sights,
        conditions=conditions,
    )


def thresholds_around(own: float) -> tuple[float, ...]:
    """Return thresholds at a quarter to four times the odds of a guard's own one, which is among them."""
    odds = own / (1.0 - own)
    return tuple(factor * odds / (1.0 + factor * odds) for factor in _ODDS)


def guarded_spec(spec: EpisodeSpec, option: GuardOption) -> EpisodeSpec:
    """Return a drive with a guard."""
    return replace(spec, options={**spec.options, OPTION: option.to_json()})


def run_drive(spec: EpisodeSpec) -> Outcome:
    """Run a drive in this process and return its outcome."""
    result = make_simulator(spec.simulator).run(spec)
    features = result.features
    return Outcome(
        violated_at_s={name: _time(one) for name, one in result.verdicts.items() if one.violated},
        way_m=float(str(features["way_m"])),
        time_s=float(str(features["ended_at_s"])),
        alarms_s=tuple(_numbers(features.get("guard:alarms_s"))),
        intervention_s=float(str(features.get("guard:intervention_s", 0.0))),
    )


def record_drive_trace(spec: EpisodeSpec) -> Trace:
    """Run a drive in this process and return its trace."""
    result = make_simulator(spec.simulator).run(spec, record=True)
    assert result.trace is not None, "the trace was asked for"
    return Trace.from_bytes(result.trace)


def _run_sight(given: tuple[EpisodeSpec, tuple[str, ...]]) -> Sight | None:
    spec, requirements = given
    return sight_of(record_drive_trace(spec), requirements)


def _time(verdict: Verdict) -> float:
    return float("nan") if verdict.violated_at_s is None else verdict.violated_at_s


def _numbers(values: object) -> list[float]:
    return [float(value) for value in values] if isinstance(values, list) else []


class _Runs:
    """Runs functions of drives, in this process or in several.

    Args:
        processes: Number of processes.
        on_progress: Progress callback.
    """

    def __init__(self, processes: int, on_progress: OnProgress | None) -> None:
        self._processes = processes
        self._on_progress = on_progress
        self._pool: ProcessPoolExecutor | None = None

    def __enter__(self) -> "_Runs":
        if self._processes > 1:
            self._pool = process_pool(self._processes)
        return self

    def __exit__(self, *_: object) -> None:
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)

    def all(self, part: str, run: Callable[..., _Result], given: Sequence[object]) -> list[_Result]:
        """Return the results of a function for each of some arguments, in order."""
        results: list[_Result] = []
        with single_threaded():  # a pool starts its processes when they are first needed
            found = map(run, given) if self._pool is None else self._pool.map(run, given, chunksize=_CHUNK)
            for result in found:
                results.append(result)
                if self._on_progress is not None:
                    self._on_progress(part, len(results), len(given))
        return results
