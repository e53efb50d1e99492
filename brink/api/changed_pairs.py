"""Simulates the pairs of a campaign with one thing changed: driving system, detector or fidelity.

They are a campaign of its own, so that they say nothing of the pairs of the first one. Both sides of each pair are
simulated with the seeds that `brink pairs --confirm` gives them, until it is clear whether each keeps its verdict.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, Final

from brink.api.results import FetchedArchive
from brink.search.analysis.confirmation import Share
from brink.search.sequential import LIMIT, Verdict
from brink.server.campaigns.body import CampaignBody, changes_with_files
from brink.server.campaigns.follow_ups.kinds.confirm import drives_by_solution, named_repeats_body
from brink.server.campaigns.plan import make_plan
from brink.server.errors import InvalidInput
from brink.server.findings.pairs.views import PairView
from brink.server.findings.table import Cell, Column, Format, Table
from brink.server.findings.words import counted
from brink.server.states import Selection


def changed_campaign(
    fetched: FetchedArchive, pairs: Sequence[PairView], changes: Mapping[str, Any], repeats: int
) -> tuple[CampaignBody, tuple[int, ...]]:
    """Return the campaign that simulates both sides of pairs with changed parameters, and their numbers in its order.

    Args:
        fetched: The campaign of the pairs.
        pairs: At least one.
        changes: New values of parameters of the problem. Another driving system gets the settings of the old one only
            if they are among them.
        repeats: Most simulations of each side.

    Raises:
        InvalidInput: The problem has no such parameter or value, or another space with it, or a program cannot run.
    """
    problem = fetched.body.problem
    changes = changes_with_files(changes, "--set")
    params = {**problem.params, **changes}
    if "driving" in changes and "driving_settings" in problem.params:
        params["driving_settings"] = changes.get("driving_settings", {})
    changed = fetched.body.model_copy(update={"problem": problem.model_copy(update={"params": params})})
    space = make_plan(changed).problem.space
    if space != fetched.plan.problem.space:
        raise InvalidInput.at(
            "--set",
            f"expected a change that leaves the search space of {problem.id} as it is: with "
            f"{', '.join(changes)} changed, these drives do not exist",
        )
    numbers = list(dict.fromkeys(side.number for pair in pairs for side in (pair.safe, pair.unsafe)))
    body, ordered = named_repeats_body(
        changed, fetched.plan, fetched.archive, repeats=repeats, numbers=numbers, selection=Selection.PAIRS
    )
    words = ", ".join(f"{name}={value}" for name, value in changes.items())
    update = {
        "name": f"{fetched.body.name}: pairs with {words}"[:200],
        "execution": body.execution.model_copy(update={"max_failed_share": 1.0}),  # they count as such
    }
    return body.model_copy(update=update), ordered


def changed_shares(
    body: CampaignBody, numbers: Sequence[int], ended: Mapping[int, bool | None]
) -> dict[int, Share]:
    """Return how often each side was unsafe, by its number in the first campaign.

    Args:
        body: The campaign that simulates the sides.
        numbers: Their numbers, as `changed_campaign` returned them.
        ended: Whether each of its candidates that has ended was unsafe, by number; None if it failed.
    """
    counts = Counter((numbers[place], verdict) for place, verdict in drives_by_solution(body, ended))
    return {
        number: Share.of(
            counts[number, True], counts[number, True] + counts[number, False], counts[number, None]
        )
        for number in numbers
    }


def changed_table(pairs: Sequence[PairView], shares: Mapping[int, Share]) -> Table:
    """Return the pairs as a table with how often each side was unsafe with the change."""
    share = f"at least {1 - LIMIT:.0%}"
    return Table(
        name="changed",
        title="Pairs with the change",
        columns=[
            Column(name="pair", title="pair", format=Format.COUNT),
            Column(name="words", title="change from the safe to the unsafe drive"),
            Column(name="unsafe", title="unsafe drive: violated"),
            Column(name="unsafe_keeps", title=f"{share} unsafe"),
            Column(name="safe", title="safe drive: violated"),
            Column(name="safe_keeps", title=f"{share} safe"),
        ],
        rows=[
            [
                pair.place,
                pair.change,
                *_side(shares[pair.unsafe.number], unsafe=True),
                *_side(shares[pair.safe.number], unsafe=False),
            ]
            for pair in pairs
        ],
    )


def _side(share: Share, *, unsafe: bool) -> list[Cell]:
    known = f"{share.unsafe} of {share.evaluated}" + (f", {share.failed} failed" if share.failed else "")
    return [known, _keeps(share, unsafe=unsafe)]


def _keeps(share: Share, *, unsafe: bool) -> str:
    """Return whether a side has its verdict with at least 80% of seeds."""
    if not share.evaluated:
        return "cannot run" if share.failed else "not simulated"
    keeps = share.keeps(unsafe=unsafe)
    return {Verdict.HOLDS: "yes", Verdict.REFUTED: "no", Verdict.UNDECIDED: "undecided"}[keeps]


def changed_words(pairs: Sequence[PairView], shares: Mapping[int, Share]) -> str:
    """Return in a sentence how many of the unsafe and of the safe sides keep their verdicts with the change."""
    told = []
    for verdict in ("unsafe", "safe"):
        sides = {getattr(pair, verdict).number for pair in pairs}
        found = Counter(_keeps(shares[number], unsafe=verdict == "unsafe") for number in sides)
        others = "".join(f", {found[words]} {words}" for words in _OTHERS if found[words])
        told.append(
            f"{found['yes']} of {counted(len(sides), f'{verdict} drive')} {'is' if found['yes'] == 1 else 'are'} "
            f"{verdict} with at least {1 - LIMIT:.0%} of seeds, {found['no']} not{others}"
        )
    return "; ".join(told)


_OTHERS: Final = ("undecided", "cannot run", "not simulated")
