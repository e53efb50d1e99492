"""What is known of pairs, in words for tables: what both sides share, the evidence, and what the terms mean."""

from brink.search.analysis.confirmation import LEAST_DRIVES, Confirmation, Share
from brink.server.api.pair_views import ComponentPart, Minimality, PairsView, PairView


def common_words(pair: PairView) -> list[str]:
    """Return a line about what both sides share; none if they share nothing."""
    return [f"in both: {pair.common}"] if pair.common else []


def extent_words(pair: PairView) -> str:
    """Return in how many of the parameters the sides differ."""
    differing = sum(len(change.names) for change in pair.changes)
    return f"{differing} of {sum(map(len, pair.safe.parameters.values()))} parameters"


def legend(view: PairsView) -> list[str]:
    """Return what the words of the table mean that need it, one term at a time."""
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
        found.append(
            "confirmed 0/10 9/10: with other seeds, the safe side was unsafe in 0 of 10 simulations after the search "
            f"and the unsafe side in 9 of 10; at most 20% and at least 80% confirm a pair, from {LEAST_DRIVES} each"
        )
        found.append(
            f"95% intervals of these shares: {_interval(0, LEAST_DRIVES)} after 0/{LEAST_DRIVES}, "
            f"{_interval(LEAST_DRIVES, LEAST_DRIVES)} after {LEAST_DRIVES}/{LEAST_DRIVES}; those of each pair are on "
            "its picture and in the files"
        )
    if Confirmation.NOT_CONFIRMED in states:
        found.append("not confirmed: these shares are beyond those limits, so chance may decide")
    if Confirmation.TOO_FEW in states:
        found.append(
            f"too few drives: less than {LEAST_DRIVES} of a side have a verdict, and that may matter"
        )
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
    if Confirmation.CONFIRMED in states or Confirmation.NOT_CONFIRMED in states:
        found.append("confirmed pairs come first, those not confirmed last; a pair keeps its number")
    return found


def _interval(unsafe: int, evaluated: int) -> str:
    share = Share.of(unsafe, evaluated)
    return f"{share.low:.0%} to {share.high:.0%}"


def evidence_words(view: PairsView, pair: PairView) -> str:
    """Return what is known of a pair beyond one simulation of each side, such as ``checked, confirmed 0/10 10/10``.

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
