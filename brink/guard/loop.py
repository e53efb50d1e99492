"""The guard in the loop: the same fresh drives without a guard, and with one and its fallback at several thresholds.

Drives are independent draws of scenario, behaviour and chance, so they are the same under every condition until the
first intervention. Nothing of them was in any training data if their seeds were not.

A drive in which no alarm can occur at a threshold does not run with the guard: until the first alarm it is the drive
without it. The guard watches each drive once, with a fallback that does nothing, and says which threshold would still
have raised an alarm.

The recommended threshold is chosen on the first half of the seeds. What it is worth is reported on the second half,
which had no part in the choice.
"""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from typing import Any, Final, TypeVar

import numpy as np

from brink.guard.choices import LIMITS
from brink.guard.drives import check_problem, random_specs
from brink.guard.sight import Reported, Sight, sight_of
from brink.search.analysis.guard_drives import GuardedDrives, GuardWorth, guard_worth
from brink.search.analysis.intervals import CONFIDENCE
from brink.search.space import BoolArray
from brink.sim.catalogue import make_simulator
from brink.sim.episode import EpisodeSpec, Verdict
from brink.sim.guard.option import OPTION, GuardOption
from brink.sim.trace import Trace
from brink.worker.pool import process_pool, single_threaded

OnProgress = Callable[[str, int, int], None]
"""Called with the name of a part, its completed drives and their total."""

MOST_LOST: Final = 0.05
"""Largest loss of mean distance, in drives that are safe without the guard, with which a condition is recommended. A
prevented collision lets the car drive on, so a limit on the distance of all drives would hardly ever bind."""
_ODDS: Final = (1 / 64, 1 / 16, 0.25, 0.5, 1.0, 2.0, 4.0)
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
        peak: The highest threshold that would have raised an alarm; None without a guard, or if it does not say.
    """

    violated_at_s: Mapping[str, float]
    way_m: float
    time_s: float
    alarms_s: tuple[float, ...] = ()
    intervention_s: float = 0.0
    peak: float | None = None

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
        sights: The warning signs of each violation among them; None for the other drives.
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
            held_with=np.array([not one.violated_at_s for one in after], bool),
            way_without_m=np.array([one.way_m for one in before]),
            way_with_m=np.array([one.way_m for one in after]),
            time_with_s=np.array([one.time_s for one in after]),
            alarms=np.array([len(one.alarms_s) for one in after], np.int64),
            intervention_s=np.array([one.intervention_s for one in after]),
        )

    def worth(self, condition: Condition, part: BoolArray | None = None) -> GuardWorth:
        """Return the effect of the guard and its fallback under a condition.

        Args:
            condition: The condition.
            part: Mask of the drives that count, shape ``(drives,)``; all by default.
        """
        drives = self.drives(condition)
        return guard_worth(drives if part is None else drives.of(part))

    @property
    def chooses(self) -> BoolArray:
        """Mask of the drives on which a condition is chosen: those of the first half of the seeds."""
        seeds = np.array(self.seed, np.int64)
        return np.isin(seeds, np.unique(seeds)[: np.unique(seeds).size // 2])

    def recommended(self, most_lost: float = MOST_LOST) -> Condition | None:
        """Return the condition with the fewest violations that does not lose too much distance; None without one.

        It is chosen on the drives of `chooses`, so that the others can tell what it is worth. Of several, it is that
        with the highest threshold, which has the fewest alarms. There is none with a single seed.

        Args:
            most_lost: Largest loss of mean distance, in the drives that are safe without the guard.
        """
        chooses = self.chooses
        if not chooses.any():
            return None
        worths = [(one, self.worth(one, chooses)) for one in self.conditions]
        helpful = [
            (one, worth.reduction.value)
            for one, worth in worths
            if (worth.reduction.value or 0.0) > 0.0
            and (worth.distance_lost_when_safe.value or 0.0) <= most_lost
        ]
        if not helpful:
            return None
        return max(helpful, key=lambda pair: (pair[1], pair[0].threshold or 0.0))[0]

    def bounds(self, condition: Condition) -> bool:
        """Return whether a condition has the lowest or the highest threshold of those that were tried."""
        return condition is self.conditions[0] or condition is self.conditions[-1]

    def shown(self) -> tuple[Condition, BoolArray]:
        """Return the condition that is shown in detail, and a mask of the drives that count for it.

        It is the recommended one, on the drives that had no part in choosing it. Without one, it is the condition
        whose threshold is closest to the guard's own, on all drives.
        """
        best = self.recommended()
        if best is not None:
            return best, ~self.chooses
        own = self.conditions[0].option.own_threshold
        closest = min(self.conditions, key=lambda one: abs((one.threshold or own) - own))
        return closest, np.ones(len(self.specs), np.bool_)

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

    def by_report(self, condition: Condition, counts: BoolArray | None = None) -> list[dict[str, Any]]:
        """Group violations without the guard by what was reported before them, with how many are prevented.

        Args:
            condition: The condition.
            counts: Mask of the drives that count; all by default.
        """
        rows = []
        for reported in Reported:
            sights = {
                number: sight
                for number, sight in enumerate(self.sights)
                if sight is not None and sight.reported is reported and (counts is None or counts[number])
            }
            rows.append(
                {
                    "reported": str(reported),
                    "violations": len(sights),
                    "never_reported": sum(not sight.ever for sight in sights.values()),
                    "in_range": sum(sight.in_range for sight in sights.values()),
                    "prevented": sum(
                        not condition.outcomes[number].violates(self.requirements) for number in sights
                    ),
                }
            )
        return rows

    def by_requirement(self, condition: Condition) -> dict[str, dict[str, int]]:
        """Return how many drives violate each requirement, without and with the guard."""
        without = Counter(name for one in self.without for name in one.violated_at_s)
        with_guard = Counter(name for one in condition.outcomes for name in one.violated_at_s)
        names = self.specs[0].requirements
        return {name: {"without": without[name], "with": with_guard[name]} for name in names}

    def to_json(self, parts: Mapping[str, BoolArray]) -> dict[str, Any]:
        """Return all figures as a JSON object.

        The recommendation has the seeds on which its threshold was chosen, and its benefit on the others.

        Args:
            parts: Masks of drives for which the benefit is also given, by name.
        """
        best, seeds = self.recommended(), np.array(self.seed)
        return {
            "requirements": list(self.requirements),
            "drives": len(self.specs),
            "seeds": sorted(set(self.seed)),
            "confidence": CONFIDENCE,
            "conditions": [
                {
                    "threshold": one.threshold,
                    "worth": asdict(self.worth(one)),
                    "parts": {name: asdict(self.worth(one, mask)) for name, mask in parts.items()},
                    "by_requirement": self.by_requirement(one),
                    "violations_by_report": self.by_report(one),
                }
                for one in self.conditions
            ],
            "recommended": None
            if best is None
            else {
                "threshold": best.threshold,
                "most_lost_when_safe": MOST_LOST,
                "chosen_on": np.unique(seeds[self.chooses]).tolist(),
                "reported_on": np.unique(seeds[~self.chooses]).tolist(),
                "worth": asdict(self.worth(best, ~self.chooses)),
            },
        }


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
    requirements = simulated.requirements
    specs = [spec for seed in seeds for spec in random_specs(simulated, drives, seed)]
    with _Runs(processes, on_progress) as runs:
        watched = runs.all(
            "without a guard", run_drive, [guarded_spec(spec, option.watching()) for spec in specs]
        )
        without = [replace(one, alarms_s=(), intervention_s=0.0, peak=None) for one in watched]
        violating = [index for index, one in enumerate(without) if one.violates(requirements)]
        sights: list[Sight | None] = [None] * len(specs)
        seen = runs.all("what was reported", _run_sight, [(specs[i], requirements) for i in violating])
        for index, sight in zip(violating, seen, strict=True):
            sights[index] = sight
        conditions = []
        for threshold in thresholds:
            own = replace(option, threshold=threshold)
            name = "with the guard" if threshold is None else f"threshold {threshold:.3g}"
            alarmed = [place for place, one in enumerate(watched) if _may_differ(one, own)]
            ran = runs.all(name, run_drive, [guarded_spec(specs[place], own) for place in alarmed])
            outcomes = list(without)
            for place, outcome in zip(alarmed, ran, strict=True):
                outcomes[place] = replace(outcome, peak=None)
            conditions.append(Condition(threshold=threshold, option=own, outcomes=outcomes))
    return GuardedLoop(
        requirements=requirements,
        specs=specs,
        seed=[seed for seed in seeds for _ in range(drives)],
        without=without,
        sights=sights,
        conditions=conditions,
    )


def _may_differ(watched: Outcome, option: GuardOption) -> bool:
    """Return whether a drive may differ with a guard: it has an alarm, or the fallback does not wait for one."""
    if watched.peak is None or not option.waits_for_alarm:
        return True
    return watched.peak >= (option.own_threshold if option.threshold is None else option.threshold)


def thresholds_around(own: float) -> tuple[float, ...]:
    """Return thresholds at 1/64 to four times the odds of a guard's own one, which is among them.

    An own threshold outside `LIMITS` counts as the nearer one of them.
    """
    low, high = LIMITS
    own = min(max(own, low), high)
    odds = own / (1.0 - own)
    found = {min(max(factor * odds / (1.0 + factor * odds), low), high) for factor in _ODDS}
    return tuple(sorted(found))


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
        peak=float(str(features["guard:peak"])) if "guard:peak" in features else None,
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
