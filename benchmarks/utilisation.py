"""Utilisation of workers by one campaign of each search: a model of its schedule, without a coordinator.

A search runs in this process. Nothing simulates its drives: a formula and chance decide their verdicts, and each
takes a log-normal time. Results are told in the order of asking, so which drives wait for which ones does not depend
on the workers, and one run of a search gives the utilisation of any number of them. Time that a coordinator and its
network take is not part of the model; `python -m benchmarks scale` measures it.
"""

import heapq
import math
import random
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from statistics import fmean
from typing import Any, Final

import numpy as np

from benchmarks.measurement import Progress, Row, at_least, counted, untargeted
from brink.search.algorithm import AnyAlgorithm, Candidate, Evaluation, KnowsFlight, Scored, ask_all
from brink.search.analysis.lines import find_lines
from brink.search.archive import Archive
from brink.search.space import Categorical, Component, Dormant, Real, SearchSpace
from brink.search.streams import Stream, generator
from brink.search.thresholds.estimation import FEWEST
from brink.server.problems.catalogue import make_algorithm

IDS: Final = ("edge@2", "edge@1", "random@1")
WORKERS: Final = (1, 8, 64)
BUDGETS: Final = (1_300, 5_200)
TARGET: Final = 0.9
"""Least utilisation by `edge@2`, with more candidates in flight for most workers."""
IN_FLIGHT: Final = 4
"""Candidates in flight for each worker that are modelled where the defaults have fewer."""
BATCH: Final = 20
"""Simulations along a unit at a time that are modelled with them, where a search has such a setting."""
SIGMA: Final = 0.5
"""Standard deviation of the logarithm of the duration of a drive, as in `benchmarks.scale`."""
TYPES: Final = ("none", "missed", "late", "shifted")
STRETCH: Final = 0.04
"""Severities from 20 to 80% unsafe."""


def _error(number: int) -> tuple[Categorical | Real, ...]:
    return (
        Categorical(f"error_{number}.type", TYPES),
        Real(f"error_{number}.severity", 0.0, 1.0, resolution=0.01),
        Real(f"error_{number}.onset", 0.0, 12.0, "s", resolution=0.1),
    )


SPACE: Final = SearchSpace(
    (
        Component(
            "scenario",
            (
                Categorical("weather", ("dry", "wet")),
                Real("speed", 5.0, 20.0, "m/s"),
                Real("gap", 5.0, 60.0, "m"),
            ),
        ),
        Component(
            "behaviour",
            (*_error(1), *_error(2)),
            tuple(
                Dormant(f"error_{n}.type", "none", (f"error_{n}.severity", f"error_{n}.onset"))
                for n in (1, 2)
            ),
            tuple(tuple(parameter.name for parameter in _error(n)) for n in (1, 2)),
        ),
    )
)
"""Drives with up to two errors of perception."""


def drive(candidate: Candidate) -> Scored:
    """Evaluate a drive: it is unsafe if an error is more severe than scenario, onset and chance allow.

    Along the severity, the probability of a violation is a logistic function with a stretch of `STRETCH`.
    """
    row = SPACE.join(candidate.vectors)
    number = candidate.number if candidate.seed_number is None else candidate.seed_number
    share = float(generator(0, Stream.CONTRACT, number).random())
    chance = STRETCH / (2 * math.log(4)) * math.log(share / (1 - share))
    least = 0.55 + 0.1 * float(row[0] == 0) + 0.25 * (row[2] - 30.0) / 55.0 - 0.2 * (row[1] - 10.0) / 15.0
    margins = [
        least + 0.1 * kind + 0.3 * abs(onset - 6.0) / 6.0 - severity + chance
        for kind, severity, onset in (row[3:6], row[6:9])
        if kind
    ]
    robustness = float(min(margins, default=1.0))
    return Scored(unsafe=robustness < 0, robustness=robustness)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Played:
    """A search that was run to its end.

    Attributes:
        asked: For each generation its size, and how many generations were told when it was asked for.
        lines: Lines whose curve can be estimated: with enough drives of a seed of their own, and both verdicts.
    """

    asked: tuple[tuple[int, int], ...]
    lines: int


def played(algorithm: AnyAlgorithm, settings: Mapping[str, Any], *, budget: int, seed: int) -> Played:
    """Run a search on `SPACE`.

    Args:
        algorithm: The algorithm.
        settings: Settings that differ from its defaults.
        budget: Number of simulations.
        seed: The campaign's seed.
    """
    config = algorithm.config_type(**settings)
    state: Any = algorithm.start(SPACE, config, seed=seed, budget=budget)
    asked: list[tuple[int, int]] = []
    shared: set[int] = set()
    while not algorithm.finished(state):
        state, generations = ask_all(algorithm, state)
        asked += [(len(candidates), state.generation) for candidates in generations]
        for one in state.pending:
            shared |= set() if one.seed_number in (None, one.number) else {one.number, one.seed_number}
        evaluations: dict[int, Evaluation] = {one.number: drive(one) for one in state.pending}
        state = algorithm.tell(state, evaluations)
    return Played(asked=tuple(asked), lines=_estimable(state.archive, shared))


def _estimable(archive: Archive, shared: set[int]) -> int:
    """Return the number of lines whose curve can be estimated.

    Args:
        archive: Simulated drives.
        shared: Numbers of those that share their seed with another one.
    """
    own = ~np.isin(archive.numbers, list(shared))
    lines = find_lines(archive, SPACE, own, fewest=FEWEST)
    return sum(len(set(line.unsafe[line.own].tolist())) == 2 for line in lines)


@dataclass(frozen=True, slots=True, kw_only=True)
class Utilisation:
    """Shares of their time that workers spend in drives.

    Attributes:
        granted: Until the last drive begins.
        whole: Until the last drive ends; towards the end there are fewer drives than workers.
    """

    granted: float
    whole: float


def utilisation(asked: Sequence[tuple[int, int]], workers: int, rng: random.Random) -> Utilisation:
    """Return the utilisation of workers by a search, older generations first.

    Args:
        asked: As in `Played`.
        workers: Number of workers.
        rng: Draws the duration of each drive: log-normal with mean 1, sigma `SIGMA`.
    """
    unfinished = [size for size, _ in asked]
    queue: deque[int] = deque()
    running: list[tuple[float, float, int]] = []
    spans: list[tuple[float, float]] = []
    now, told, queued = 0.0, 0, 0
    while told < len(asked):
        while queued < len(asked) and asked[queued][1] <= told:
            queue.extend([queued] * asked[queued][0])
            queued += 1
        while queue and len(running) < workers:
            end = now + rng.lognormvariate(-(SIGMA**2) / 2, SIGMA)
            heapq.heappush(running, (end, now, queue.popleft()))
            spans.append((now, end))
        now, _, generation = heapq.heappop(running)
        unfinished[generation] -= 1
        while told < len(asked) and not unfinished[told]:
            told += 1
    last = max(begun for begun, _ in spans)
    return Utilisation(
        granted=sum(min(end, last) - begun for begun, end in spans) / (workers * last) if last else 1.0,
        whole=sum(end - begun for begun, end in spans) / (workers * now),
    )


def model_searches(
    progress: Progress,
    *,
    ids: Sequence[str] = IDS,
    workers: Sequence[int] = WORKERS,
    budgets: Sequence[int] = BUDGETS,
    seeds: int = 2,
    repeats: int = 5,
) -> Iterator[Row]:
    """Model one campaign of each search with its defaults and, for most workers, with more candidates in flight.

    Args:
        progress: Progress callback.
        ids: Ids of the algorithms.
        workers: Numbers of workers.
        budgets: Simulations of a campaign.
        seeds: Campaigns of each kind; means are shown.
        repeats: Draws of the durations for each campaign.
    """
    cases = [
        (name, budget, settings)
        for budget in budgets
        for name in ids
        for settings in ({}, *_wide(make_algorithm(name), max(workers)))
    ]
    for place in counted(progress, "campaigns", len(cases)):
        name, budget, settings = cases[place]
        algorithm: AnyAlgorithm = make_algorithm(name)
        runs = [played(algorithm, settings, budget=budget, seed=seed) for seed in range(1, seeds + 1)]
        for count in workers:
            if settings and count < max(workers):
                continue
            drawn = [
                utilisation(run.asked, count, random.Random(number))
                for run in runs
                for number in range(repeats)
            ]
            share, whole = fmean(one.granted for one in drawn), fmean(one.whole for one in drawn)
            named = "".join(f", {key} {value}" for key, value in settings.items())
            what = f"used, {name}, {budget:,} simulations, {count} workers{named}"
            note = f"{whole:.3f} to the end of the last; {fmean(run.lines for run in runs):.1f} lines"
            has_target = name == IDS[0] and (bool(settings) or count < max(workers))
            yield at_least(what, share, TARGET, note) if has_target else untargeted(what, share, note)


def _wide(algorithm: AnyAlgorithm, workers: int) -> list[dict[str, int]]:
    """Return settings with `IN_FLIGHT` candidates in flight for each worker; none if the defaults have as many."""
    config = algorithm.config_type()
    if not isinstance(algorithm, KnowsFlight) or not hasattr(config, "in_flight"):
        return []
    size, generations = algorithm.flight(config)
    enough = math.ceil(IN_FLIGHT * workers / size)
    batch = {"batch": BATCH} if hasattr(config, "batch") else {}
    return [{"in_flight": enough, **batch}] if enough > generations else []
