"""Pairs as a kind of finding."""

import math
from collections.abc import Sequence
from typing import Annotated, Final

from pydantic import Field

from brink.search.analysis.confirmation import Confirmation
from brink.search.errors import TooManyPairs
from brink.search.odd import odd_sentence
from brink.server.campaigns.follow_ups.kinds.confirm import Repeated
from brink.server.campaigns.follow_ups.question import question_of
from brink.server.campaigns.follow_ups.store import read_follow_ups
from brink.server.campaigns.pairs import PairSettings, find_stored_pairs
from brink.server.errors import InvalidInput
from brink.server.findings.finding import Finding, Role, Step, StepRequest
from brink.server.findings.follow_ups import follow_up_view
from brink.server.findings.kind import MOST_RINGS, Kind, Listed, Settings, Subject
from brink.server.findings.pairs.analysis import pairs_view
from brink.server.findings.pairs.table import pairs_table
from brink.server.findings.pairs.views import (
    MOST_PAIRS,
    BestPair,
    FollowUpOffer,
    PairsFound,
    PairsView,
    PairView,
)
from brink.server.findings.pairs.words import categorical_words, chance_words, figures, meaning, trust
from brink.server.findings.words import counted
from brink.server.states import ENDED, Selection

MOST_SOLUTIONS: Final = 20_000
"""Largest archive that is searched for pairs for a list; a campaign's page has those of others."""
BEST: Final = 3


class PairsSettings(Settings):
    """Which pairs to find; by default those at the campaign's own settings."""

    eps: Annotated[float | None, Field(ge=0, le=1)] = None
    d_th: Annotated[float | None, Field(ge=0, le=1)] = None
    first: Annotated[
        int | None, Field(ge=1, description="Leave out pairs with larger numbers than this one.")
    ] = None


class PairsKind(Kind):
    """Neighbours of which one is safe and one unsafe."""

    id = "pairs"
    title = "Pairs"
    rank = 10
    is_met = True
    settings = PairsSettings

    async def find(self, subject: Subject) -> Finding:
        """Return the distinct pairs, confirmed ones first."""
        sources = subject.sources
        try:
            asked = PairSettings.of(subject.plan, subject.settings.eps, subject.settings.d_th)
            pairs = await sources.pairs.get(subject.campaign, subject.read, asked)
        except InvalidInput as error:
            words = "; ".join(one.message for one in error.errors)
            steps = self._steps(subject, None)
            return Finding(
                kind=self.id,
                title=self.title,
                role=subject.role,
                sentence=words,
                page=f"{subject.path}/pairs",
                is_empty=subject.role is not Role.SOUGHT,
                steps=steps,
            )
        first = subject.settings.first
        limit = max(subject.rows, BEST) if first is None else MOST_PAIRS
        view = await sources.pages.read(
            sources.engines,
            lambda c: pairs_view(c, subject.campaign, subject.read, pairs, subject.stored, limit),
        )
        if first is not None:
            view = view.model_copy(update={"pairs": [pair for pair in view.pairs if pair.place <= first]})
        sides = (
            [[pair.safe.number, pair.unsafe.number] for pair in pairs.found.pairs] if view.searched else []
        )
        caveats = []
        if view.distinct:  # what the outcomes say already is left out
            caveats = [chance_words(view), view.caveat.removesuffix(odd_sentence(subject.plan.problem.space))]
        many, best = f"{subject.noun}s", view.pairs[:1]
        return Finding(
            kind=self.id,
            title=self.title,
            role=subject.role,
            sentence=view.sentence,
            more=[words for words in (categorical_words(view), view.blame) if words],
            purpose=f"Brink searched for pairs of {many} that are neighbours, although one is safe and the other is "
            "not: the boundary of what the system can handle runs between them.",
            example="".join(f"For example, pair {pair.place}: {pair.words}" for pair in best),
            figures=figures(view),
            caveats=[words for words in map(str.rstrip, caveats) if words],
            trust=trust(view, has_component=subject.plan.problem.has_component),
            legend=[meaning(view, subject.noun), *view.legend] if view.pairs else [],
            rings=sides[:MOST_RINGS],
            page=f"{subject.path}/pairs",
            is_empty=not view.distinct,
            view=PairsFound(
                replayable=view.replayable,
                best=[_best_pair(pair) for pair in view.pairs[:BEST]],
                rule=_rule_words(view),
            ),
            tables=[pairs_table(view, subject.rows)],
            steps=self._steps(subject, view),
        )

    def brief(self, listed: Listed) -> str:
        """Return how many there are, and how many of them hold with other seeds."""
        pairs = _sides(listed)
        if not pairs:
            return "" if pairs is None else "no pair"
        with listed.archives.engines.reader.connect() as connection:
            repeated = Repeated.of(read_follow_ups(connection, listed.campaign.id))
        states = [repeated.state(*sides) for sides in pairs]
        tried = sum(state not in (Confirmation.NOT_TRIED, Confirmation.PENDING) for state in states)
        confirmed = states.count(Confirmation.CONFIRMED)
        if not tried:
            return counted(len(pairs), "pair")
        if tried == len(pairs):
            return f"{confirmed:,} of {counted(tried, 'pair')} {'holds' if tried == 1 else 'hold'}"
        return f"{counted(len(pairs), 'pair')}; {confirmed:,} of {tried:,} simulated again hold"

    def _steps(self, subject: Subject, view: PairsView | None) -> list[Step]:
        has_pairs = view is not None and bool(view.distinct)
        if subject.role is not Role.SOUGHT:
            return [_look(subject, view, "Which change decides?")] if view is not None and has_pairs else []
        if view is None or not has_pairs:
            return _search_on(subject, view)
        asked = [_ask(subject, view, offer) for offer in view.offers]
        steps = [*(step for step in asked if step is not None), _look(subject, view, "What happens in them?")]
        if any(pair.confirmation.state is Confirmation.CONFIRMED for pair in view.pairs):
            steps.append(subject.keep("--pairs confirmed", "confirmed pairs"))
        return steps


def _best_pair(pair: PairView) -> BestPair:
    safe, unsafe = pair.confirmation.safe, pair.confirmation.unsafe
    shares = ""
    if safe.evaluated + unsafe.evaluated:
        shares = (
            f"With other seeds, the safe drive was unsafe in {safe.unsafe:,} of {safe.evaluated:,} simulations, and "
            f"the unsafe drive in {unsafe.unsafe:,} of {unsafe.evaluated:,}."
        )
    return BestPair(
        place=pair.place,
        safe=pair.safe.number,
        unsafe=pair.unsafe.number,
        words=pair.words,
        state=pair.confirmation.state,
        evidence=", ".join(pair.evidence),
        shares=shares,
    )


def _rule_words(view: PairsView) -> str:
    """State the rule by which a pair holds."""
    rule = view.rule
    if view.computed:
        return "Verdicts are computed, not simulated: every pair holds."
    return (
        f"A pair holds if, with other seeds, the safe drive is unsafe in at most {rule.safe_at_most:.0%} of the "
        f"simulations and the unsafe one in at least {rule.unsafe_at_least:.0%}. It is confirmed or refuted with an "
        f"error rate of {rule.error:.0%}, and undecided where the simulations show neither."
    )


def _ask(subject: Subject, view: PairsView, offer: FollowUpOffer) -> Step | None:
    """Return the step that asks for a follow-up; None if there is nothing left to do."""
    campaign, question = subject.campaign.id, question_of(offer.kind)
    open_one = next(
        (
            one
            for one in subject.stored
            if one.kind is offer.kind
            and one.selection is Selection.PAIRS
            and one.campaign.status not in ENDED
        ),
        None,
    )
    done = offer.repeats is not None and view.tried + view.pending == view.distinct
    if open_one is None and (offer.reason or done or view.computed):
        return None
    simulations = offer.simulations * (offer.repeats or 1)
    most = "" if offer.exact else "at most "
    repeats = {} if offer.repeats is None else {"repeats": offer.repeats}
    return Step(
        kind=offer.kind.value,
        question=question.title,
        label=question.label,
        words=question.words if open_one else f"{question.words} It takes {most}{simulations:,} simulations.",
        command=f"brink pairs {campaign} {question.option}",
        request=StepRequest(
            path=f"{subject.path}/pairs/follow-ups", body={"kind": offer.kind.value, **repeats}
        ),
        follow_up=None if open_one is None else follow_up_view(open_one.kind, open_one.campaign),
        tells_more=True,
    )


def _search_on(subject: Subject, view: PairsView | None) -> list[Step]:
    """Return what may lead to pairs after a search that found none."""
    steps = [subject.longer("A larger budget finds nearer solutions with opposite verdicts.")]
    if view is not None and not (view.safe and view.unsafe):
        words = "All verdicts are the same: search wider ranges of the parameters, or by another requirement."
        steps.append(Step(kind="widen", question="Can it violate anything?", words=words))
    if view is not None and view.nearest is not None:
        eps = _rounded_up(view.nearest.distance)
        steps.append(
            Step(
                kind="nearest",
                question="Which come closest?",
                words=f"With eps={eps}, the nearest solutions with opposite verdicts are a pair.",
                command=f"brink pairs {subject.campaign.id} --eps {eps}",
            )
        )
    return steps


def _rounded_up(distance: float) -> str:
    """Return a distance in (0, 1] rounded up to two digits, as text."""
    unit = 10.0 ** (math.floor(math.log10(distance)) - 1)
    return f"{min(1.0, math.ceil(distance / unit) * unit):.2g}"


def _look(subject: Subject, view: PairsView, question: str) -> Step:
    campaign, best = subject.campaign.id, view.pairs[0].place
    return Step(
        kind="look",
        question=question,
        words=f"Shows both {'drives' if view.replayable else 'sides'} of each pair side by side.",
        label="Open the pair" if view.distinct == 1 else f"Open all {view.distinct:,} pairs",
        place=f"campaigns/{campaign}/pairs",
        command=f"brink pairs {campaign}" + (f" --film {best} pair-{best}.mp4" if view.replayable else ""),
    )


def _sides(listed: Listed) -> Sequence[tuple[int, int]] | None:
    """Return the sides of the distinct pairs, computed once; None if there are too many."""
    campaign = listed.campaign
    sides: Sequence[tuple[int, int]] | None
    generation, sides = listed.kept.get(campaign.id, (None, None))
    if generation == campaign.generation:
        return sides
    sides = None
    if campaign.evaluated <= MOST_SOLUTIONS:
        _, _, archive = listed.archives.stored(campaign)
        settings = PairSettings.of(listed.plan)
        try:
            found = find_stored_pairs(listed.archives.engines, campaign.id, listed.plan, archive, settings)
            sides = tuple((pair.safe.number, pair.unsafe.number) for pair in found.pairs)
        except TooManyPairs:
            pass
    listed.kept[campaign.id] = campaign.generation, sides
    return sides


KIND = PairsKind()
