"""Whether the intervals of `rate@1` hold where the rate is known, and how many simulations they save.

Every repetition is a whole search against a function of six numbers. Its interval at every look misses the rate if
the bettors on either side of it ever become rich enough to exclude it. Plain Monte Carlo with as many simulations is
beside it. Finished searches are kept in a folder, so that a measurement goes on after an interruption.
"""

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks.measurement import Progress
from benchmarks.trials import code_fingerprint
from brink.search.algorithm import Candidate, Draws, Evaluation, Scored
from brink.search.algorithms.rate import Rate, RateConfig
from brink.search.analysis.rate import rate_of
from brink.search.conclusions import Decision
from brink.search.document import Document
from brink.search.rates import Terms, Wealth, betting_interval
from brink.search.sequential import exact_interval
from brink.search.space import Component, FloatArray, Real, SearchSpace
from brink.search.streams import generator
from brink.search.testing import play

RATES: Final = (0.1, 0.01, 0.001)
SHAPES: Final = ("smooth", "spiky", "half random")
AT_EVERY_LOOK, FIXED_NUMBER, NEVER_BELOW = 0.94, 0.93, 0.90
CODE: Final = ("search", "benchmarks/rate.py")
"""Files that decide what a search finds."""
_CHANCE, _SPIKES = 1_000, 8
_HOT, _COLD = 0.5, 0.2
"""Half random: half of what is in a corner is unsafe, and a fifth of all that is unsafe is elsewhere."""
SPACE: Final = SearchSpace((Component("x", tuple(Real(f"x{place}", 0.0, 1.0) for place in range(6))),))


def risk(shape: str, rate: float, row: FloatArray) -> float:
    """Return the probability that a solution is unsafe; its mean over the space is `rate`.

    Args:
        shape: One of `SHAPES`.
        rate: The rate, at most 0.1.
        row: The solution, shape ``(6,)``.
    """
    if shape == "smooth":  # a corner, cut along a curve: P(x0 x1 < t) = t (1 - log t)
        return float(row[0] * row[1] < _level(rate))
    if shape == "spiky":  # boxes in the first three numbers, one in each layer of the fourth
        layer = min(int(row[3] * _SPIKES), _SPIKES - 1)
        corner = generator(layer, _CHANCE).random(3) * 0.4
        return float((np.abs(row[:3] - corner - 0.3) < 0.5 * rate ** (1 / 3)).all())
    inside = rate * (1 - _COLD) / _HOT
    is_inside = row[0] < np.sqrt(inside) and row[1] < np.sqrt(inside)
    return _HOT if is_inside else rate * _COLD / (1 - inside)


def _level(rate: float) -> float:
    low, high = 0.0, 1.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if middle * (1 - np.log(middle)) < rate else (low, middle)
    return high


def _evaluate(shape: str, rate: float, seed: int, candidate: Candidate) -> Evaluation:
    chance = generator(seed, _CHANCE, candidate.number).random()
    unsafe = bool(chance < risk(shape, rate, candidate.vectors[0]))
    return Scored(unsafe=unsafe, robustness=-1.0 if unsafe else 1.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class RateCoverage:
    """How often intervals of one function held.

    Attributes:
        shape: The function.
        rate: Its rate.
        repetitions: Searches.
        sequence: Share of searches whose interval held at every look.
        fixed: Share whose interval for a fixed number held at the end.
        bias: Mean estimate less the rate, in standard errors of the mean.
        variance: Variance of plain Monte Carlo over that of the estimate.
        width: Mean width of the interval at every look over that of plain Monte Carlo.
        fixed_width: The same for intervals of a fixed number.
    """

    shape: str
    rate: float
    repetitions: int
    sequence: float
    fixed: float
    bias: float
    variance: float
    width: float
    fixed_width: float

    @property
    def met(self) -> bool:
        """Whether both intervals reach their targets, as far as this many repetitions tell."""
        ends = [
            exact_interval(round(share * self.repetitions), self.repetitions, 0.99)[1]
            for share in (self.sequence, self.fixed)
        ]
        return (
            ends[0] >= AT_EVERY_LOOK
            and ends[1] >= FIXED_NUMBER
            and min(self.sequence, self.fixed) >= NEVER_BELOW
        )


def measure(
    repetitions: int, budget: int, seed: int, report: Progress, folder: Path, rates: Sequence[float] = RATES
) -> Iterator[RateCoverage]:
    """Measure coverage and savings on every function.

    Args:
        repetitions: Searches on each function.
        budget: Simulations of a search, for the largest rate; ten times as many for the smallest.
        seed: Seed of the first search.
        report: Told of progress.
        folder: Where finished searches are kept, by the code that made them.
        rates: Some of `RATES`.
    """
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / f"searches-{code_fingerprint(CODE)}.jsonl"
    kept = {}
    for line in file.read_text().splitlines() if file.exists() else ():
        try:
            one = json.loads(line)
        except json.JSONDecodeError:  # the line that an interruption cut off
            continue
        kept[tuple(one["search"])] = one["found"]
    with file.open("a") as out:
        for shape in SHAPES:
            for rate in rates:
                runs = []
                for number in range(repetitions):
                    search = (shape, rate, seed + number, round(budget * (0.1 / rate) ** 0.5))
                    if search not in kept:
                        kept[search] = _run(*search)
                        print(json.dumps({"search": search, "found": kept[search]}), file=out, flush=True)
                    runs.append(kept[search])
                    report(f"{shape}, {rate:g}", number + 1, repetitions)
                yield _summary(shape, rate, np.array(runs))


def _run(shape: str, rate: float, seed: int, budget: int) -> list[float]:
    """Return of one search: whether both intervals held, the estimate, and widths beside those of Monte Carlo."""
    evaluate: Callable[[Candidate], Evaluation] = partial(_evaluate, shape, rate, seed)
    run = play(Rate(), SPACE, RateConfig(in_flight=2), evaluate, seed=seed, budget=budget)
    draws: Draws = Rate().draws(Document.from_bytes(run.documents[-1]), run.archive)
    found = rate_of(draws, 0.95)
    wealth = Wealth.of(rate, 0.975).after(draws.terms())
    unsafe = int(generator(seed, _CHANCE, 0, 1).binomial(budget, rate))
    plain = np.zeros(budget)
    plain[:unsafe] = 1.0
    widths = [
        found.interval[1] - found.interval[0],
        found.fixed[1] - found.fixed[0],
        float(-np.subtract(*betting_interval(Terms.of(plain, np.ones(budget))))),
        float(-np.subtract(*exact_interval(unsafe, budget, 0.95))),
    ]
    held = wealth.decided.decision is Decision.NOT_SHOWN
    return [float(held), float(found.fixed[0] <= rate <= found.fixed[1]), found.rate, budget, *widths]


def _summary(shape: str, rate: float, runs: FloatArray) -> RateCoverage:
    estimates, budget = runs[:, 2], float(runs[0, 3])
    variance = max(float(estimates.var(ddof=1)) if len(runs) > 1 else 0.0, 1e-18)
    return RateCoverage(
        shape=shape,
        rate=rate,
        repetitions=len(runs),
        sequence=float(runs[:, 0].mean()),
        fixed=float(runs[:, 1].mean()),
        bias=float((estimates.mean() - rate) / np.sqrt(variance / len(runs))),
        variance=rate * (1 - rate) / budget / variance,
        width=float(runs[:, 4].mean() / runs[:, 6].mean()),
        fixed_width=float(runs[:, 5].mean() / runs[:, 7].mean()),
    )
