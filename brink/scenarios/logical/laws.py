"""Operational distributions of parameters, as plain mappings that can be printed, stored and read without this code.

A law says how likely the values of a parameter are: ``kind``, the numbers of that kind, and the range ``min`` to
``max`` to which it is cut.

==============  ============================================================================================
kind            numbers
==============  ============================================================================================
``uniform``     none
``normal``      ``mean`` and ``sd``
``lognormal``   ``mean`` and ``sd`` of the value, not of its logarithm
``poisson``     ``mean``; only whole numbers
``histogram``   ``edges`` of the bins, ascending, and ``weights`` of the bins, one fewer
``weights``     ``weights`` by value, which add up to 1; no range
==============  ============================================================================================
"""

import math
from collections.abc import Mapping
from statistics import NormalDist
from typing import Any, TypeAlias

from brink.scenarios.logical.distributions import Variation

Law: TypeAlias = dict[str, Any]
_SIGMAS = 4.0
_TAIL = 1e-4


def law_of(variation: Variation, low: float, high: float) -> Law:
    """Return the law of a stochastic variation, cut to a range."""
    return {"kind": variation.kind, **variation.numbers, "min": low, "max": high}


def law_of_weights(weights: Mapping[str, float]) -> Law:
    """Return the law of values with weights."""
    total = math.fsum(weights.values())
    return {"kind": "weights", "weights": {value: weight / total for value, weight in weights.items()}}


def declared_law(law: Law) -> dict[str, Any] | None:
    """Return a law as the ``distribution`` of a campaign declares it; None for a uniform one, which is the default.

    A Poisson distribution becomes a histogram with a bin around each whole number.
    """
    match law["kind"]:
        case "uniform":
            return None
        case "normal":
            return {"normal": {"mean": law["mean"], "deviation": law["sd"]}}
        case "lognormal":
            log = _log_normal(law["mean"], law["sd"])
            return {"lognormal": {"median": math.exp(log.mean), "sigma": log.stdev}}
        case "poisson":
            counts = range(math.ceil(law["min"]), math.floor(law["max"]) + 1)
            edges = [counts[0] - 0.5, *(count + 0.5 for count in counts)]
            return {"histogram": {"edges": edges, "weights": [_poisson(law["mean"], one) for one in counts]}}
        case "histogram":
            return {"histogram": {"edges": list(law["edges"]), "weights": list(law["weights"])}}
    return {"weights": dict(law["weights"])}


def share_inside(variation: Variation, low: float, high: float) -> float:
    """Return the probability that an uncut variation gives to a range."""
    return _up_to(variation, high) - _up_to(variation, low, without=True)


def usual_range(variation: Variation) -> tuple[float, float]:
    """Return a range outside which an unbounded variation hardly ever has a value."""
    match variation.kind:
        case "normal":
            mean, sd = variation.numbers["mean"], variation.numbers["sd"]
            return mean - _SIGMAS * sd, mean + _SIGMAS * sd
        case "lognormal":
            log = _logarithm(variation)
            return math.exp(log.mean - _SIGMAS * log.stdev), math.exp(log.mean + _SIGMAS * log.stdev)
    mean = variation.numbers["mean"]
    return 0.0, math.ceil(mean + 2 * _SIGMAS + _SIGMAS * math.sqrt(mean))


def _logarithm(variation: Variation) -> NormalDist:
    return _log_normal(variation.numbers["mean"], variation.numbers["sd"])


def _poisson(mean: float, count: int) -> float:
    return math.exp(count * math.log(mean) - mean - math.lgamma(count + 1))


def _log_normal(mean: float, sd: float) -> NormalDist:
    """Return the distribution of the logarithm of a log-normal value."""
    variance = math.log1p((sd / mean) ** 2)
    return NormalDist(math.log(mean) - 0.5 * variance, math.sqrt(variance))


def _up_to(variation: Variation, value: float, *, without: bool = False) -> float:
    """Return the probability of values up to a given one, or below it."""
    numbers = variation.numbers
    match variation.kind:
        case "normal":
            return NormalDist(numbers["mean"], numbers["sd"]).cdf(value)
        case "lognormal":
            return _logarithm(variation).cdf(math.log(value)) if value > 0 else 0.0
        case "poisson":
            last = math.ceil(value) - 1 if without else math.floor(value)
            return math.fsum(_poisson(numbers["mean"], count) for count in range(last + 1))
        case "histogram":
            edges, weights = numbers["edges"], numbers["weights"]
            below = math.fsum(
                weight * min(max((value - first) / (end - first), 0.0), 1.0)
                for first, end, weight in zip(edges[:-1], edges[1:], weights, strict=True)
            )
            return below / math.fsum(weights)
    assert variation.low is not None
    assert variation.high is not None
    return min(max((value - variation.low) / (variation.high - variation.low), 0.0), 1.0)
