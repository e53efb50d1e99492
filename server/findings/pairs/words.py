"""Pairs in words: the evidence for one of them, what it shows, and how far to trust them."""

from typing import Final

from brink.search.analysis.confirmation import Confirmation, Share
from brink.search.sequential import INTERVAL, Verdict, verdict_of
from brink.server.findings.finding import Term
from brink.server.findings.follow_ups import ShareView
from brink.server.findings.pairs.views import (
    ComponentPart,
    ConfirmationView,
    Minimality,
    PairNature,
    PairsView,
    PairView,
)
from brink.server.findings.words import as_sentence, counted
from brink.sim.verdict import held_words

_CUT: Final = " more difference"
"""Part of a change in words that omits differences."""
_GAP_HELD: Final = held_words(["front-gap"])
_REPEATED: Final = (Confirmation.CONFIRMED, Confirmation.REFUTED, Confirmation.UNDECIDED)
_ONE_SEED: Final = "the {} is to blame, judged with this one seed"
_REDUCED: Final = {
    Minimality.PENDING: "being minimised",
    Minimality.UNDECIDED: "minimality undecided",
    Minimality.MINIMAL: "minimal",
}
_NATURES: Final = {
    PairNature.NUMBERS: "",
    PairNature.CATEGORY: " (categorical pair)",
    PairNature.SCENARIO: " (categorical pair, scenario only)",
}
_PARTS: Final = {
    ComponentPart.COMPONENT: "component's hazard (one seed)",
    ComponentPart.SCENARIO: "scenario's hazard (one seed)",
    ComponentPart.FAILED: "ground truth failed",
    ComponentPart.PENDING: "ground truth pending",
}
"""Whether the component or the scenario is to blame."""


def in_words(pair: PairView, *, computed: bool) -> PairView:
    """Return a pair with the evidence for it in words.

    Args:
        pair: The pair.
        computed: Whether its verdicts are computed, so that they are deterministic.
    """
    return pair.model_copy(
        update={
            "evidence": tuple(_evidence(pair, computed=computed)),
            "shown": tuple(_shown(pair)),
            "facts": tuple(_facts(pair, computed=computed)),
            "safe": pair.safe.model_copy(update={"again": share_words(pair.confirmation.safe)}),
            "unsafe": pair.unsafe.model_copy(update={"again": share_words(pair.confirmation.unsafe)}),
        }
    )


def _evidence(pair: PairView, *, computed: bool) -> list[str]:
    """Return what is known beyond one simulation of each side, such as ``checked``, ``confirmed 0/15 15/15``.

    The two shares say how often the safe and the unsafe side were unsafe with other seeds.
    """
    words = ["computed" if computed else "checked" if pair.checked else "found once"]
    again = pair.confirmation
    if again.state is not Confirmation.NOT_TRIED:
        counts = " ".join(f"{one.unsafe}/{one.evaluated}" for one in (again.safe, again.unsafe))
        state = "confirmation pending" if again.state is Confirmation.PENDING else again.state
        words.append(f"{state} {counts}")
    if pair.component.state in _PARTS:
        words.append(_PARTS[pair.component.state])
    less = pair.minimality
    if less.unsafe is not None:
        words.append(_enough(pair, "differences"))
    elif less.state is Minimality.DIFFERENT_SEEDS and not computed:
        words.append("different seeds")
    elif less.state in _REDUCED:
        words.append(_REDUCED[less.state])
    return words


def _enough(pair: PairView, differences: str) -> str:
    """Return how many of the differences are enough."""
    less = pair.minimality.unsafe
    enough = 0 if less is None else len(less.changes)
    return f"{enough} of {len(pair.changes)} {differences} {'is' if enough == 1 else 'are'} enough"


def _shown(pair: PairView) -> list[str]:
    """Return what the follow-ups of a pair showed about the component and about chance, in sentences."""
    told = (
        [_component_words(pair)]
        if pair.component.state in (ComponentPart.COMPONENT, ComponentPart.SCENARIO)
        else []
    )
    again = pair.confirmation
    if again.state is Confirmation.CONFIRMED:
        told.append(f"Confirmed with {_drives_a_side(again)} other seeds each side.")
    elif again.state is Confirmation.REFUTED:
        # First, because it limits what the rest says.
        told.insert(0, f"Refuted, so its verdicts depend on chance: with other seeds, {_doubt(again)}.")
    elif again.state is Confirmation.UNDECIDED:
        told.insert(0, f"Undecided with {_drives_a_side(again)} other seeds each side: chance may decide.")
    return told


def _component_words(pair: PairView) -> str:
    """Say whether the unsafe drive is safe with ground truth in place of the component, and what that means."""
    first, _, rest = pair.component.outcome.partition("; ")
    others = f" (but {rest})" if rest else ""
    if pair.component.state is ComponentPart.SCENARIO:
        what = f" ({pair.component.outcome})" if pair.component.outcome else ""
        blamed = _ONE_SEED.format("scenario")
        return f"With true perception and the same seed, this drive is unsafe too{what}: {blamed}."
    keeps = "keeps the front gap" if first == _GAP_HELD else "is safe"
    blamed = _ONE_SEED.format("component")
    return f"With true perception and the same seed, this drive {keeps}{others}: {blamed}."


def _drives_a_side(again: ConfirmationView) -> str:
    counts = sorted({again.safe.evaluated, again.unsafe.evaluated})
    return " to ".join(str(count) for count in counts)


def _doubt(again: ConfirmationView) -> str:
    """Say which side does not keep its verdict with other seeds."""
    said, safe, unsafe = [], again.safe, again.unsafe
    if verdict_of(safe.unsafe, safe.evaluated, safe.failed) is Verdict.REFUTED:
        said.append(f"the safe side was unsafe in {again.safe.unsafe} of {again.safe.evaluated}")
    if verdict_of(unsafe.evaluated - unsafe.unsafe, unsafe.evaluated, unsafe.failed) is Verdict.REFUTED:
        was = "" if said else " was unsafe"
        said.append(f"the unsafe side{was} in only {again.unsafe.unsafe} of {again.unsafe.evaluated}")
    return " and ".join(said)


def _facts(pair: PairView, *, computed: bool) -> list[str]:
    """Return further facts about a pair, in sentences."""
    told = []
    if pair.moved:
        told.append(f"{as_sentence(pair.moved)}.")
    if not computed and pair.confirmation.state not in _REPEATED:
        told.append(_search_words(pair))
    if _CUT in pair.change:
        told.append(f"All that differs: {', '.join(change.words for change in pair.changes)}.")
    less = pair.minimality
    if less.state is Minimality.DIFFERENT_SEEDS:
        told.append("The two had different episode seeds, so chance may explain the verdicts.")
    elif less.state is Minimality.MINIMAL:
        how = " (tried by simulation)" if less.tried else ""  # a single difference needs no simulation
        told.append(f"No part of the change can be left out{how}.")
    elif less.unsafe is not None:
        told.append(f"{_enough(pair, 'the differences')}.")
        if less.unsafe.change != pair.change:
            told.append(f"A smaller change: {less.unsafe.change}: {less.unsafe.outcome}.")
    return told


def _search_words(pair: PairView) -> str:
    """Return how often the search itself simulated both sides, in a sentence."""
    if pair.confirmation.state is Confirmation.PENDING:
        return "Both sides are being simulated again with other seeds."
    if pair.checked:
        return "Checked: the search simulated each side again with another seed, and both verdicts held."
    return "The search did not simulate both sides again with another seed, so chance may decide."


def extent_words(pair: PairView) -> str:
    """Return in how many of the parameters the sides differ, and whether it is a category or a step alone."""
    differing = sum(len(change.names) for change in pair.changes)
    words = f"{differing} of {sum(map(len, pair.safe.parameters.values()))} parameters"
    return words + _NATURES[pair.nature]


def share_words(share: ShareView) -> str:
    """Return how often a side was unsafe with other seeds; empty if that was not tried."""
    if share.evaluated == 0 or share.probability is None:
        return ""
    counts = f"unsafe in {share.unsafe} of {share.evaluated} simulations with other seeds"
    interval = f"{INTERVAL:.0%} interval {100 * share.low:.0f} to {100 * share.high:.0f}%"
    return f"{counts}: {100 * share.probability:.0f}%, {interval}"


def legend(view: PairsView) -> tuple[str, ...]:
    """Return what the words about pairs mean that need it, one term at a time."""
    told = [view.terms] if view.terms else []
    if view.categorical:
        told.append(
            "categorical pair: a category or a step is changed and nothing else; scenario only: it belongs to the "
            "scenario, so the pair says nothing about the component"
        )
    states = {pair.confirmation.state for pair in view.pairs}
    if view.pairs and not view.computed:
        told.append("safe and unsafe: by the requirement of the campaign alone")
        if any(pair.checked for pair in view.pairs):
            told.append("checked: during the search, each side kept its verdict with another seed, too")
        if not all(pair.checked for pair in view.pairs):
            told.append("found once: the search did not simulate both sides with another seed")
    if any(pair.minimality.state is Minimality.MINIMAL for pair in view.pairs):
        told.append("minimal: none of the differences can be reverted without losing the opposite verdicts")
    if view.tried or view.pending:
        told += _confirmation_legend(view)
    if Confirmation.REFUTED in states:
        told.append(
            f"refuted: a side is beyond its limit, with the same error rate ({view.rule.error:.0%}), so its "
            "verdicts depend on chance"
        )
    if Confirmation.UNDECIDED in states:
        told.append("undecided: neither confirmed nor refuted by these simulations; more may decide")
    if any(pair.minimality.state is Minimality.DIFFERENT_SEEDS for pair in view.pairs):
        told.append(
            "different seeds: the sides also differ in their episode seeds, so chance may be the reason rather than "
            "the change"
        )
    if view.component or view.scenario:
        told.append(
            "hazard: the component's if the unsafe side keeps the requirement with ground truth in place of the "
            "component, otherwise the scenario's; judged in one drive, with the seed of the search"
        )
    if Confirmation.CONFIRMED in states or Confirmation.REFUTED in states:
        told.append("confirmed pairs come first, refuted ones last; a pair keeps its number")
    return tuple(told)


def _confirmation_legend(view: PairsView) -> list[str]:
    rule = view.rule
    first, second = rule.least_drives, rule.least_drives + rule.further_drives
    return [
        f"confirmed 0/{first} {second - 1}/{second}: with other seeds, the safe side was unsafe in 0 of {first} "
        f"simulations after the search and the unsafe side in {second - 1} of {second}. Confirmed: the safe side "
        f"is unsafe with a probability of at most {rule.safe_at_most:.0%}, the unsafe side with one of at least "
        f"{rule.unsafe_at_least:.0%}. It takes {first} simulations of a side, and {rule.further_drives} more for "
        f"each with the other verdict; the error rate is {rule.error:.0%}",
        f"exact {rule.interval:.0%} intervals of these shares: {_interval(0, first)} after 0/{first}, "
        f"{_interval(second - 1, second)} after {second - 1}/{second}; those of each pair are on its picture and "
        "in the files",
    ]


def _interval(unsafe: int, evaluated: int) -> str:
    share = Share.of(unsafe, evaluated)
    return f"{share.low:.0%} to {share.high:.0%}"


def meaning(view: PairsView, noun: str) -> str:
    """Return what a pair is, in sentences.

    Args:
        view: The pairs.
        noun: What a solution is called.
    """
    return (
        f"A pair is two {noun}s on either side of the boundary, at most {view.eps:g} apart on average over all "
        "parameters (in [0, 1]), or one step: one number may still move far, and each pair says how far. "
        f"Pairs that are at least {view.d_th:g} apart count as distinct"
    )


def categorical_words(view: PairsView) -> str:
    """Return how many pairs differ in a category or a step alone, without a full stop; empty if none does."""
    if not view.categorical:
        return ""
    words = (
        f"In {view.categorical:,} of {counted(view.distinct, 'pair')}, a category or a step is changed and nothing "
        "else"
    )
    if view.scenario_only:
        words += f"; in {view.scenario_only:,} of these, it belongs to the scenario"
    return words


def figures(view: PairsView) -> list[Term]:
    """Return how many pairs there are, how many of them hold, and for how many the component is to blame."""
    told = [
        Term(term=f"{view.distinct:,}", words="distinct pair" if view.distinct == 1 else "distinct pairs")
    ]
    if view.categorical:
        told.append(Term(term=f"{view.categorical:,} of {view.distinct:,}", words="pairs are categorical"))
    if view.tried:
        words = "pairs confirmed with other seeds"
        told.append(Term(term=f"{view.confirmed:,} of {view.tried:,}", words=words))
    blamed, asked, which = view.component, view.component + view.scenario, "pairs, confirmed or not"
    if confirmed := view.component_confirmed + view.scenario_confirmed:
        blamed, asked, which = view.component_confirmed, confirmed, "confirmed pairs"
    if asked:
        words = f"{which}: the component is to blame, judged with one seed each"
        told.append(Term(term=f"{blamed:,} of {asked:,}", words=words))
    return told


def chance_words(view: PairsView) -> str:
    """Describe the role of chance in the pairs, in a sentence; empty if it plays none."""
    if view.computed or not view.distinct:
        return ""
    if view.tried:
        return (
            f"{view.confirmed:,} of {counted(view.tried, 'pair')} that were simulated again with other seeds are "
            f"confirmed, {view.refuted:,} are refuted: their verdicts depend on chance. {view.undecided:,} are "
            "undecided."
        )
    checked = ""
    if view.checked:
        which = "its sides" if view.distinct == 1 else f"both sides of {view.checked:,} of them"
        checked = f"; the search itself simulated {which} twice"
    some = "it" if view.distinct == 1 else "some of them"
    return f"No pair was simulated again after the search, so chance may explain {some}{checked}."


def trust(view: PairsView, *, has_component: bool) -> list[Term]:
    """Return how far pairs can be trusted, term by term.

    Args:
        view: The pairs.
        has_component: Whether ground truth can replace a component.
    """
    if view.computed or not view.distinct:
        return []
    terms = [Term(term="Confirmation", words=_confirmation(view))]
    if has_component:
        terms.append(Term(term="Component", words=_component(view)))
    if view.chance:
        terms.append(Term(term="Chance", words=" ".join(f"{words}." for words in view.chance)))
    return terms


def _confirmation(view: PairsView) -> str:
    if not (view.tried or view.pending):
        return "No pair has been simulated again with other seeds after the search."
    pending = f", {view.pending:,} are being simulated" if view.pending else ""
    return (
        f"Simulated again with other seeds: {view.tried:,} of {counted(view.distinct, 'pair')}. "
        f"{view.confirmed:,} confirmed, {view.refuted:,} refuted, {view.undecided:,} undecided{pending}. "
        f"Confirmed means that the safe side is unsafe with a probability of at most {view.rule.safe_at_most:.0%}, "
        f"and the unsafe side with one of at least {view.rule.unsafe_at_least:.0%}; the error rate of either claim "
        f"is {view.rule.error:.0%}."
    )


def _component(view: PairsView) -> str:
    asked = view.component + view.scenario
    if not asked:
        return "Whether the component or the scenario is to blame for the unsafe sides was not tested."
    rest = f"; for {view.scenario:,}, the scenario alone is enough" if view.scenario else ""
    confirmed = view.component_confirmed + view.scenario_confirmed
    sure = (
        f" Of the confirmed pairs among them, it is {view.component_confirmed:,} of {confirmed:,}."
        if confirmed
        else " None of these pairs is confirmed."
    )
    return (
        f"With ground truth in place of the component, the unsafe side of {view.component:,} of "
        f"{counted(asked, 'pair')} is safe: there the component is to blame{rest}. Judged in one drive each, with "
        f"the seed of the search.{sure}"
    )
