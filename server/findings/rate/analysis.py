"""The rate of a campaign: its draws from operation, and what these say."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Final

import numpy as np

from brink.search.algorithm import Draws, EstimatesRate
from brink.search.analysis.rate import (
    Claim,
    Ratio,
    claim_of,
    looks,
    rate_of,
    ratio_of,
    replicated_rate,
    strata_of,
)
from brink.search.conclusions import Decision
from brink.search.deadline import check_time
from brink.search.distribution import distribution_words
from brink.search.document import Document
from brink.search.space import BoolArray, Categorical, FloatArray, SearchSpace
from brink.server.campaigns import step_store, view_store
from brink.server.campaigns.plan import Plan, restored_archive
from brink.server.db.engine import Engines
from brink.server.errors import InvalidInput
from brink.server.findings.rate.views import ClaimView, IntervalView, LookView, RateView, StratumView
from brink.server.findings.words import percent, rounded

DISTANCE: Final = "way_m"
"""Feature of a drive: the distance driven."""
TIME: Final = "ended_at_s"
"""Feature of a drive: the simulated time."""
REPLICATE: Final = "replicate"
"""Feature of a drive with fitted errors: the replicate of the fit that it drew."""
_KM_1000: Final = 1e6
_HOUR: Final = 3600.0
MOST_STRATA: Final = 60


def find_rate(
    engines: Engines,
    plan: Plan,
    campaign_id: str,
    *,
    claim: tuple[float, float] | None,
    confidence: float,
    by: str,
) -> RateView | None:
    """Return the rate of a campaign; None before the first generation.

    Args:
        engines: The database.
        plan: The campaign's plan; its algorithm estimates a rate.
        campaign_id: The campaign.
        claim: Limit and confidence of the claim; None for none.
        confidence: Confidence of intervals.
        by: Categories to stratify by, separated by commas; those joined by ``+`` are crossed.

    Raises:
        InvalidInput: `by` names no category.
    """
    problem, algorithm = plan.problem, plan.algorithm
    assert isinstance(algorithm, EstimatesRate)
    with engines.reader.connect() as connection:  # one snapshot
        checkpoint = step_store.find_checkpoint(connection, campaign_id)
        if checkpoint is None:
            return None
        archive = restored_archive(
            plan, step_store.read_archive(connection, campaign_id, problem.space.dimension)
        )
        draws = algorithm.draws(Document.from_bytes(checkpoint.document), archive)
        results = view_store.read_results(connection, campaign_id)
    if not len(draws.numbers):
        return None
    distance_m, time_s, replicates = _features(draws, results, (DISTANCE, TIME, REPLICATE))
    place = {number: row for row, number in enumerate(archive.numbers.tolist())}
    places = np.array([place.get(number, -1) for number in draws.numbers.tolist()], np.int64)
    rows = np.where((places >= 0)[:, None], archive.vectors[np.maximum(places, 0)], np.nan)
    found = rate_of(draws, confidence)
    told = None if claim is None else claim_of(draws, *claim)
    fitted = replicated_rate(draws, replicates, confidence)
    strata = strata_of(draws, _members(problem.space, rows, by), confidence)
    return RateView(
        simulations=found.simulations,
        unsafe=found.unsafe,
        failed=found.failed,
        confidence=confidence,
        rate=IntervalView(value=found.rate, low=found.interval[0], high=found.interval[1]),
        fixed=IntervalView(value=found.rate, low=found.fixed[0], high=found.fixed[1]),
        fitted=None if fitted is None else IntervalView(**asdict(fitted)),
        replicates=len(np.unique(replicates[~np.isnan(replicates)])),
        effective=found.effective,
        distribution=distribution_words(problem.space),
        is_stated=problem.space.distribution is not None,
        claim=None if told is None else ClaimView(**asdict(told), words=claim_words(told)),
        per_1000_km=_scaled(ratio_of(draws, distance_m, confidence), _KM_1000),
        per_hour=_scaled(ratio_of(draws, time_s, confidence), _HOUR),
        looks=[LookView(**asdict(one)) for one in looks(draws, confidence)],
        strata=[
            StratumView.model_validate(
                {**asdict(one), "rate": None if one.rate is None else asdict(one.rate)}
            )
            for one in strata
        ],
    )


def _scaled(ratio: Ratio | None, factor: float) -> IntervalView | None:
    if ratio is None:
        return None
    return IntervalView(value=factor * ratio.value, low=factor * ratio.low, high=factor * ratio.high)


def _features(draws: Draws, results: Mapping[int, str | None], names: Sequence[str]) -> FloatArray:
    """Return features of each draw, NaN where they were not recorded, shape ``(len(names), n)``."""
    amounts = np.full((len(names), len(draws.numbers)), np.nan)
    for position, number in enumerate(draws.numbers.tolist()):
        check_time()
        text = results.get(number)
        features = (json.loads(text).get("features") or {}) if text else {}
        for row, name in enumerate(names):
            value = features.get(name)
            if isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value):
                amounts[row, position] = value
    return amounts


def _members(space: SearchSpace, rows: FloatArray, by: str) -> dict[str, BoolArray]:
    """Return which rows are in each stratum; rows of NaN are in none.

    Raises:
        InvalidInput: A name is not that of a category, or there are too many strata.
    """
    known = {
        name: (column, parameter)
        for column, (name, parameter) in enumerate(zip(space.column_names(), space.parameters, strict=True))
        if isinstance(parameter, Categorical)
    }
    members: dict[str, BoolArray] = {}
    for given in filter(None, (part.strip() for part in by.split(","))):
        crossed: dict[str, BoolArray] = {"": np.ones(len(rows), np.bool_)}
        for name in (part.strip() for part in given.split("+")):
            if name not in known:
                some = ", ".join(list(known)[:3]) or "none, as there are none"
                message = f"expected categories, such as {some}, got {name!r:.60}"
                raise InvalidInput.at("/query/by", message)
            column, parameter = known[name]
            crossed = {
                f"{words}{', ' if words else ''}{name.rpartition('.')[2]} {parameter.choices[code]}": inside
                & (rows[:, column] == code)
                for words, inside in crossed.items()
                for code in parameter.codes
            }
        members |= {words: inside for words, inside in crossed.items() if inside.any()}
    if len(members) > MOST_STRATA:
        raise InvalidInput.at("/query/by", f"expected at most {MOST_STRATA} strata, got {len(members)}")
    return members


def default_strata(space: SearchSpace, declared: Sequence[str]) -> str:
    """Return the categories that a distribution names, as strata."""
    categories = [
        name
        for name, parameter in zip(space.column_names(), space.parameters, strict=True)
        if isinstance(parameter, Categorical) and name in declared and len(parameter.codes) <= 8
    ]
    return ",".join(categories[:6])


def interval_words(view: IntervalView) -> str:
    """Return a share with its interval, such as ``1.2% [0.9%, 1.6%]``."""
    return f"{percent(view.value)} [{percent(view.low, outward=-1)}, {percent(view.high, outward=1)}]"


def claim_words(claim: Claim) -> str:
    """Return what became of a claim, in a sentence."""
    limit, sure = percent(claim.at_most), f"{claim.confidence:.4g}".removeprefix("0")
    words = f"the claim of at most {limit} with confidence {sure} is"
    match claim.decision:
        case Decision.SHOWN:
            return f"{words} shown, after {claim.after:,} simulations"
        case Decision.REFUTED:
            return f"{words} refuted, after {claim.after:,} simulations"
    open_words = f"{words} not shown: up to {percent(claim.high, outward=1)} is possible"
    if claim.more is None:
        return f"{open_words}, and the estimate itself exceeds the limit"
    return f"{open_words}; about {rounded(claim.more)} more simulations would do if the rate is as estimated"
