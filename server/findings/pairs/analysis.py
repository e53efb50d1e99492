"""The pairs of a campaign with all evidence for them."""

import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Self

from sqlalchemy import Connection, Row

from brink.search.algorithms.minimise import Reduced, Reductions
from brink.search.analysis.confirmation import Confirmation, Share
from brink.search.analysis.pairs import Pair, Side
from brink.search.features import Unit
from brink.search.odd import with_odd
from brink.server.campaigns import view_store
from brink.server.campaigns.archives import ReadArchive
from brink.server.campaigns.follow_ups.follow_up import StoredFollowUp
from brink.server.campaigns.follow_ups.kinds.confirm import Repeated
from brink.server.campaigns.follow_ups.kinds.minimise import has_one_seed, pairs_of, reduced_by
from brink.server.campaigns.follow_ups.limits import MOST_PAIRS_FOLLOWED
from brink.server.campaigns.follow_ups.question import AskedPairs, Offer, questions
from brink.server.campaigns.outcomes import SolutionOutcome, outcome_of
from brink.server.campaigns.pairs import CampaignPairs, find_reducible
from brink.server.campaigns.plan import Plan, make_plan
from brink.server.campaigns.store import Campaign
from brink.server.errors import NotFound
from brink.server.findings.follow_ups import ShareView, follow_up_view
from brink.server.findings.pairs.table import pairs_table
from brink.server.findings.pairs.views import (
    ChangeView,
    ComponentPart,
    ComponentView,
    ConfirmationView,
    FollowUpOffer,
    Minimality,
    MinimalityView,
    MinimisedView,
    NearestView,
    PairNature,
    PairsView,
    PairView,
    SideView,
)
from brink.server.findings.pairs.words import in_words, legend
from brink.server.findings.solutions import activity_view, simulated
from brink.server.findings.words import as_sentence, so_far
from brink.server.problems.base import Problem, SimulatedSolution, describe_candidate
from brink.server.problems.changes import Change, change_words, changes_between, common_words, moved_words
from brink.server.problems.error_slots import SCENARIO
from brink.server.states import ENDED, CampaignStatus, FollowUpKind, Selection, SolutionVerdict
from brink.sim.verdict import drives_held, unsafe_words


def pairs_view(
    connection: Connection,
    campaign: Campaign,
    found: ReadArchive,
    pairs: CampaignPairs,
    stored: Sequence[StoredFollowUp],
    limit: int,
) -> PairsView:
    """Return the distinct pairs of a campaign.

    Args:
        connection: Read connection.
        campaign: The campaign.
        found: Its archive.
        pairs: Its pairs.
        stored: Its repeats.
        limit: Maximum number of pairs to return: confirmed ones first, refuted ones last, each with its own place.
    """
    problem = found.plan.problem
    repeated = Repeated.of(stored)
    states = [repeated.state(pair.safe.number, pair.unsafe.number) for pair in pairs.found.pairs]
    natures = [_nature(problem, pair) for pair in pairs.found.pairs]
    ranks = [(state.rank, _NATURES.index(nature)) for state, nature in zip(states, natures, strict=True)]
    placed = sorted(enumerate(pairs.found.pairs, start=1), key=lambda one: ranks[one[0] - 1])[:limit]
    shown = [pair for _, pair in placed]
    numbers = {side.number for pair in shown for side in (pair.safe, pair.unsafe)}
    some = set(found.archive.numbers[:1].tolist())  # tells the requirement where there is no pair
    rows = {row.number: row for row in view_store.read_solutions(connection, campaign.id, numbers | some)}
    if not rows.keys() >= numbers:
        raise NotFound(f"campaign {campaign.id}: no such campaign")  # it was deleted meanwhile
    evidence = _Evidence.read(connection, found, pairs, shown, stored, repeated)
    parts = [evidence.component(pair).state for pair in pairs.found.pairs]
    deciding = _deciding(problem, next(iter(rows.values()), None))
    sides = _sides_again(pairs.found.pairs, repeated)
    blamed = [part for part, state in zip(parts, states, strict=True) if state is Confirmation.CONFIRMED]
    counts = {
        "tried": sum(state not in (Confirmation.NOT_TRIED, Confirmation.PENDING) for state in states),
        "pending": states.count(Confirmation.PENDING),
        "confirmed": states.count(Confirmation.CONFIRMED),
        "refuted": states.count(Confirmation.REFUTED),
        "undecided": states.count(Confirmation.UNDECIDED),
        "component": parts.count(ComponentPart.COMPONENT),
        "scenario": parts.count(ComponentPart.SCENARIO),
        "component_confirmed": blamed.count(ComponentPart.COMPONENT),
        "scenario_confirmed": blamed.count(ComponentPart.SCENARIO),
    }
    sentence = _result_words(pairs, deciding, counts, computed=problem.ignores_seeds)
    view = PairsView(
        campaign=campaign.id,
        name=campaign.body.name,
        status=campaign.status,
        complete=campaign.status in ENDED,
        generation=found.generation,
        evaluated=len(found.archive),
        eps=pairs.settings.eps,
        d_th=pairs.settings.d_th,
        searched=found.plan.is_for("pairs"),
        computed=problem.ignores_seeds,
        replayable=problem.records_traces,
        sentence=sentence,
        note=so_far(campaign, sentence),
        blame=_blame(deciding, counts),
        terms=problem.terms_of_changes,
        caveat=with_odd(_caveat(campaign, problem), problem.space),
        safe=pairs.found.safe,
        unsafe=pairs.found.unsafe,
        chancy=pairs.found.chancy,
        without_part=pairs.found.without_part,
        repeated=sides[0],
        changed=sides[1],
        chance=_chance(pairs, *sides, refuted=counts["refuted"]),
        tight=pairs.found.tight,
        distinct=len(pairs.found.pairs),
        categorical=len(natures) - natures.count(PairNature.NUMBERS),
        scenario_only=natures.count(PairNature.SCENARIO),
        checked=pairs.found.checked,
        **counts,
        nearest=None
        if pairs.nearest is None
        else NearestView(
            safe=pairs.nearest.safe, unsafe=pairs.nearest.unsafe, distance=pairs.nearest.distance
        ),
        follow_ups=[follow_up_view(one.kind, one.campaign) for one in stored],
        offers=_offers(campaign, found, pairs, stored),
        pairs=[
            in_words(_pair(place, pair, problem, rows, evidence), computed=problem.ignores_seeds)
            for place, pair in placed
        ],
    )
    return view.model_copy(update={"legend": legend(view), "table": pairs_table(view)})


def _sides_again(pairs: Sequence[Pair], repeated: Repeated) -> tuple[int, int]:
    """Return how many sides were simulated again with other seeds, and how many of them then had another verdict."""
    sides = {pair.safe.number: False for pair in pairs} | {pair.unsafe.number: True for pair in pairs}
    shares = {number: repeated.shares[number] for number in sides if number in repeated.shares}
    changed = [
        (share.evaluated - share.unsafe if sides[number] else share.unsafe) > 0
        for number, share in shares.items()
    ]
    return len(shares), sum(changed)


def _chance(pairs: CampaignPairs, again: int, changed: int, *, refuted: int) -> tuple[str, ...]:
    """Return the estimated role of chance: from the search, and from later simulations."""
    chancy, alike, told = pairs.found.chancy, pairs.found.without_part, []
    if chancy:
        what, which = (
            ("1 solution was", "it is") if chancy == 1 else (f"{chancy:,} solutions were", "they are")
        )
        told.append(f"In the search, {what} safe and unsafe with different seeds; {which} in no pair")
    if alike:
        told.append(
            f"In {_cases(alike)}, two near solutions with opposite verdicts differ in no parameter that was "
            "active in either drive: chance decides there, so they are not a pair"
        )
    if again:
        what = "1 side of a pair was" if again == 1 else f"{again:,} sides of pairs were"
        had = f"{changed:,}" if changed else "none"
        told.append(
            f"After the search, {what} simulated again with other seeds; {had} had the other verdict at least once"
        )
    if refuted and refuted == len(pairs.found.pairs):
        told.append(
            "No pair held with other seeds, so chance has a part in all of them. A search that checks pairs with "
            "further seeds drops such pairs"
        )
    return tuple(told)


def _cases(number: int) -> str:
    return "1 case" if number == 1 else f"{number:,} cases"


def _caveat(campaign: Campaign, problem: Problem) -> str:
    """State what pairs do not show about a user's component; empty without a component."""
    return "" if campaign.body.ground_truth else problem.about_component


def _offers(
    campaign: Campaign, found: ReadArchive, pairs: CampaignPairs, stored: Sequence[StoredFollowUp]
) -> list[FollowUpOffer]:
    """Return the cost of each kind of follow-up, or why it is unavailable."""
    chosen = pairs.found.pairs[:MOST_PAIRS_FOLLOWED]
    asked = AskedPairs(campaign=campaign, plan=found.plan, archive=found.archive, pairs=chosen)
    offers = []
    for question in questions():
        own = [one for one in stored if one.kind is question.kind]
        open_ones = [
            one for one in own if one.selection is Selection.PAIRS and one.campaign.status not in ENDED
        ]
        if pairs.reducible is None:
            offer = Offer(reason=f"the campaign is {campaign.status}: wait until it has ended")
        elif not chosen:
            offer = Offer(reason="there is no pair")
        elif open_ones:
            last = open_ones[-1].campaign
            offer = Offer(reason=f"this has been requested: campaign {last.id} is {last.status}")
        else:
            finished = [one for one in own if one.campaign.status is CampaignStatus.FINISHED]
            offer = question.offer(asked, pairs.reducible, finished)
        offers.append(
            FollowUpOffer(
                kind=question.kind,
                title=question.title,
                label=question.label,
                words=question.words,
                repeats=question.repeats,
                exact=question.is_exact,
                simulations=offer.simulations,
                reason=offer.reason,
                left_out=offer.left_out,
            )
        )
    return offers


def _pair(
    place: int, pair: Pair, problem: Problem, rows: Mapping[int, Row[Any]], evidence: "_Evidence"
) -> PairView:
    safe, unsafe = (simulated(problem, rows[side.number]) for side in (pair.safe, pair.unsafe))
    changes, change, moved = _changes(problem, safe, unsafe, pair.units)
    sides = [
        _side(side, problem, solution, rows[side.number])
        for side, solution in ((pair.safe, safe), (pair.unsafe, unsafe))
    ]
    return PairView(
        place=place,
        words=f"{as_sentence(change)}: {sides[1].outcome}",
        change=change,
        moved=moved,
        common=common_words(sides[0].words, sides[1].words),
        distance=pair.distance,
        nature=_nature(problem, pair),
        checked=pair.checked,
        same_seed=pair.same_seed,
        confirmation=evidence.confirmation(pair),
        component=evidence.component(pair),
        minimality=evidence.minimality(pair, safe),
        changes=changes,
        safe=sides[0],
        unsafe=sides[1],
    )


_NATURES: Final = list(PairNature)


def _nature(problem: Problem, pair: Pair) -> PairNature:
    """Return what differs between the sides of a pair."""
    if not pair.is_categorical:
        return PairNature.NUMBERS
    names = problem.space.column_names()
    of_scenario = all(names[column].startswith(f"{SCENARIO}.") for unit in pair.units for column in unit)
    return PairNature.SCENARIO if of_scenario else PairNature.CATEGORY


def _changes(
    problem: Problem, safe: SimulatedSolution, unsafe: SimulatedSolution, units: Sequence[Unit]
) -> tuple[list[ChangeView], str, str]:
    """Return the differences between two solutions, active ones first, the change in words, and its size."""
    changes = sorted(changes_between(problem, safe, unsafe, units), key=lambda change: change.active is False)
    titles = problem.space.titles()
    views = [_change(change, titles) for change in changes]
    return views, change_words(problem, safe, unsafe, changes), moved_words(changes)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Reduction:
    """A follow-up that reverts differences.

    Attributes:
        stored: The follow-up.
        reduced: How far it is.
        rows: The stored solutions that are unsafe sides now, by number.
    """

    stored: StoredFollowUp
    reduced: Reduced
    rows: Mapping[int, Row[Any]]

    @classmethod
    def read(cls, connection: Connection, stored: StoredFollowUp) -> Self:
        """Read how far a follow-up is."""
        reduced = reduced_by(make_plan(stored.campaign.body), stored)
        latest = [number for number in reduced.latest if number is not None]
        rows = view_store.read_solutions(connection, stored.campaign.id, latest)
        return cls(stored=stored, reduced=reduced, rows={row.number: row for row in rows})

    @property
    def is_finished(self) -> bool:
        """Whether nothing is left to do."""
        return self.stored.campaign.status is CampaignStatus.FINISHED


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Evidence:
    """The results of a campaign's follow-ups.

    Attributes:
        plan: The campaign's plan.
        reducible: The pairs of which a difference can be reverted, among those shown, by their two numbers.
        repeated: What repeats of their sides have shown.
        truths: The drive of each solution with ground truth, by number.
        reductions: The follow-up that reverts the differences of a pair, and its place there, by its two numbers.
    """

    plan: Plan
    reducible: Collection[tuple[int, int]]
    repeated: Repeated
    truths: Mapping[int, ComponentView]
    reductions: Mapping[tuple[int, int], tuple[_Reduction, int]]

    @classmethod
    def read(
        cls,
        connection: Connection,
        found: ReadArchive,
        pairs: CampaignPairs,
        shown: Sequence[Pair],
        stored: Sequence[StoredFollowUp],
        repeated: Repeated,
    ) -> Self:
        """Read the results of the follow-ups.

        Args:
            connection: Read connection.
            found: The campaign's archive.
            pairs: The campaign's pairs.
            shown: Those to be shown.
            stored: Its follow-ups, oldest first.
            repeated: What those with other seeds have shown.
        """
        reductions: dict[tuple[int, int], tuple[_Reduction, int]] = {}
        for one in stored:
            if one.kind is FollowUpKind.MINIMISE:
                reduction = _Reduction.read(connection, one)
                for place, pair in enumerate(pairs_of(one)):
                    if pair not in reductions or not reductions[pair][0].is_finished:
                        reductions[pair] = reduction, place
        return cls(
            plan=found.plan,
            reducible=find_reducible(found.plan, found.archive, shown)
            if pairs.reducible is None
            else pairs.reducible.pairs,
            repeated=repeated,
            truths=read_truths(connection, stored),
            reductions=reductions,
        )

    def confirmation(self, pair: Pair) -> ConfirmationView:
        """Return whether both sides of a pair keep their verdicts with other seeds."""
        safe, unsafe = self.repeated.shares_of(pair.safe.number, pair.unsafe.number)
        state = self.repeated.state(pair.safe.number, pair.unsafe.number)
        return ConfirmationView(state=state, safe=_share(safe), unsafe=_share(unsafe))

    def component(self, pair: Pair) -> ComponentView:
        """Return whether the scenario alone is to blame for the unsafe side of a pair."""
        return self.truths.get(pair.unsafe.number) or ComponentView(state=ComponentPart.NOT_TRIED)

    def minimality(self, pair: Pair, safe: SimulatedSolution) -> MinimalityView:
        """Return whether every difference between the sides of a pair matters."""
        if not has_one_seed(self.plan, pair):
            return MinimalityView(state=Minimality.DIFFERENT_SEEDS)
        known = self.reductions.get((pair.safe.number, pair.unsafe.number))
        if known is None:
            untried = (pair.safe.number, pair.unsafe.number) in self.reducible
            return MinimalityView(state=Minimality.NOT_TRIED if untried else Minimality.MINIMAL)
        reduction, place = known
        reduced, ended = reduction.reduced, reduction.stored.campaign.status in ENDED
        pairs, latest = reduced.reductions, reduced.latest[place]
        minimal = pairs.is_minimal(place)
        if latest is not None:
            state = Minimality.NOT_MINIMAL
        elif minimal:
            state = Minimality.MINIMAL
        elif pairs.is_undecided(place):
            state = Minimality.UNDECIDED
        else:
            state = Minimality.NOT_TRIED if ended else Minimality.PENDING
        return MinimalityView(
            state=state,
            campaign=reduction.stored.campaign.id,
            tried=reduced.tried[place],
            unsafe=None if latest is None else self._minimised(reduction.rows[latest], pairs, place, safe),
        )

    def _minimised(
        self, row: Row[Any], pairs: Reductions, place: int, safe: SimulatedSolution
    ) -> MinimisedView:
        problem, steps = self.plan.problem, pairs.steps
        unsafe = simulated(problem, row)
        sides = pairs.safe[place], pairs.unsafe[place]
        changes, change, _ = _changes(problem, safe, unsafe, steps.differing(*sides))
        return MinimisedView(
            number=row.number,
            robustness=row.robustness,
            outcome=_outcome(problem, row).words(),
            parameters=problem.space.decode(tuple(unsafe.vectors)),
            distance=steps.distance(*sides),
            minimal=True if pairs.is_minimal(place) else None,
            changes=changes,
            change=change,
        )


_KNOWN_PARTS: Final = (ComponentPart.COMPONENT, ComponentPart.SCENARIO)


def read_truths(connection: Connection, stored: Sequence[StoredFollowUp]) -> dict[int, ComponentView]:
    """Return what drives with ground truth showed, by number of the solution.

    Args:
        connection: Read connection.
        stored: The follow-ups of a campaign, oldest first; those of other kinds are ignored.
    """
    truths: dict[int, ComponentView] = {}
    for one in stored:
        if one.kind is FollowUpKind.COMPONENT:
            for number, view in _truths(connection, one).items():
                if number not in truths or truths[number].state not in _KNOWN_PARTS:
                    truths[number] = view
    return truths


def _truths(connection: Connection, stored: StoredFollowUp) -> dict[int, ComponentView]:
    """Return what the drives of a follow-up with ground truth showed, by number of the solution in the campaign.

    Those that were never simulated, because the follow-up was cancelled, are left out.
    """
    problem = make_plan(stored.campaign.body).problem
    rows = {
        row.number: row
        for row in view_store.read_solutions(connection, stored.campaign.id, range(len(stored.numbers)))
    }
    found = {}
    for place, number in enumerate(stored.numbers):
        row = rows.get(place)
        verdict = None if row is None else row.verdict
        if row is not None and verdict in (SolutionVerdict.SAFE, SolutionVerdict.UNSAFE):
            unsafe = verdict == SolutionVerdict.UNSAFE
            found[number] = ComponentView(
                state=ComponentPart.SCENARIO if unsafe else ComponentPart.COMPONENT,
                campaign=stored.campaign.id,
                number=place,
                robustness=row.robustness,
                outcome=_outcome(problem, row).words(),
            )
        elif verdict == SolutionVerdict.FAILED or stored.campaign.status not in ENDED:
            failed = verdict == SolutionVerdict.FAILED
            found[number] = ComponentView(
                state=ComponentPart.FAILED if failed else ComponentPart.PENDING,
                campaign=stored.campaign.id,
                number=place,
            )
    return found


def _change(change: Change, titles: Mapping[str, str]) -> ChangeView:
    return ChangeView(
        names=list(change.names),
        titles=[titles[name] for name in change.names],
        units=list(change.units),
        safe=list(change.safe),
        unsafe=list(change.unsafe),
        active=change.active,
        moved=change.moved,
        words=change.words,
    )


def _share(share: Share) -> ShareView:
    return ShareView(
        evaluated=share.evaluated,
        unsafe=share.unsafe,
        probability=share.probability,
        low=share.low,
        high=share.high,
        failed=share.failed,
    )


def _result(row: Row[Any] | None) -> dict[str, Any] | None:
    return json.loads(row.result) if row is not None and row.result else None


def _side(side: Side, problem: Problem, solution: SimulatedSolution, row: Row[Any]) -> SideView:
    activity, outcome = solution.activity, _outcome(problem, row)
    return SideView(
        number=side.number,
        evaluated=side.evaluated,
        robustness=side.robustness,
        seed=row.seed,
        outcome=outcome.words(),
        kind=outcome.kind,
        words=describe_candidate(problem, solution.vectors, activity),
        parameters=problem.space.decode(tuple(solution.vectors)),
        activity=None if activity is None else activity_view(problem.space, activity),
    )


def _outcome(problem: Problem, row: Row[Any]) -> SolutionOutcome:
    """Return the outcome of a simulation."""
    safe = row.verdict == SolutionVerdict.SAFE
    return outcome_of(problem, _result(row), safe=safe, robustness=row.robustness)


def _deciding(problem: Problem, row: Row[Any] | None) -> tuple[str, ...]:
    """Return the requirements that decide the verdict; empty if they are unknown."""
    if problem.requirements:
        return problem.requirements
    episode = None if row is None else _outcome(problem, row).episode
    return () if episode is None else episode.deciding


def _blame(deciding: tuple[str, ...], counts: Mapping[str, int]) -> str:
    """Return for how many pairs the component is to blame, and for how many the scenario; empty if unknown."""
    asked = counts["component"] + counts["scenario"]
    if not asked:
        return ""
    held, violated = (drives_held(deciding), unsafe_words(deciding)) if deciding else ("is safe", "is unsafe")
    words = (
        f"With ground truth in place of the component, in one drive each, the unsafe side of {counts['component']:,} "
        f"of {asked:,} {held} (the component's hazard)"
    )
    if counts["scenario"]:
        words += f", that of {counts['scenario']:,} {violated} all the same (the scenario's hazard)"
    if confirmed := counts["component_confirmed"] + counts["scenario_confirmed"]:
        blamed = counts["component_confirmed"]
        words += f"; of the confirmed pairs, {blamed:,} of {confirmed:,} are the component's"
    return words


def _tried_words(counts: Mapping[str, int]) -> str:
    """Return how many of the pairs that were simulated again are confirmed, refuted and undecided."""
    states = ("confirmed", "refuted", "undecided")
    if counts["refuted"] == counts["tried"]:
        return "all refuted" if counts["tried"] > 1 else "refuted"
    told = [f"{counts[state]:,} {state}" for state in states if counts[state] or state == "confirmed"]
    return " and ".join([*([", ".join(told[:-1])] if told[1:] else []), told[-1]])


def _result_words(
    pairs: CampaignPairs, deciding: tuple[str, ...], counts: Mapping[str, int], *, computed: bool
) -> str:
    found, settings = pairs.found, pairs.settings
    if found.pairs:
        single = len(found.pairs) == 1
        words = (
            "1 distinct pair across the boundary"
            if single
            else f"{len(found.pairs):,} distinct pairs across the boundary"
        )
        if not computed:  # chance has no part in computed verdicts: there is nothing to check
            if found.checked:
                words += ", checked" if single else f", {found.checked:,} checked"
            elif not counts["tried"] and not counts["pending"]:
                words += f", {'not' if single else 'none'} simulated again yet"
        if counts["tried"]:
            words += f"; of {counts['tried']:,} simulated again with other seeds, {_tried_words(counts)}"
        if counts["pending"]:
            words += f"; {counts['pending']:,} being simulated again"
        return words
    if found.without_part:
        return (
            f"no pair: in {_cases(found.without_part)}, two near solutions with opposite verdicts differ in no "
            "parameter that was active in their drives, so chance decides"
        )
    if not found.safe and not found.unsafe and not found.chancy:
        return "no solution has been evaluated: no pair"
    if pairs.nearest is None:
        if not found.safe and not found.unsafe:
            return f"every solution had both verdicts ({found.chancy:,}): no pair"
        both = f"; {found.chancy:,} had both verdicts" if found.chancy else ""
        count = found.safe + found.unsafe
        be = "is" if count == 1 else "are"
        if found.safe:
            did = drives_held(deciding) if deciding else f"{be} safe"
        else:
            did = unsafe_words(deciding) if deciding else f"{be} unsafe"
        return f"{'the only solution' if count == 1 else f'all {count:,} solutions'} {did}{both}: no pair"
    return (
        f"no pair within eps {settings.eps:g}: the nearest solutions with opposite verdicts, "
        f"{pairs.nearest.safe} and {pairs.nearest.unsafe}, are {pairs.nearest.distance:.3g} apart"
    )
