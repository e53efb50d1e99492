"""Random candidates of the urban problem as plain values: draws, redraws, small mutations, distance.

The 29 parameters, their ranges and their repair are those of Sharifi et al. 2023. This module serves measurements of
the simulator; a campaign draws its candidates from the search space of its problem.
"""

import math
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

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
    last_perception_step,
    trajectory_ranges,
)
from brink.sim.world.scenario import SCENARIO_CHOICES

Value: TypeAlias = "str | int | float"
SIMULATOR_ID = "brink-drive@1"
LAST_STEP = float(last_perception_step(DEFAULT_DURATION_S))
CATEGORICAL = (*SCENARIO_CHOICES, *(f"{ghost}.label" for ghost in range(TRAJECTORY_COUNT)))
NUMERIC = tuple(f"{ghost}.{field}" for ghost in range(TRAJECTORY_COUNT) for field in TRAJECTORY_FIELDS[1:])
PARAMETERS = (
    *SCENARIO_CHOICES,
    *(f"{ghost}.{field}" for ghost in range(TRAJECTORY_COUNT) for field in TRAJECTORY_FIELDS),
)
"""All parameters: those of the scenario by name, those of the behaviour as ``<trajectory>.<field>``."""

_RANGES = trajectory_ranges()


@dataclass(frozen=True, slots=True, kw_only=True)
class Candidate:
    """A complete solution.

    Attributes:
        values: Value of each of `PARAMETERS`, by name.
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
            oracle: Whether to replace the behaviour by the ground truth.
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
    """Return an independent draw of all parameters."""
    values: dict[str, Value] = {}
    for name in SCENARIO_CHOICES:
        values[name] = _choice(name, rng)
    for ghost in range(TRAJECTORY_COUNT):
        values[f"{ghost}.label"] = TRAJECTORY_LABELS[int(rng.integers(len(TRAJECTORY_LABELS)))]
        _fill(values, ghost, rng)
    return Candidate(values=values)


def with_behaviour(scenario: Candidate, behaviour: Candidate) -> Candidate:
    """Return the scenario of one candidate with the behaviour of another."""
    kept = {name: scenario.values[name] for name in SCENARIO_CHOICES}
    return Candidate(values={**behaviour.values, **kept})


def without_ghosts(scenario: Candidate) -> Candidate:
    """Return a candidate whose detector reports nothing."""
    values = dict(scenario.values)
    for ghost in range(TRAJECTORY_COUNT):
        values[f"{ghost}.label"] = NULL_LABEL
        for field in TRAJECTORY_FIELDS[1:]:
            values[f"{ghost}.{field}"] = 0.0
    return Candidate(values=values)


def redraw(base: Candidate, name: str, rng: np.random.Generator) -> Candidate:
    """Return a candidate that differs in one parameter, and in whatever its repair changes.

    A categorical parameter gets a different value. A trajectory that is no longer null gets new numbers.

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
    """Return a nearby candidate: every number moves a little, and half the time one category changes.

    Args:
        base: The candidate to change.
        rng: Source of randomness.
        sigma: Standard deviation of the move, as a share of each range.
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
    """Return the distance of two candidates, in [0, 1]; section III of the paper."""
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
    """Draw the ten numbers of a trajectory; all are 0 if it is null."""
    is_null = values[f"{ghost}.label"] == NULL_LABEL
    for field, (low, high, _) in _RANGES.items():
        drawn = float(rng.uniform(low, high))
        values[f"{ghost}.{field}"] = 0.0 if is_null else drawn
    if not is_null:
        _repair(values, ghost)


def _repair(values: dict[str, Value], ghost: int) -> None:
    """Repair a trajectory in place by the rules of the paper's encoding."""
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
