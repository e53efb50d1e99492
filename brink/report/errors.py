"""The errors of a recorded detector in words, and drives with them compared with other drives."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import yaml

from brink.api.results import FetchedArchive
from brink.search.analysis.intervals import CONFIDENCE, replicated_interval
from brink.server.errors import Conflict
from brink.server.problems.base import SimulatedProblem
from brink.server.problems.catalogue import is_baseline
from brink.sim.urban.error_process import EDGES_M, FOUND_FIRST, GROUPS, LABELS, LOST, SEEN, FittedErrors

HEADER: Final = """\
# The errors of an obstacle detector, fitted to a recording by `brink errors fit`; driven by urban-fitted@1.
#
# By group of road users (lead: the nearest vehicle in the ego's lane) and distance, for images every 0.1 s:
#   seen                      share of images in which a visible road user is reported
#   at_once, found_first      probability that it is reported in the first image in sight, and then in each other one
#   found_in_0.2s, _1s, later probability per image of being found again, 0.2 s, 1 s or longer after it was lost
#   lost_in_0.2s, _1s, later  probability per image of being lost, 0.2 s, 1 s or longer after it was found
#   wrong_label               share of detections with the wrong label
#   far, right_m, size        errors of distance (share), to the right (m), of size (share):
#                             quantiles at 2, 16, 50, 84 and 98%
#   samples                   images that each of the ten probabilities rests on (at_once: sightings), in this order
#   kept                      correlation of errors from image to image, but for a share of their variance that is
#                             constant for a road user; probability that a wrong label stays
# ghosts: those in the ego's lane, begun in an hour, and quantiles of their durations in s.
# replicates: the same numbers, fitted to the drives with random weights. Each simulated drive draws one. Without
# replicates (`replicates: []`), the numbers above are driven; so that is how to drive numbers of your own.
"""
_BOUNDS: Final = (0.05, 0.95)
_LONGEST_S: Final = 60.0


def errors_yaml(fitted: FittedErrors) -> str:
    """Return the content of `errors.yaml`."""
    return HEADER + _dump(fitted.to_document())


def campaign_yaml(fitted: FittedErrors, simulations: int, seed: int) -> str:
    """Return a campaign file for drives with the errors."""
    document = {
        "name": f"fitted-{fitted.detector}"[:200],
        "problem": {"id": "urban-fitted@1", "params": {"errors": fitted.to_document()}},
        "algorithm": {"id": "random@1"},
        "budget": {"simulations": simulations},
        "seed": seed,
    }
    return (
        f"# {simulations:,} drives with the recorded errors of {fitted.detector}: brink run FILE\n"
        + _dump(document)
    )


def _dump(document: Any) -> str:
    return yaml.safe_dump(document, sort_keys=False, default_flow_style=None, width=10**6, allow_unicode=True)


def error_rows(fitted: FittedErrors) -> list[tuple[str, ...]]:
    """Return a row for each group and bin of distance with images, with the detector's behaviour there."""
    rows: list[tuple[str, ...]] = []
    process, rests_on = fitted.process, fitted.rests_on
    lasts_s = process.mean_miss_s()
    seen = np.array([one.shares[:, :, SEEN] for one in fitted.replicates or (process,)])
    low, high = np.quantile(seen, _BOUNDS, axis=0)
    for g, group in enumerate(GROUPS):
        for i, distance in enumerate(_distances()):
            images = int(rests_on[g, i, SEEN])
            if not images:
                continue
            shares, at_risk = process.shares[g, i], rests_on[g, i]
            lost, at = shares[LOST : LOST + 3], at_risk[LOST : LOST + 3]
            per_minute = 600.0 * float(lost @ at) / at.sum() if at.any() else math.nan
            delay_s = 0.1 * (1.0 - shares[1]) / shares[FOUND_FIRST] if shares[FOUND_FIRST] else math.inf
            rows.append(
                (
                    group,
                    distance,
                    f"{images:,}",
                    f"{shares[SEEN]:.1%}",
                    f"{low[g, i]:.0%} to {high[g, i]:.0%}",
                    _number(per_minute),
                    _number(lasts_s[g, i] if per_minute > 0.0 else math.nan, " s"),
                    _number(delay_s if at_risk[1] else math.nan, " s"),
                    f"{process.errors[g, i, 0, 2]:+.0%} ({_spread(process.errors[g, i, 0]):.0%})",
                    f"{process.errors[g, i, 1, 2]:+.2f} ({_spread(process.errors[g, i, 1]):.2f}) m",
                )
            )
    return rows


COLUMNS: Final = (
    "road user",
    "distance",
    "images",
    "reported",
    "90% range",
    "lost per min",
    "for",
    "first report after",
    "too far (spread)",
    "to the right",
)


def _spread(quantiles: Any) -> float:
    return 0.5 * float(quantiles[3] - quantiles[1])


def _number(value: float, unit: str = "") -> str:
    if math.isnan(value):
        return "–"
    return f"{value:.1f}{unit}" if not unit or value <= _LONGEST_S else f"over {_LONGEST_S:g}{unit}"


def _distances() -> Iterable[str]:
    for low, high in zip(EDGES_M, (*EDGES_M[1:], math.inf), strict=True):
        yield f"from {low:g} m" if math.isinf(high) else f"{low:g} to {high:g} m"


def error_sentences(fitted: FittedErrors) -> list[str]:
    """Return the sentences that complement the table."""
    lines = []
    for i, label in enumerate(LABELS):
        per_hour, *quantiles = fitted.process.ghosts[i].tolist()
        if fitted.ghosts[i]:
            lines.append(
                f"Ghosts in the ego's lane, as a {label.value}: {fitted.ghosts[i]:,} in {fitted.hours:.2f} h, "
                f"{per_hour:.0f} an hour, for {quantiles[2]:.1f} s (median; 98% end within {quantiles[-1]:.1f} s)."
            )
        else:
            lines.append(
                f"No ghost in the ego's lane, as a {label.value}, in {fitted.hours:.2f} h: with 95% confidence fewer "
                f"than {3.0 / max(fitted.hours, 1e-9):.0f} an hour. The drives have none."
            )
    lines += [
        f"No {group} in the recording: the drives report these correctly, and say nothing about the detector "
        "for them."
        for group in fitted.unknown
    ]
    if fitted.without:
        lines.append(f"Left out: {', '.join(fitted.without)}.")
    return lines


@dataclass(frozen=True, slots=True, kw_only=True)
class Violations:
    """How many drives of a campaign violate.

    Attributes:
        campaign: Its id.
        name: Its name.
        problem: Id of its problem.
        unsafe: Drives that violate.
        drives: All drives that ended with a verdict.
        replicates: Replicates of a fit that were driven; 1 of a model that is not uncertain.
        low: Lower end of the interval.
        high: Upper end of the interval.
    """

    campaign: str
    name: str
    problem: str
    unsafe: int
    drives: int
    replicates: int
    low: float
    high: float

    @property
    def share(self) -> float:
        """Share of drives that violate."""
        return self.unsafe / self.drives

    @property
    def words(self) -> str:
        """The share with its interval."""
        return f"{self.share:.2%} [{self.low:.2%}, {self.high:.2%}]"


def violations_of(fetched: FetchedArchive) -> Violations:
    """Return how many drives of a campaign violate.

    Raises:
        Conflict: It has no drives, or they were not drawn at random.
    """
    archive, body = fetched.archive, fetched.body
    if not len(archive):
        raise Conflict(f"campaign {fetched.id} has no drives yet")
    if not is_baseline(body.algorithm.id):
        raise Conflict(
            f"campaign {fetched.id}: expected drives drawn at random (random@1), got {body.algorithm.id}, which "
            "looks for violations"
        )
    problem = fetched.plan.problem
    numbers = np.zeros(len(archive), np.int64)
    if isinstance(problem, SimulatedProblem) and fetched.seeds is not None:
        numbers = np.array([problem.replicate(seed) for seed in fetched.seeds.tolist()])
    of = np.bincount(numbers)
    counts = np.bincount(numbers, archive.unsafe).round().astype(np.int64)
    low, high = replicated_interval(counts, of, CONFIDENCE)
    return Violations(
        campaign=fetched.id,
        name=body.name,
        problem=body.problem.id,
        unsafe=int(archive.unsafe.sum()),
        drives=len(archive),
        replicates=int((of > 0).sum()),
        low=low,
        high=high,
    )


def agreement_words(one: Violations, other: Violations) -> str:
    """State whether two shares agree: whether the interval of their difference contains 0.

    References:
        Newcombe 1998, method 10 (an interval of a difference from those of two shares).
    """
    apart = one.share - other.share
    low = apart - math.hypot(one.share - one.low, other.high - other.share)
    high = apart + math.hypot(one.high - one.share, other.share - other.low)
    points = (
        f"{100.0 * apart:+.2f} points, {CONFIDENCE:.0%} interval {100.0 * low:+.2f} to {100.0 * high:+.2f}"
    )
    if low <= 0.0 <= high:
        return f"The two agree as far as these drives show: their difference is {points}."
    more, less = (one, other) if apart > 0.0 else (other, one)
    return f"The two differ: drives of {more.name} violate more often than those of {less.name} ({points})."
