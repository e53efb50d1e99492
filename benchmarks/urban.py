"""Difficulty and cost of the urban problem, and the random candidates on which both are measured.

A simulator in which nothing matters, or only the scenario, or only chance, would make every search look good. The
measurement shows that behaviour, scenario and chance all affect the verdict.

A candidate holds plain values of the 29 parameters of Sharifi et al. 2023, repaired as in the authors' code.
Campaigns draw candidates from the problem's search space instead; the tests check that both agree.
"""

import json
import math
import resource
import statistics
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeAlias

import numpy as np

from benchmarks.lifeline import start_tied
from benchmarks.measurement import Progress, Row, at_least, memory_mib, under
from benchmarks.trials import Trial, run_trial, run_trials
from brink.search.space import FloatArray
from brink.sim.catalogue import make_requirements
from brink.sim.driving.camera import Camera
from brink.sim.driving.interface import ObstacleLabel
from brink.sim.driving.system import ModularDriving
from brink.sim.episode import EpisodeSpec, Json, JsonObject
from brink.sim.urban.behaviour import (
    BOX_FIELDS,
    DEFAULT_DURATION_S,
    IMAGE_HEIGHT_PX,
    IMAGE_WIDTH_PX,
    MIN_BOX_PX,
    MIN_DURATION_SHARE,
    NULL_LABEL,
    TRAJECTORY_COUNT,
    TRAJECTORY_FIELDS,
    TRAJECTORY_LABELS,
    BehaviourMode,
    DetectorBehaviour,
    InjectedTrajectory,
    last_perception_step,
    trajectory_ranges,
)
from brink.sim.world.scenario import (
    SCENARIO_CHOICES,
    DrivingTask,
    RoadCurve,
    TimeOfDay,
    UrbanScenario,
    Weather,
)
from brink.sim.world.world import make_world
from brink.worker.pool import single_threaded

Value: TypeAlias = "str | int | float"
SIMULATOR_ID = "brink-drive@2"
LAST_STEP = float(last_perception_step(DEFAULT_DURATION_S))
CATEGORICAL = (*SCENARIO_CHOICES, *(f"{ghost}.label" for ghost in range(TRAJECTORY_COUNT)))
NUMERIC = tuple(f"{ghost}.{field}" for ghost in range(TRAJECTORY_COUNT) for field in TRAJECTORY_FIELDS[1:])
PARAMETERS = (
    *SCENARIO_CHOICES,
    *(f"{ghost}.{field}" for ghost in range(TRAJECTORY_COUNT) for field in TRAJECTORY_FIELDS),
)
"""All parameters: those of the scenario by name, those of the behaviour as ``<trajectory>.<field>``."""
FRONT_GAP = "front-gap@1"
BEHAVIOURS_PER_SCENARIO = 20
NEIGHBOUR_DISTANCE = 0.1
SIGNIFICANCE_LEVEL = 0.05
MOVED_M = 0.05
"""Smallest change of robustness that counts as a change, in m."""

_RANGES = trajectory_ranges()


@dataclass(frozen=True, slots=True, kw_only=True)
class Candidate:
    """A complete solution.

    Attributes:
        values: Values of `PARAMETERS`, by name.
    """

    values: dict[str, Value]

    def is_null(self, ghost: int) -> bool:
        """Return whether a trajectory is null."""
        return self.values[f"{ghost}.label"] == NULL_LABEL

    def spec(self, seed: int, requirements: tuple[str, ...], *, oracle: bool = False) -> EpisodeSpec:
        """Return the episode of this candidate.

        Args:
            seed: The episode's seed.
            requirements: Requirements to evaluate.
            oracle: Whether a perfect detector replaces the behaviour.
        """
        scenario: JsonObject = {name: self.values[name] for name in SCENARIO_CHOICES}
        trajectories: list[Json] = [
            {field: self.values[f"{ghost}.{field}"] for field in TRAJECTORY_FIELDS}
            for ghost in range(TRAJECTORY_COUNT)
        ]
        behaviour: JsonObject = {"mode": "injected", "trajectories": trajectories}
        return EpisodeSpec(
            simulator=SIMULATOR_ID,
            scenario=scenario,
            behaviour={"mode": "oracle"} if oracle else behaviour,
            requirements=requirements,
            seed=seed,
            duration_s=DEFAULT_DURATION_S,
        )


def draw_candidate(rng: np.random.Generator) -> Candidate:
    """Return a candidate with independently drawn parameters."""
    values: dict[str, Value] = {}
    for name in SCENARIO_CHOICES:
        values[name] = _choice(name, rng)
    for ghost in range(TRAJECTORY_COUNT):
        values[f"{ghost}.label"] = TRAJECTORY_LABELS[int(rng.integers(len(TRAJECTORY_LABELS)))]
        _fill(values, ghost, rng)
    return Candidate(values=values)


def with_behaviour(scenario: Candidate, behaviour: Candidate) -> Candidate:
    """Return a candidate with the scenario of one candidate and the behaviour of another."""
    kept = {name: scenario.values[name] for name in SCENARIO_CHOICES}
    return Candidate(values={**behaviour.values, **kept})


def without_ghosts(scenario: Candidate) -> Candidate:
    """Return a candidate with the given scenario and a detector that reports nothing."""
    values = dict(scenario.values)
    for ghost in range(TRAJECTORY_COUNT):
        values[f"{ghost}.label"] = NULL_LABEL
        for field in TRAJECTORY_FIELDS[1:]:
            values[f"{ghost}.{field}"] = 0.0
    return Candidate(values=values)


def redraw(base: Candidate, name: str, rng: np.random.Generator) -> Candidate:
    """Return a candidate with one parameter redrawn and its trajectory repaired.

    A categorical parameter gets a different value. A trajectory that was null gets new numbers.

    Args:
        base: The candidate to change.
        name: One of `PARAMETERS`.
        rng: Source of randomness.
    """
    values = dict(base.values)
    if name in SCENARIO_CHOICES:
        while values[name] == base.values[name]:
            values[name] = _choice(name, rng)
        return Candidate(values=values)
    ghost, field = int(name.split(".")[0]), name.split(".")[1]
    if field == "label":
        others = [label for label in TRAJECTORY_LABELS if label != values[name]]
        values[name] = others[int(rng.integers(len(others)))]
        if base.is_null(ghost) or values[name] == NULL_LABEL:
            _fill(values, ghost, rng)
        return Candidate(values=values)
    low, high, _ = _RANGES[field]
    values[name] = float(rng.uniform(low, high))
    _repair(values, ghost)
    return Candidate(values=values)


def neighbour(base: Candidate, rng: np.random.Generator, sigma: float = 0.04) -> Candidate:
    """Return a nearby candidate: all numbers are perturbed and, with probability 1/2, one category changes.

    Args:
        base: The candidate to change.
        rng: Source of randomness.
        sigma: Standard deviation of the perturbation, as a fraction of each range.
    """
    values = dict(base.values)
    for ghost in range(TRAJECTORY_COUNT):
        if base.is_null(ghost):
            continue
        for field, (low, high, _) in _RANGES.items():
            name = f"{ghost}.{field}"
            moved = float(values[name]) + float(rng.normal(0.0, sigma)) * (high - low)
            values[name] = min(max(moved, low), high)
        _repair(values, ghost)
    nearby = Candidate(values=values)
    if rng.random() < 0.5:
        names = tuple(SCENARIO_CHOICES)
        nearby = redraw(nearby, names[int(rng.integers(len(names)))], rng)
    return nearby


def distance(one: Candidate, other: Candidate) -> float:
    """Return the distance between two candidates, in [0, 1] (Sharifi et al. 2023)."""
    numeric = 0.0
    for name in NUMERIC:
        low, high, _ = _RANGES[name.split(".")[1]]
        numeric += abs(float(one.values[name]) - float(other.values[name])) / (high - low)
    differing = sum(one.values[name] != other.values[name] for name in CATEGORICAL)
    return 0.5 * (numeric / len(NUMERIC) + differing / len(CATEGORICAL))


def _choice(name: str, rng: np.random.Generator) -> Value:
    choices = SCENARIO_CHOICES[name]
    return choices[int(rng.integers(len(choices)))]


def _fill(values: dict[str, Value], ghost: int, rng: np.random.Generator) -> None:
    """Draw the ten numbers of a trajectory in place; all are 0 if it is null."""
    is_null = values[f"{ghost}.label"] == NULL_LABEL
    for field, (low, high, _) in _RANGES.items():
        drawn = float(rng.uniform(low, high))
        values[f"{ghost}.{field}"] = 0.0 if is_null else drawn
    if not is_null:
        _repair(values, ghost)


def _repair(values: dict[str, Value], ghost: int) -> None:
    """Repair a trajectory in place by the rules of the problem's constraints."""
    names = (f"{ghost}.t0_step", f"{ghost}.t1_step")
    first, last = sorted(float(round(float(values[name]))) for name in names)
    least = float(math.ceil(MIN_DURATION_SHARE * LAST_STEP))
    values[names[0]], values[names[1]] = _apart(first, last, least, LAST_STEP)
    for names in zip(BOX_FIELDS[::2], BOX_FIELDS[1::2], strict=True):
        size = float(IMAGE_WIDTH_PX if names[0].startswith("x") else IMAGE_HEIGHT_PX)
        low, high = (float(values[f"{ghost}.{name}"]) for name in names)
        if high < low:
            high = low + MIN_BOX_PX
        low, high = _apart(max(low, 0.0), min(high, size), MIN_BOX_PX, size)
        values[f"{ghost}.{names[0]}"], values[f"{ghost}.{names[1]}"] = low, high


def _apart(low: float, high: float, least: float, size: float) -> tuple[float, float]:
    if high - low >= least:
        return low, high
    return (low, low + least) if low + least <= size else (high - least, high)


@dataclass(frozen=True, slots=True, kw_only=True)
class Sizes:
    """Sample sizes.

    Attributes:
        candidates: Random candidates.
        scenarios: Random scenarios with `BEHAVIOURS_PER_SCENARIO` behaviours each.
        reruns: Candidates that run again with another seed.
        pairs: Pairs of neighbours.
        redraws: Changes to each categorical parameter, each with two seeds.
        number_redraws: Changes to each numeric parameter; more, because most boxes do not affect the ego.
        ends: Scenarios that run with a perfect detector, and without any detection.
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


def measure_difficulty(
    sizes: Sizes | None = None, *, seed: int = 0, processes: int = 2, progress: Progress | None = None
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
    for name in PARAMETERS:
        yield difficulty.effect(name)


@dataclass(slots=True, kw_only=True)
class _Difficulty:
    sizes: Sizes
    seed: int
    processes: int
    progress: Progress | None
    _candidates: list[Candidate] | None = None
    _trials: list[Trial] | None = None

    def _rng(self, part: int, index: int = 0) -> np.random.Generator:
        return np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(part, index)))

    def _spec(self, candidate: Candidate, episode: int, *, oracle: bool = False) -> EpisodeSpec:
        return candidate.spec(self.seed * 1_000_003 + episode, (FRONT_GAP,), oracle=oracle)

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

    def unsafe_shares(self) -> Iterator[Row]:
        """Yield the unsafe share of random candidates, overall and for each road curve."""
        candidates, trials = self._sample()
        share = _share(trial.unsafe for trial in trials)
        yield _between("unsafe share", share, 0.30, 0.45, f"{len(trials)} random candidates")
        for curve in RoadCurve:
            flags = [
                t.unsafe for c, t in zip(candidates, trials, strict=True) if c.values["road_curve"] == curve
            ]
            yield _between(
                f"unsafe share, {curve.value}", _share(flags), 0.05, 0.95, f"{len(flags)} candidates"
            )

    def behaviour_matters(self) -> Row:
        """Return the share of scenarios whose verdict depends on the behaviour."""
        specs = []
        for index in range(self.sizes.scenarios):
            scenario = draw_candidate(self._rng(1, index))
            behaviours = self._rng(2, index)
            specs += [
                self._spec(with_behaviour(scenario, draw_candidate(behaviours)), 10_000_000 + index)
                for _ in range(BEHAVIOURS_PER_SCENARIO)
            ]
        trials = self._run("behaviours", specs)
        unsafe = np.array([trial.unsafe for trial in trials]).reshape(-1, BEHAVIOURS_PER_SCENARIO).sum(axis=1)
        share = float(np.mean((unsafe > 0) & (unsafe < BEHAVIOURS_PER_SCENARIO)))
        note = f"{self.sizes.scenarios} scenarios, {BEHAVIOURS_PER_SCENARIO} behaviours each, same seed"
        return at_least("scenarios whose verdict depends on behaviour", share, 0.40, note)

    def chance_matters(self) -> Row:
        """Return the share of candidates whose verdict changes with the seed."""
        candidates, trials = self._sample()
        count = min(self.sizes.reruns, len(candidates))
        specs = [self._spec(candidates[i], 20_000_000 + i) for i in range(count)]
        again = self._run("other seeds", specs)
        share = _share(a.unsafe != b.unsafe for a, b in zip(trials, again, strict=False))
        return _between("verdicts that another seed flips", share, 0.03, 0.15, f"{count} candidates")

    def neighbours_agree(self) -> Row:
        """Return how much more often neighbours have the same verdict than random pairs do."""
        candidates, trials = self._sample()
        rng = self._rng(3)
        specs, bases, apart = [], [], []
        for index in range(min(self.sizes.pairs, len(candidates))):
            base = candidates[index]
            near = neighbour(base, rng)
            away = distance(base, near)
            if away <= NEIGHBOUR_DISTANCE:
                bases.append(index)
                apart.append(away)
                specs.append(self._spec(near, 30_000_000 + index))
        again = self._run("neighbours", specs)
        near_share = _share(trials[i].unsafe == t.unsafe for i, t in zip(bases, again, strict=True))
        unsafe = _share(trial.unsafe for trial in trials)
        far_share = unsafe * unsafe + (1.0 - unsafe) * (1.0 - unsafe)
        return at_least(
            "verdict agreement of neighbours minus that of random pairs",
            near_share - far_share,
            0.15,
            f"{near_share:.3f} in {len(again)} pairs {np.mean(apart):.3f} apart, {far_share:.3f} at random",
        )

    def extremes(self) -> Iterator[Row]:
        """Yield the unsafe shares with a perfect detector and without any detection."""
        scenarios = [draw_candidate(self._rng(4, i)) for i in range(self.sizes.ends)]
        oracle = [self._spec(s, 40_000_000 + i, oracle=True) for i, s in enumerate(scenarios)]
        share = _share(trial.unsafe for trial in self._run("oracle", oracle))
        note = f"{len(scenarios)} scenarios"
        yield under("unsafe share with a perfect detector", share, 0.05, note)
        blind = [self._spec(without_ghosts(s), 40_000_000 + i) for i, s in enumerate(scenarios)]
        share = _share(trial.unsafe for trial in self._run("no detections", blind))
        yield Row(what="unsafe share without any detection", value=share, target="", met=None, note=note)

    def effect(self, name: str) -> Row:
        """Return the effect of redrawing one parameter while all others and the seed stay the same."""
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


def _share(flags: Iterable[bool]) -> float:
    listed = list(flags)
    return sum(listed) / len(listed) if listed else float("nan")


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


@dataclass(frozen=True, slots=True, kw_only=True)
class Cost:
    """A measured time or amount of memory, and its target.

    Attributes:
        what: Name of the cost.
        value: Measured value.
        unit: ``ms`` or ``MB``.
        most: Largest value that meets the target, or None.
    """

    what: str
    value: float
    unit: str
    most: float | None

    @property
    def met(self) -> bool | None:
        """Whether the target is met; None without a target."""
        return None if self.most is None else self.value <= self.most


def measure_costs(*, repeats: int = 15, episodes: int = 2000) -> Iterator[Cost]:
    """Measure the CPU time of episodes and the memory of a process; yield each cost as soon as it is measured.

    Args:
        repeats: Episodes of each kind, whose median is taken.
        episodes: Episodes in the process whose memory is measured.
    """
    injected = DetectorBehaviour(mode=BehaviourMode.INJECTED, trajectories=_GHOSTS)
    oracle = DetectorBehaviour(mode=BehaviourMode.ORACLE)
    few = replace(_BUSY, pedestrians=8)
    yield _episode_cost("30 s, injected, 8 vehicles, 8 pedestrians", few, injected, repeats, 60.0)
    yield _episode_cost("30 s, injected, 8 vehicles, 18 pedestrians", _BUSY, injected, repeats, 100.0)
    yield _episode_cost("30 s, ground truth, 8 vehicles, 18 pedestrians", _BUSY, oracle, repeats, None)
    first_mb, last_mb = process_memory_mb(episodes)
    yield Cost(what="process after 20 episodes", value=first_mb, unit="MB", most=70.0)
    yield Cost(what=f"growth over {episodes} episodes", value=last_mb - first_mb, unit="MB", most=2.0)


def _episode_cost(
    what: str, scenario: UrbanScenario, behaviour: DetectorBehaviour, repeats: int, most_ms: float | None
) -> Cost:
    times_ms = [episode_cpu_s(scenario, behaviour) * 1e3 for _ in range(repeats + 2)][2:]
    return Cost(what=what, value=statistics.median(times_ms), unit="ms", most=most_ms)


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


def process_memory_mb(episodes: int, settle: int = 20) -> tuple[float, float]:
    """Return the memory of a fresh process after its first random episodes, and after all of them.

    Args:
        episodes: Number of episodes.
        settle: Number of episodes before the first value.
    """
    # A new interpreter, because a spawned process would import the main module of this one.
    command = [sys.executable, "-m", "benchmarks.urban", str(episodes), str(settle)]
    with single_threaded():
        process = start_tied(command, stdout=subprocess.PIPE)
        answer, _ = process.communicate()
    if process.returncode:
        raise subprocess.CalledProcessError(process.returncode, command)
    first_mb, last_mb = json.loads(answer.splitlines()[-1])
    return first_mb, last_mb


def _memory_after(episodes: int, settle: int) -> tuple[float, float]:
    first_mb = 0.0
    for index in range(episodes):
        run_trial(draw_candidate(np.random.default_rng(index)).spec(index, (FRONT_GAP,)))
        if index + 1 == settle:
            first_mb = resident_mb()
    return first_mb, resident_mb()


def resident_mb() -> float:
    """Return the resident memory of this process, or its peak where there is no ``/proc``."""
    if Path("/proc/self/status").exists():
        return memory_mib("self")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 1e6 if sys.platform == "darwin" else peak / 1024.0


if __name__ == "__main__":
    sys.stdout.write(json.dumps(_memory_after(int(sys.argv[1]), int(sys.argv[2]))) + "\n")
