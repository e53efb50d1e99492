"""The evidence on pairs, in words for tables: what both sides share, the evidence, and the meaning of terms."""

from brink.search.analysis.confirmation import Confirmation, Share
from brink.server.findings.pairs.views import ComponentPart, Minimality, PairsView, PairView


def common_words(pair: PairView) -> list[str]:
    """Return a line about what both sides share; none if they share nothing."""
    return [f"in both: {pair.common}"] if pair.common else []


def extent_words(pair: PairView) -> str:
    """Return in how many of the parameters the sides differ."""
    differing = sum(len(change.names) for change in pair.changes)
    return f"{differing} of {sum(map(len, pair.safe.parameters.values()))} parameters"


def legend(view: PairsView) -> list[str]:
    """Explain the words of the table that need it, one term at a time."""
    found = [view.terms] if view.terms else []
    states = {pair.confirmation.state for pair in view.pairs}
    if view.pairs and not view.computed:
        found.append("safe and unsafe: by the requirement of the campaign alone")
        if any(pair.checked for pair in view.pairs):
            found.append("checked: during the search, each side kept its verdict with another seed, too")
        if not all(pair.checked for pair in view.pairs):
            found.append("found once: the search did not simulate both sides with another seed")
    if any(pair.minimality.state is Minimality.MINIMAL for pair in view.pairs):
        found.append("minimal: none of the differences can go without losing the opposite verdicts")
    if view.tried or view.pending:
        rule, first, second = (
            view.rule,
            view.rule.least_drives,
            view.rule.least_drives + view.rule.further_drives,
        )
        found.append(
            f"confirmed 0/{first} {second - 1}/{second}: with other seeds, the safe side was unsafe in 0 of {first} "
            f"simulations after the search and the unsafe side in {second - 1} of {second}. Confirmed: the safe side "
            f"is unsafe with a probability of at most {rule.safe_at_most:.0%}, the unsafe side with one of at least "
            f"{rule.unsafe_at_least:.0%}. It takes {first} simulations of a side, and {rule.further_drives} more for "
            f"each with the other verdict; the error rate is {rule.error:.0%}"
        )
        found.append(
            f"exact {rule.interval:.0%} intervals of these shares: {_interval(0, first)} after 0/{first}, "
            f"{_interval(second - 1, second)} after {second - 1}/{second}; those of each pair are on its picture and "
            "in the files"
        )
    if Confirmation.REFUTED in states:
        found.append(
            f"refuted: a side is beyond its limit, with the same error rate ({view.rule.error:.0%}), so chance has "
            "a part"
        )
    if Confirmation.UNDECIDED in states:
        found.append("undecided: neither confirmed nor refuted by these simulations; more may tell")
    if any(pair.minimality.state is Minimality.DIFFERENT_SEEDS for pair in view.pairs):
        found.append(
            "different seeds: the sides also differ in their episode seeds, so chance may be the reason rather than "
            "the change"
        )
    if view.component or view.scenario:
        found.append(
            "hazard: the component's if the unsafe side keeps the requirement with ground truth in place of the "
            "component, otherwise the scenario's; judged in one drive, with the seed of the search"
        )
    if Confirmation.CONFIRMED in states or Confirmation.REFUTED in states:
        found.append("confirmed pairs come first, refuted ones last; a pair keeps its number")
    return found


def _interval(unsafe: int, evaluated: int) -> str:
    share = Share.of(unsafe, evaluated)
    return f"{share.low:.0%} to {share.high:.0%}"


def evidence_words(view: PairsView, pair: PairView) -> str:
    """Return the evidence on a pair beyond one simulation of each side, such as ``checked, confirmed 0/10 10/10``.

    The two shares say how often the safe and the unsafe side were unsafe with other seeds.
    """
    words = ["computed" if view.computed else "checked" if pair.checked else "found once"]
    again = pair.confirmation
    if again.state is not Confirmation.NOT_TRIED:
        counts = " ".join(f"{one.unsafe}/{one.evaluated}" for one in (again.safe, again.unsafe))
        state = "confirmation pending" if again.state is Confirmation.PENDING else again.state
        words.append(f"{state} {counts}")
    if pair.component.state is not ComponentPart.NOT_TRIED:
        words.append(_PARTS[pair.component.state])
    less = pair.minimality
    if less.unsafe is not None:
        enough, differing = len(less.unsafe.changes), len(pair.changes)
        words.append(f"{enough} of {differing} differences {'is' if enough == 1 else 'are'} enough")
    elif less.state is Minimality.DIFFERENT_SEEDS and not view.computed:
        words.append("different seeds")
    elif less.state is not Minimality.NOT_TRIED:
        words.append(_REDUCED.get(less.state, str(less.state)))
    return ", ".join(words)


_REDUCED = {Minimality.PENDING: "being minimised", Minimality.UNDECIDED: "minimal or not: undecided"}
"""Words for states that do not speak for themselves."""
_PARTS = {
    ComponentPart.COMPONENT: "component's hazard (one seed)",
    ComponentPart.SCENARIO: "scenario's hazard (one seed)",
    ComponentPart.FAILED: "ground truth failed",
    ComponentPart.PENDING: "ground truth pending",
}
"""Whose hazard it is."""
