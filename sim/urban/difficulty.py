"""Owns the measurement of how hard the urban problem is, and of what decides its verdicts.

A simulator in which nothing matters, or only the scenario, or only chance, would make every search look good. Each
row gives what was measured, its value, the target, and whether it is met.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from sim.episode import EpisodeSpec
from sim.urban.draws import (
    PARAMETERS,
    Draw,
    Value,
    distance,
    draw,
    neighbour,
    redraw,
    with_behaviour,
    without_ghosts,
)
from sim.urban.scenario import SCENARIO_CHOICES, RoadCurve
from sim.urban.trials import Trial, run_trials

Progress: TypeAlias = Callable[[str, int, int], None]
FRONT_GAP = "front-gap@1"
BEHAVIOURS_A_SCENARIO = 20
NEAR = 0.1
SIGNIFICANT = 0.05
MOVED_M = 0.05
_BINS = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One measured figure.

    Attributes:
        what: What was measured.
        value: The figure.
        target: What it should be, in words; empty if there is no target.
        met: Whether it is; None if there is no target.
        note: Sample sizes and further figures.
    """

    what: str
    value: float
    target: str
    met: bool | None
    note: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Sizes:
    """How much to run.

    Attributes:
        candidates: Random candidates.
        scenarios: Random scenarios with `BEHAVIOURS_A_SCENARIO` behaviours each.
        reruns: Candidates run again with another seed.
        pairs: Pairs of neighbours.
        redraws: Pairs for each parameter.
        ends: Scenarios run with the oracle, and without any detection.
        permutations: Of each test.
    """

    candidates: int = 2000
    scenarios: int = 100
    reruns: int = 1000
    pairs: int = 800
    redraws: int = 300
    ends: int = 300
    permutations: int = 2000


def measure(
    sizes: Sizes | None = None,
    *,
    seed: int = 0,
    processes: int = 2,
    requirement: str = FRONT_GAP,
    progress: Progress | None = None,
) -> Iterator[Row]:
    """Measure and yield row after row.

    Args:
        sizes: How much to run.
        seed: Decides the candidates and their episodes.
        processes: In how many processes.
        requirement: Whose verdict counts.
        progress: Is told the part, episodes done and episodes in that part.
    """
    bench = _Bench(
        sizes=sizes or Sizes(), seed=seed, processes=processes, requirement=requirement, progress=progress
    )
    yield from bench.shares()
    yield from bench.behaviour_matters()
    yield from bench.chance_matters()
    yield from bench.neighbours_agree()
    yield from bench.ends()
    for name in PARAMETERS:
        yield bench.effect(name)


@dataclass(slots=True, kw_only=True)
class _Bench:
    sizes: Sizes
    seed: int
    processes: int
    requirement: str
    progress: Progress | None
    _candidates: list[Draw] | None = None
    _trials: list[Trial] | None = None

    def _rng(self, part: int, index: int = 0) -> np.random.Generator:
        return np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(part, index)))

    def _spec(self, candidate: Draw, episode: int, *, oracle: bool = False) -> EpisodeSpec:
        return candidate.spec(self.seed * 1_000_003 + episode, (self.requirement,), oracle=oracle)

    def _run(self, part: str, specs: Sequence[EpisodeSpec]) -> list[Trial]:
        trials = []
        for trial in run_trials(specs, processes=self.processes):
            trials.append(trial)
            if self.progress is not None:
                self.progress(part, len(trials), len(specs))
        return trials

    def _sample(self) -> tuple[list[Draw], list[Trial]]:
        if self._candidates is None or self._trials is None:
            count = self.sizes.candidates
            self._candidates = [draw(self._rng(0, i)) for i in range(count)]
            specs = [self._spec(candidate, i) for i, candidate in enumerate(self._candidates)]
            self._trials = self._run("random candidates", specs)
        return self._candidates, self._trials

    def shares(self) -> Iterator[Row]:
        """How many random candidates are unsafe, in all and for each road curve."""
        candidates, trials = self._sample()
        share = _share(trial.unsafe for trial in trials)
        yield Row(
            what="unsafe share",
            value=share,
            target="0.30 to 0.45",
            met=0.30 <= share <= 0.45,
            note=f"{len(trials)} random candidates",
        )
        for curve in RoadCurve:
            flags = [
                t.unsafe for c, t in zip(candidates, trials, strict=True) if c.values["road_curve"] == curve
            ]
            share = _share(flags)
            yield Row(
                what=f"unsafe share, {curve.value}",
                value=share,
                target="0.05 to 0.95",
                met=0.05 <= share <= 0.95,
                note=f"{len(flags)} candidates",
            )

    def behaviour_matters(self) -> Iterator[Row]:
        """In how many scenarios the behaviour decides the verdict."""
        specs = []
        for index in range(self.sizes.scenarios):
            scenario = draw(self._rng(1, index))
            behaviours = self._rng(2, index)
            specs += [
                self._spec(with_behaviour(scenario, draw(behaviours)), 10_000_000 + index)
                for _ in range(BEHAVIOURS_A_SCENARIO)
            ]
        trials = self._run("behaviours", specs)
        unsafe = np.array([trial.unsafe for trial in trials]).reshape(-1, BEHAVIOURS_A_SCENARIO).sum(axis=1)
        share = float(np.mean((unsafe > 0) & (unsafe < BEHAVIOURS_A_SCENARIO)))
        yield Row(
            what="scenarios whose verdict depends on behaviour",
            value=share,
            target="at least 0.40",
            met=share >= 0.40,
            note=f"{self.sizes.scenarios} scenarios, {BEHAVIOURS_A_SCENARIO} behaviours each, same seed",
        )

    def chance_matters(self) -> Iterator[Row]:
        """How often another seed changes the verdict."""
        candidates, trials = self._sample()
        count = min(self.sizes.reruns, len(candidates))
        specs = [self._spec(candidates[i], 20_000_000 + i) for i in range(count)]
        again = self._run("other seeds", specs)
        share = _share(a.unsafe != b.unsafe for a, b in zip(trials, again, strict=False))
        yield Row(
            what="verdicts that another seed flips",
            value=share,
            target="0.03 to 0.15",
            met=0.03 <= share <= 0.15,
            note=f"{count} candidates",
        )

    def neighbours_agree(self) -> Iterator[Row]:
        """Whether neighbours agree more than strangers."""
        candidates, trials = self._sample()
        rng = self._rng(3)
        specs, bases, apart = [], [], []
        for index in range(min(self.sizes.pairs, len(candidates))):
            base = candidates[index]
            near = neighbour(base, rng)
            away = distance(base, near)
            if away <= NEAR:
                bases.append(index)
                apart.append(away)
                specs.append(self._spec(near, 30_000_000 + index))
        again = self._run("neighbours", specs)
        near_share = _share(trials[i].unsafe == t.unsafe for i, t in zip(bases, again, strict=True))
        unsafe = _share(trial.unsafe for trial in trials)
        far_share = unsafe * unsafe + (1.0 - unsafe) * (1.0 - unsafe)
        yield Row(
            what="verdict agreement of neighbours, less that of strangers",
            value=near_share - far_share,
            target="at least 0.15",
            met=near_share - far_share >= 0.15,
            note=f"{near_share:.3f} in {len(again)} pairs {np.mean(apart):.3f} apart, {far_share:.3f} at random",
        )

    def ends(self) -> Iterator[Row]:
        """The two ends: a perfect detector, and none."""
        scenarios = [draw(self._rng(4, i)) for i in range(self.sizes.ends)]
        oracle = [self._spec(s, 40_000_000 + i, oracle=True) for i, s in enumerate(scenarios)]
        share = _share(trial.unsafe for trial in self._run("oracle", oracle))
        yield Row(
            what="unsafe share with a perfect detector",
            value=share,
            target="under 0.05",
            met=share < 0.05,
            note=f"{len(scenarios)} scenarios",
        )
        blind = [self._spec(without_ghosts(s), 40_000_000 + i) for i, s in enumerate(scenarios)]
        share = _share(trial.unsafe for trial in self._run("no detections", blind))
        yield Row(
            what="unsafe share without any detection",
            value=share,
            target="",
            met=None,
            note=f"{len(scenarios)} scenarios",
        )

    def effect(self, name: str) -> Row:
        """What redrawing one parameter does, everything else and the seed being the same."""
        rng = self._rng(5, PARAMETERS.index(name))
        specs: list[EpisodeSpec] = []
        values: list[tuple[Value, Value]] = []
        while len(values) < self.sizes.redraws:
            base = draw(rng)
            if name not in SCENARIO_CHOICES and not name.endswith("label") and base.is_null(int(name[0])):
                continue
            other = redraw(base, name, rng)
            episode = 50_000_000 + len(values)
            specs += [self._spec(base, episode), self._spec(other, episode)]
            values.append((base.values[name], other.values[name]))
        trials = self._run(name, specs)
        robustness = np.array([trial.robustness for trial in trials]).reshape(-1, 2)
        unsafe = np.array([trial.unsafe for trial in trials]).reshape(-1, 2)
        change = robustness[:, 1] - robustness[:, 0]
        p_value = main_effect_p(values, change, rng, self.sizes.permutations)
        moved, flipped = np.mean(np.abs(change) > MOVED_M), np.mean(unsafe[:, 0] != unsafe[:, 1])
        return Row(
            what=f"effect of {name}",
            value=float(np.mean(np.abs(change))),
            target=f"p below {SIGNIFICANT}",
            met=bool(p_value < SIGNIFICANT),
            note=f"m of robustness; p {p_value:.4f}; moves {moved:.2f}, flips {flipped:.3f} of {len(values)} pairs",
        )


def main_effect_p(
    values: Sequence[tuple[Value, Value]],
    change: NDArray[np.float64],
    rng: np.random.Generator,
    permutations: int,
) -> float:
    """Return the p value of a permutation test for an effect of a parameter's value on an outcome.

    Without an effect, which of a pair's two values gave which outcome is arbitrary, so swapping them (the sign of
    the change) leaves the distribution as it is. The statistic is the sum over levels of the squared net change
    towards that level, divided by the number of pairs that take part; numbers are first cut into quartiles.

    Args:
        values: The parameter's value before and after, one pair an entry.
        change: Outcome after less outcome before, shape ``(n,)``. Ranks are taken, so that outliers do not rule.
        rng: Where the permutations come from.
        permutations: How many.
    """
    before, after = _levels(values)
    magnitude = np.abs(change)
    ranks = np.searchsorted(np.sort(magnitude), magnitude, side="right") * (magnitude > 0)
    signed = np.sign(change) * ranks.astype(np.float64)
    levels = int(max(before.max(), after.max())) + 1
    towards = (after[:, None] == np.arange(levels)).astype(float) - (before[:, None] == np.arange(levels))
    weight = np.maximum(np.abs(towards).sum(axis=0), 1.0)

    def statistic(outcome: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(((outcome @ towards) ** 2 / weight).sum(axis=-1))

    found = float(statistic(signed))
    flips = rng.choice((-1.0, 1.0), size=(permutations, len(signed)))
    as_large = int(np.sum(statistic(flips * signed) >= found * (1.0 - 1e-12)))
    return (1 + as_large) / (1 + permutations)


def _levels(values: Sequence[tuple[Value, Value]]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    if all(isinstance(value, float) for pair in values for value in pair):
        numbers = np.array(values, dtype=np.float64)
        cuts = np.quantile(numbers, np.linspace(0.0, 1.0, _BINS + 1)[1:-1])
        binned = np.searchsorted(cuts, numbers)
        return binned[:, 0], binned[:, 1]
    known = sorted({str(value) for pair in values for value in pair})
    indices = np.array([[known.index(str(value)) for value in pair] for pair in values], dtype=np.int64)
    return indices[:, 0], indices[:, 1]


def _share(flags: "Iterator[bool] | Sequence[bool]") -> float:
    listed = list(flags)
    return sum(listed) / len(listed) if listed else float("nan")
