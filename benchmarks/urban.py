"""Difficulty and cost of the urban problem, and the random candidates on which both are measured.

A simulator in which nothing matters, or only the scenario, or only chance, would make every search look good. The
measurement shows that behaviour, scenario and chance all affect the verdict.

Candidates are drawn from the search space of `urban-injected@1`, as in campaigns: the 29 parameters of Sharifi et al.
2023.
"""

import math
import statistics
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeAlias

import numpy as np

from benchmarks.measurement import Progress, Row, at_least, at_most, silent, under, untargeted
from benchmarks.trials import mapped, process_memory_mb, run_record
from brink.search.metric import Metric
from brink.search.space import BoolArray, Categorical, FloatArray
from brink.server.problems.urban_injected import UrbanInjected, UrbanInjectedParams
from brink.sim.catalogue import make_requirements
from brink.sim.driving.camera import Camera
from brink.sim.driving.interface import ObstacleLabel
from brink.sim.driving.system import ModularDriving
from brink.sim.episode import EpisodeSpec
from brink.sim.urban.behaviour import BehaviourMode, DetectorBehaviour, InjectedTrajectory
from brink.sim.world.scenario import (
    SCENARIO_CHOICES,
    DrivingTask,
    RoadCurve,
    TimeOfDay,
    UrbanScenario,
    Weather,
)
from brink.sim.world.world import make_world

Candidate: TypeAlias = tuple[FloatArray, ...]
"""A scenario and a behaviour, in the problem's search space."""

PROBLEM = UrbanInjected(UrbanInjectedParams())
SPACE = PROBLEM.space
PARAMETERS = tuple(parameter for component in SPACE.components for parameter in component.parameters)
FRONT_GAP = "front-gap@1"
BEHAVIOURS_PER_SCENARIO = 20
NEIGHBOUR_DISTANCE = 0.1
SIGNIFICANCE_LEVEL = 0.05
MOVED_M = 0.05
"""Smallest change of robustness that counts as a change, in m."""


def draw_candidate(rng: np.random.Generator) -> Candidate:
    """Return a random candidate."""
    return SPACE.sample(rng)


def spec_of(candidate: Candidate, seed: int, *, oracle: bool = False) -> EpisodeSpec:
    """Return the episode of a candidate.

    Args:
        candidate: The candidate.
        seed: The episode's seed.
        oracle: Whether a perfect detector replaces the behaviour.
    """
    spec = PROBLEM.episode(candidate, seed)
    return replace(spec, behaviour={"mode": BehaviourMode.ORACLE.value}) if oracle else spec


def redraw(base: Candidate, place: int, rng: np.random.Generator) -> Candidate:
    """Return a candidate with one parameter redrawn and the others repaired; a category gets a different value.

    Args:
        base: The candidate to change.
        place: Position in `PARAMETERS`; not that of a dormant number.
        rng: Source of randomness.
    """
    row = SPACE.join(base).copy()
    before = row[place]
    while row[place] == before:
        row[place] = PARAMETERS[place].draw(rng)
    return SPACE.repair(SPACE.split(row), rng)


def neighbour(base: Candidate, rng: np.random.Generator, sigma: float = 0.04) -> Candidate:
    """Return a nearby candidate: all numbers are perturbed and, with probability 1/2, one category changes.

    Args:
        base: The candidate to change.
        rng: Source of randomness.
        sigma: Standard deviation of the perturbation, as a fraction of each range.
    """
    row = SPACE.join(base)
    scale = np.array([0.0 if isinstance(one, Categorical) else one.range for one in PARAMETERS])
    moves = np.where(SPACE.dormant(row), 0.0, rng.normal(0.0, sigma, len(row)) * scale)
    nearby = SPACE.repair(SPACE.split(row + moves), rng)
    return redraw(nearby, int(rng.integers(len(SCENARIO_CHOICES))), rng) if rng.random() < 0.5 else nearby


@dataclass(frozen=True, slots=True, kw_only=True)
class Sizes:
    """Sample sizes.

    Attributes:
        candidates: Random candidates.
        scenarios: Random scenarios with `BEHAVIOURS_PER_SCENARIO` behaviours each.
        reruns: Candidates that run again with another seed.
        pairs: Pairs of neighbours.
        redraws: Changes to each parameter, each with two seeds; many, because most boxes do not affect the ego, and
            pedestrians seldom affect the vehicle ahead.
        ends: Scenarios that run with a perfect detector, and without any detection.
        permutations: Permutations in each test.
    """

    candidates: int = 2000
    scenarios: int = 100
    reruns: int = 1000
    pairs: int = 800
    redraws: int = 300
    ends: int = 300
    permutations: int = 2000


def measure_difficulty(
    sizes: Sizes | None = None, *, seed: int = 0, processes: int = 2, progress: Progress = silent
) -> Iterator[Row]:
    """Measure the difficulty of the urban problem; yield each figure as soon as it is measured.

    Args:
        sizes: Sample sizes.
        seed: Seed of the candidates and their episodes.
        processes: Number of processes.
        progress: Progress callback.
    """
    difficulty = _Difficulty(sizes=sizes or Sizes(), seed=seed, processes=processes, progress=progress)
    yield from difficulty.unsafe_shares()
    yield difficulty.behaviour_matters()
    yield difficulty.chance_matters()
    yield difficulty.neighbours_agree()
    yield from difficulty.extremes()
    for place in range(len(PARAMETERS)):
        yield difficulty.effect(place)


@dataclass(kw_only=True)
class _Difficulty:
    sizes: Sizes
    seed: int
    processes: int
    progress: Progress

    def _rng(self, part: int, index: int = 0) -> np.random.Generator:
        return np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(part, index)))

    def _spec(self, candidate: Candidate, episode: int, *, oracle: bool = False) -> EpisodeSpec:
        return spec_of(candidate, self.seed * 1_000_003 + episode, oracle=oracle)

    def _run(self, part: str, specs: Sequence[EpisodeSpec]) -> FloatArray:
        """Return the robustness of episodes, shape ``(n,)``; negative if the requirement is violated."""
        records = mapped(
            run_record, specs, processes=self.processes, part=part, progress=self.progress, chunk=8
        )
        return np.array([record.robustness[FRONT_GAP] for record in records])

    @cached_property
    def _sample(self) -> tuple[list[Candidate], BoolArray]:
        """Random candidates, and which of them are unsafe."""
        candidates = [draw_candidate(self._rng(0, index)) for index in range(self.sizes.candidates)]
        specs = [self._spec(candidate, index) for index, candidate in enumerate(candidates)]
        return candidates, self._run("random candidates", specs) < 0

    def unsafe_shares(self) -> Iterator[Row]:
        """Yield the unsafe share of random candidates, overall and for each road curve."""
        candidates, unsafe = self._sample
        yield _between("unsafe share", _mean(unsafe), 0.30, 0.45, f"{len(unsafe)} random candidates")
        curves = np.array([SPACE.decode(candidate)["scenario"]["road_curve"] for candidate in candidates])
        for curve in RoadCurve:
            flags = unsafe[curves == curve.value]
            yield _between(
                f"unsafe share, {curve.value}", _mean(flags), 0.05, 0.95, f"{len(flags)} candidates"
            )

    def behaviour_matters(self) -> Row:
        """Return the share of scenarios whose verdict depends on the behaviour."""
        specs = []
        for index in range(self.sizes.scenarios):
            scenario = draw_candidate(self._rng(1, index))
            behaviours = self._rng(2, index)
            specs += [
                self._spec((scenario[0], draw_candidate(behaviours)[1]), 10_000_000 + index)
                for _ in range(BEHAVIOURS_PER_SCENARIO)
            ]
        unsafe = (self._run("behaviours", specs) < 0).reshape(-1, BEHAVIOURS_PER_SCENARIO).sum(axis=1)
        share = _mean((unsafe > 0) & (unsafe < BEHAVIOURS_PER_SCENARIO))
        note = f"{self.sizes.scenarios} scenarios, {BEHAVIOURS_PER_SCENARIO} behaviours each, same seed"
        return at_least("scenarios whose verdict depends on behaviour", share, 0.40, note)

    def chance_matters(self) -> Row:
        """Return the share of candidates whose verdict changes with the seed."""
        candidates, unsafe = self._sample
        count = min(self.sizes.reruns, len(candidates))
        specs = [self._spec(candidates[i], 20_000_000 + i) for i in range(count)]
        share = _mean(unsafe[:count] != (self._run("other seeds", specs) < 0))
        return _between("verdicts that another seed flips", share, 0.03, 0.15, f"{count} candidates")

    def neighbours_agree(self) -> Row:
        """Return how much more often neighbours have the same verdict than random pairs do."""
        candidates, verdicts = self._sample
        rng, metric = self._rng(3), Metric.of_space(SPACE)
        specs, bases, apart = [], [], []
        for index in range(min(self.sizes.pairs, len(candidates))):
            base = candidates[index]
            near = neighbour(base, rng)
            away = float(metric.between(SPACE.join(base)[None], SPACE.join(near)[None])[0, 0])
            if away <= NEIGHBOUR_DISTANCE:
                bases.append(index)
                apart.append(away)
                specs.append(self._spec(near, 30_000_000 + index))
        near_share = _mean(verdicts[bases] == (self._run("neighbours", specs) < 0))
        unsafe = _mean(verdicts)
        far_share = unsafe * unsafe + (1.0 - unsafe) * (1.0 - unsafe)
        return at_least(
            "verdict agreement of neighbours minus that of random pairs",
            near_share - far_share,
            0.15,
            f"{near_share:.3f} in {len(bases)} pairs {np.mean(apart):.3f} apart, {far_share:.3f} at random",
        )

    def extremes(self) -> Iterator[Row]:
        """Yield the unsafe shares with a perfect detector and without any detection."""
        scenarios = [draw_candidate(self._rng(4, i)) for i in range(self.sizes.ends)]
        oracle = [self._spec(s, 40_000_000 + i, oracle=True) for i, s in enumerate(scenarios)]
        share = _mean(self._run("oracle", oracle) < 0)
        note = f"{len(scenarios)} scenarios"
        yield under("unsafe share with a perfect detector", share, 0.05, note)
        blind = [replace(spec, behaviour={"mode": "injected", "trajectories": []}) for spec in oracle]
        share = _mean(self._run("no detections", blind) < 0)
        yield untargeted("unsafe share without any detection", share, note)

    def effect(self, place: int) -> Row:
        """Return the effect of redrawing one parameter while all others and the seed stay the same."""
        rng, name = self._rng(5, place), PARAMETERS[place].name
        specs: list[EpisodeSpec] = []
        for index in range(self.sizes.redraws):
            base = draw_candidate(rng)
            while SPACE.dormant(SPACE.join(base))[place]:
                base = draw_candidate(rng)
            other = redraw(base, place, rng)
            for again in (0, 1):
                episode = 50_000_000 + 2 * index + again
                specs += [self._spec(base, episode), self._spec(other, episode)]
        robustness = self._run(name, specs).reshape(-1, 2, 2)
        unsafe = robustness < 0
        change = robustness[:, :, 1] - robustness[:, :, 0]
        p_value = consistent_effect_p(change, rng, self.sizes.permutations)
        moved, flipped = np.mean(np.abs(change) > MOVED_M), np.mean(unsafe[:, :, 0] != unsafe[:, :, 1])
        return Row(
            what=f"effect of {name}",
            value=float(np.mean(np.abs(change))),
            target=f"p below {SIGNIFICANCE_LEVEL}",
            met=bool(p_value < SIGNIFICANCE_LEVEL),
            note=f"m of robustness; p {p_value:.4f}; moves {moved:.2f}, flips {flipped:.3f} of {change.size} pairs",
        )


def consistent_effect_p(change: FloatArray, rng: np.random.Generator, permutations: int) -> float:
    """Return the p-value of a permutation test for an effect beyond chance.

    A parameter may raise the outcome in one context and lower it in another, so its effects may cancel on average.
    Each change of value is therefore tried with two seeds. If the parameter has no effect, the signs of the two
    changes are independent; if it has one, they tend to agree. The statistic is the sum of the products of the two
    changes. It uses signed ranks, so that a few large changes do not dominate.

    Args:
        change: Outcome with the new value minus that with the old one, shape ``(n, 2)``, a column for each seed.
        rng: Source of the permutations.
        permutations: Number of permutations.

    Returns:
        The one-sided p-value, in (0, 1].
    """
    magnitude = np.abs(change)
    ranks = np.searchsorted(np.sort(magnitude, axis=None), magnitude, side="right").astype(np.float64)
    products = np.prod(np.sign(change) * ranks, axis=1)
    found = float(products.sum())
    flips = rng.choice((-1.0, 1.0), size=(permutations, len(products)))
    as_large = int(np.sum(flips @ products >= found - 1e-9 * np.abs(products).sum()))
    return (1 + as_large) / (1 + permutations)


def _between(what: str, value: float, low: float, high: float, note: str) -> Row:
    return Row(what=what, value=value, target=f"{low:.2f} to {high:.2f}", met=low <= value <= high, note=note)


def _mean(flags: BoolArray) -> float:
    return float(flags.mean()) if len(flags) else math.nan


_BUSY = UrbanScenario(
    time_of_day=TimeOfDay.SUNSET,
    weather=Weather.WET,
    pedestrians=18,
    road_curve=RoadCurve.CROSSROAD,
    road_id=1,
    road_length=2,
    driving_task=DrivingTask.SECOND_EXIT,
)
_GHOSTS = (
    InjectedTrajectory(
        label=ObstacleLabel.VEHICLE,
        t0_step=10.0,
        t1_step=300.0,
        first_px=(330.0, 470.0, 250.0, 400.0),
        last_px=(320.0, 480.0, 240.0, 410.0),
    ),
    InjectedTrajectory(
        label=ObstacleLabel.PERSON,
        t0_step=0.0,
        t1_step=290.0,
        first_px=(20.0, 80.0, 250.0, 420.0),
        last_px=(60.0, 120.0, 240.0, 400.0),
    ),
)


def measure_costs(*, repeats: int = 15, episodes: int = 2000) -> Iterator[Row]:
    """Measure the CPU time of episodes and the memory of a process; yield each cost as soon as it is measured.

    Args:
        repeats: Episodes of each kind, whose median is taken.
        episodes: Episodes in the process whose memory is measured.
    """
    injected = DetectorBehaviour(mode=BehaviourMode.INJECTED, trajectories=_GHOSTS)
    oracle = DetectorBehaviour(mode=BehaviourMode.ORACLE)
    few = replace(_BUSY, pedestrians=8)
    yield _episode_cost("ms of 30 s, injected, 8 vehicles, 8 pedestrians", few, injected, repeats, 60.0)
    yield _episode_cost("ms of 30 s, injected, 8 vehicles, 18 pedestrians", _BUSY, injected, repeats, 100.0)
    yield _episode_cost("ms of 30 s, ground truth, 8 vehicles, 18 pedestrians", _BUSY, oracle, repeats, None)
    specs = [spec_of(draw_candidate(np.random.default_rng(index)), index) for index in range(episodes)]
    first_mb, last_mb = process_memory_mb(specs)
    yield at_most("MB of a process after 20 episodes", first_mb, 70.0)
    yield at_most(f"MB of growth over {episodes} episodes", last_mb - first_mb, 2.0)


def _episode_cost(
    what: str, scenario: UrbanScenario, behaviour: DetectorBehaviour, repeats: int, most_ms: float | None
) -> Row:
    times_ms = [episode_cpu_s(scenario, behaviour) * 1e3 for _ in range(repeats + 2)][2:]
    return at_most(what, statistics.median(times_ms), most_ms)


def episode_cpu_s(scenario: UrbanScenario, behaviour: DetectorBehaviour) -> float:
    """Return the CPU time of an episode that lasts the full 30 s, even after a collision or at the goal."""
    from brink.sim.bullet.engine import process_engine
    from brink.sim.urban.episode_loop import run_loop

    engine = process_engine()
    camera = Camera()
    before_s = time.process_time()
    engine.reset()
    world = make_world(scenario, 5)
    run_loop(
        world,
        ModularDriving(world.route, camera=camera),
        behaviour,
        make_requirements((FRONT_GAP,)),
        engine=engine,
        camera=camera,
        seed=5,
        duration_s=30.0,
        recorder=None,
        to_the_end=True,
    )
    return time.process_time() - before_s
