"""Measures how difficult the urban problem is, and what decides its verdicts.

A simulator in which nothing matters, or only the scenario, or only chance, would make every search look good. Each
row holds a measurement, its value, its target, and whether the target is met.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from brink.bench.figures import Row
from brink.bench.trials import Trial, run_trials
from brink.bench.urban_candidates import (
    CATEGORICAL,
    PARAMETERS,
    Candidate,
    distance,
    draw_candidate,
    neighbour,
    redraw,
    with_behaviour,
    without_ghosts,
)
from brink.sim.episode import EpisodeSpec
from brink.sim.world.scenario import RoadCurve

FloatArray: TypeAlias = NDArray[np.float64]
Progress: TypeAlias = Callable[[str, int, int], None]
FRONT_GAP = "front-gap@1"
BEHAVIOURS_A_SCENARIO = 20
NEAR = 0.1
SIGNIFICANT = 0.05
MOVED_M = 0.05


@dataclass(frozen=True, slots=True, kw_only=True)
class Sizes:
    """Sample sizes.

    Attributes:
        candidates: Random candidates.
        scenarios: Random scenarios with `BEHAVIOURS_A_SCENARIO` behaviours each.
        reruns: Candidates run again with another seed.
        pairs: Pairs of neighbours.
        redraws: Changes of each categorical parameter, each with two seeds.
        number_redraws: Changes of each numeric parameter; most boxes are out of the ego's way, so it takes more.
        ends: Scenarios run with the oracle, and without any detection.
        permutations: Permutations in each test.
    """

    candidates: int = 2000
    scenarios: int = 100
    reruns: int = 1000
    pairs: int = 800
    redraws: int = 100
    number_redraws: int = 300
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
    """Measure the difficulty and yield row after row.

    Args:
        sizes: Sample sizes.
        seed: Seed of the candidates and their episodes.
        processes: Number of processes.
        requirement: Requirement that gives the verdict.
        progress: Called with the part, the episodes done and the total of that part.
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
    _candidates: list[Candidate] | None = None
    _trials: list[Trial] | None = None

    def _rng(self, part: int, index: int = 0) -> np.random.Generator:
        return np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(part, index)))

    def _spec(self, candidate: Candidate, episode: int, *, oracle: bool = False) -> EpisodeSpec:
        return candidate.spec(self.seed * 1_000_003 + episode, (self.requirement,), oracle=oracle)

    def _run(self, part: str, specs: Sequence[EpisodeSpec]) -> list[Trial]:
        trials = []
        for trial in run_trials(specs, processes=self.processes):
            trials.append(trial)
            if self.progress is not None:
                self.progress(part, len(trials), len(specs))
        return trials

    def _sample(self) -> tuple[list[Candidate], list[Trial]]:
        if self._candidates is None or self._trials is None:
            count = self.sizes.candidates
            self._candidates = [draw_candidate(self._rng(0, i)) for i in range(count)]
            specs = [self._spec(candidate, i) for i, candidate in enumerate(self._candidates)]
            self._trials = self._run("random candidates", specs)
        return self._candidates, self._trials

    def shares(self) -> Iterator[Row]:
        """Yield the unsafe share of random candidates, overall and for each road curve."""
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
        """Yield the share of scenarios in which the behaviour decides the verdict."""
        specs = []
        for index in range(self.sizes.scenarios):
            scenario = draw_candidate(self._rng(1, index))
            behaviours = self._rng(2, index)
            specs += [
                self._spec(with_behaviour(scenario, draw_candidate(behaviours)), 10_000_000 + index)
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
        """Yield how often another seed changes the verdict."""
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
        """Yield how much more often neighbours agree than random pairs."""
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
            what="verdict agreement of neighbours minus that of random pairs",
            value=near_share - far_share,
            target="at least 0.15",
            met=near_share - far_share >= 0.15,
            note=f"{near_share:.3f} in {len(again)} pairs {np.mean(apart):.3f} apart, {far_share:.3f} at random",
        )

    def ends(self) -> Iterator[Row]:
        """Yield the unsafe shares at both extremes: a perfect detector, and no detections."""
        scenarios = [draw_candidate(self._rng(4, i)) for i in range(self.sizes.ends)]
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
        """Return the effect of redrawing one parameter, with everything else and the seed unchanged."""
        rng = self._rng(5, PARAMETERS.index(name))
        specs: list[EpisodeSpec] = []
        count = self.sizes.redraws if name in CATEGORICAL else self.sizes.number_redraws
        for index in range(count):
            base = draw_candidate(rng)
            while name not in CATEGORICAL and base.is_null(int(name[0])):
                base = draw_candidate(rng)
            other = redraw(base, name, rng)
            for again in (0, 1):
                episode = 50_000_000 + 2 * index + again
                specs += [self._spec(base, episode), self._spec(other, episode)]
        trials = self._run(name, specs)
        robustness = np.array([trial.robustness for trial in trials]).reshape(-1, 2, 2)
        unsafe = np.array([trial.unsafe for trial in trials]).reshape(-1, 2)
        change = robustness[:, :, 1] - robustness[:, :, 0]
        p_value = consistent_effect_p(change, rng, self.sizes.permutations)
        moved, flipped = np.mean(np.abs(change) > MOVED_M), np.mean(unsafe[:, 0] != unsafe[:, 1])
        return Row(
            what=f"effect of {name}",
            value=float(np.mean(np.abs(change))),
            target=f"p below {SIGNIFICANT}",
            met=bool(p_value < SIGNIFICANT),
            note=f"m of robustness; p {p_value:.4f}; moves {moved:.2f}, flips {flipped:.3f} of {change.size} pairs",
        )


def consistent_effect_p(change: FloatArray, rng: np.random.Generator, permutations: int) -> float:
    """Return the p value of a permutation test for an effect beyond chance.

    A parameter may raise the outcome in one context and lower it in another, so its effects may cancel on average.
    Each change of value is therefore tried with two seeds. If the value does not matter, which of its two outcomes
    came from which value is arbitrary for each seed, so the signs of the two changes are independent; if it matters,
    they agree. The statistic is the sum of the products of both changes, as signed ranks so that a few large changes
    do not dominate.

    Args:
        change: Outcome with the new value minus that with the old one, for each seed, shape ``(n, 2)``.
        rng: Source of the permutations.
        permutations: Number of permutations.
    """
    magnitude = np.abs(change)
    ranks = np.searchsorted(np.sort(magnitude, axis=None), magnitude, side="right").astype(np.float64)
    products = np.prod(np.sign(change) * ranks, axis=1)
    found = float(products.sum())
    flips = rng.choice((-1.0, 1.0), size=(permutations, len(products)))
    as_large = int(np.sum(flips @ products >= found - 1e-9 * np.abs(products).sum()))
    return (1 + as_large) / (1 + permutations)


def _share(flags: Iterable[bool]) -> float:
    listed = list(flags)
    return sum(listed) / len(listed) if listed else float("nan")
