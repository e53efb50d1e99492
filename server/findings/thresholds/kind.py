"""Thresholds as a kind of finding: where along one unit drives turn from safe to unsafe."""

from collections.abc import Sequence
from typing import Final

from brink.search.analysis.confirmation import Confirmation
from brink.search.conclusions import Outcome
from brink.server.campaigns.follow_ups.follow_up import StoredFollowUp
from brink.server.campaigns.follow_ups.limits import DEFAULT_CONFIRMATIONS
from brink.server.campaigns.follow_ups.question import question_of, refusal
from brink.server.campaigns.plan import with_truth
from brink.server.campaigns.thresholds import CampaignThresholds, find_stored_thresholds
from brink.server.findings.finding import Finding, Role, Step, StepRequest, Term
from brink.server.findings.follow_ups import follow_up_view
from brink.server.findings.kind import MOST_RINGS, Kind, Listed, Subject
from brink.server.findings.pairs.views import ComponentPart
from brink.server.findings.table import Column, Format, Table
from brink.server.findings.thresholds.analysis import thresholds_view
from brink.server.findings.thresholds.views import ThresholdsView, ThresholdView
from brink.server.findings.words import counted
from brink.server.states import ENDED, FollowUpKind, Selection

MOST_SOLUTIONS: Final = 20_000
"""Largest archive whose lines are estimated for a list; a campaign's page has those of others."""
_BEFORE: Final = [Column(name="threshold", title="threshold", format=Format.COUNT)]
_AFTER: Final = [
    Column(name="fails", title="how it fails"),
    Column(name="rule", title="rule", below=True),
    Column(name="outcome", title="state", format=Format.STATE),
    Column(name="blame", title="blamed", below=True),
    Column(name="drives", title="drives", format=Format.COUNT),
    Column(name="safe", title="safe end", format=Format.SOLUTION, optional=True),
    Column(name="unsafe", title="unsafe end", format=Format.SOLUTION, optional=True),
    Column(name="pair", title="both ends", format=Format.STATE, below=True),
    Column(name="unit", title="unit", detail=True),
    *(
        Column(name=name, title=title, format=Format.NUMBER, detail=True, optional=True)
        for name, title in (
            ("middle", "50% point"),
            ("low", "smaller end of its interval"),
            ("high", "larger end of its interval"),
            ("at_20", "20% point"),
            ("at_80", "80% point"),
            ("stretch", "stretch"),
            ("width", "distance of both ends"),
            ("safe_again", "no longer unsafe from"),
        )
    ),
    Column(name="resolution", title="resolution", format=Format.NUMBER, detail=True),
    Column(name="range", title="range", format=Format.NUMBER, detail=True),
    Column(name="rises", title="larger is unsafe", format=Format.FLAG, detail=True),
    Column(name="chancy", title="probability that it is chancy", format=Format.NUMBER, detail=True),
    Column(name="requirements", title="requirements", detail=True),
    Column(name="kind", title="kind", detail=True),
]


def columns(*, computed: bool) -> list[Column]:
    """Return the columns of a table of thresholds.

    Args:
        computed: Whether verdicts are deterministic: nothing is estimated then, and no column says so.
    """
    change, turns, within = (
        ("change from safe to unsafe", "turns", "safe and unsafe apart")
        if computed
        else ("change from 20% to 80% unsafe", "50% point, 90% interval", "20 to 80% within")
    )
    return [
        *_BEFORE,
        Column(name="change", title=change),
        Column(name="held", title="held", below=True),
        Column(name="turns", title=turns),
        Column(name="parameter", title="parameter", below=True),
        Column(name="within", title=within),
        Column(name="window", title="window", below=True),
        *_AFTER,
    ]


class ThresholdsKind(Kind):
    """Where along one unit, with all else held, drives turn from safe to unsafe."""

    id = "thresholds"
    title = "Thresholds"
    rank = 8
    is_met = True
    is_silent = True

    async def find(self, subject: Subject) -> Finding:
        """Return the thresholds, the narrowest first."""
        sources, campaign = subject.sources, subject.campaign
        found = await sources.thresholds.get(campaign, subject.read)
        view = await sources.pages.read(
            sources.engines, lambda c: thresholds_view(c, campaign, subject.read, found, subject.stored)
        )
        sharp = [one for one in view.thresholds if one.outcome is Outcome.THRESHOLD]
        pairs = [one.pair for one in view.thresholds if one.pair is not None]
        return Finding(
            kind=self.id,
            title=self.title,
            role=subject.role,
            sentence=view.sentence,
            more=[words for words in (_sharpest(sharp), _tried(sharp), _blame(view), view.note) if words],
            purpose=f"Brink searched for thresholds: a {subject.noun} and one number along which it turns from safe "
            "to unsafe while all else is held.",
            example="".join(f"For example, {_in_sentence(one.words)}" for one in sharp[:1]),
            figures=_figures(view, found),
            caveats=_caveats(view, subject.noun),
            trust=_trust(view, subject.noun),
            legend=_legend(view, subject.noun) if view.thresholds else [],
            rings=[[pair.safe.number, pair.unsafe.number] for pair in pairs][:MOST_RINGS]
            if subject.role is Role.SOUGHT
            else [],
            is_empty=not view.thresholds,
            view=_first(view, max(subject.rows, 1)) if view.thresholds else None,
            tables=[thresholds_table(view, subject.rows)] if view.thresholds else [],
            steps=_steps(subject, view),
        )

    def brief(self, listed: Listed) -> str:
        """Return how many thresholds there are, and of how many kinds."""
        campaign = listed.campaign
        generation, words = listed.kept.get(campaign.id, (None, ""))
        if generation == campaign.generation:
            return str(words)
        words = ""
        if campaign.evaluated <= MOST_SOLUTIONS:
            _, _, archive = listed.archives.stored(campaign)
            found = find_stored_thresholds(listed.archives.engines, campaign, listed.plan, archive)
            words = counted(len(found.of(Outcome.THRESHOLD)), "threshold")
        listed.kept[campaign.id] = campaign.generation, words
        return words


def _first(view: ThresholdsView, rows: int) -> ThresholdsView:
    """Return a view with its first lines alone; everything else about it is of all lines."""
    left_out = view.left_out + max(0, len(view.thresholds) - rows)
    return view.model_copy(update={"thresholds": view.thresholds[:rows], "left_out": left_out})


def thresholds_table(view: ThresholdsView, rows: int | None = None) -> Table:
    """Return thresholds as a table with one row for each line."""
    shown = view.thresholds[:rows]
    return Table(
        name="thresholds",
        title="Thresholds, the narrowest stretch first",
        columns=columns(computed=view.computed),
        rows=[_row(one) for one in shown],
        left_out=view.left_out + len(view.thresholds) - len(shown),
    )


def _row(one: ThresholdView) -> list[str | int | float | bool | None]:
    pair = one.pair
    return [
        one.place,
        one.change if one.outcome is Outcome.THRESHOLD else one.words,
        f"held: {one.held}" if one.held else "",
        one.turns,
        one.parameter,
        one.within,
        one.window,
        one.fails,
        one.rule,
        one.outcome.value,
        one.blame_words,
        one.drives,
        None if pair is None else pair.safe.number,
        None if pair is None else pair.unsafe.number,
        "" if pair is None else _pair_words(one),
        one.unit,
        one.middle,
        one.low,
        one.high,
        one.at_20,
        one.at_80,
        one.stretch,
        None if pair is None else pair.width,
        one.safe_again,
        one.resolution,
        one.range,
        one.rises,
        one.chancy,
        ", ".join(one.requirements),
        " / ".join(one.kind),
    ]


def _pair_words(one: ThresholdView) -> str:
    pair = one.pair
    assert pair is not None
    if one.outcome is not Outcome.THRESHOLD:
        return ""  # how wide the stretch is, is not known
    words = "tight pair" if pair.tight else "wider than the stretch"
    if pair.confirmation is Confirmation.NOT_TRIED:
        return words
    counts = " ".join(f"{end.again.unsafe}/{end.again.evaluated}" for end in (pair.safe, pair.unsafe))
    return f"{words}, {pair.confirmation.value} {counts}"


def _figures(view: ThresholdsView, found: CampaignThresholds) -> list[Term]:
    thresholds = len(found.of(Outcome.THRESHOLD))
    if not found.all:
        return []
    told = [
        Term(term=f"{thresholds:,}", words="threshold" if thresholds == 1 else "thresholds"),
        Term(term=f"{view.kinds:,}", words="kind of threshold" if view.kinds == 1 else "kinds of thresholds"),
    ]
    if chancy := len(found.of(Outcome.CHANCY)):
        words = "chancy line, without a threshold" if chancy == 1 else "chancy lines, without a threshold"
        told.append(Term(term=f"{chancy:,}", words=words))
    states = [one.pair.confirmation for one in view.thresholds if one.pair is not None]
    if tried := sum(state not in (Confirmation.NOT_TRIED, Confirmation.PENDING) for state in states):
        words = "thresholds: both ends confirmed with other seeds"
        told.append(Term(term=f"{states.count(Confirmation.CONFIRMED):,} of {tried:,}", words=words))
    if asked := _asked(view):
        words = "thresholds: the component is to blame, judged with one seed each"
        told.append(Term(term=f"{_blamed(asked):,} of {len(asked):,}", words=words))
    return told


def _sharpest(sharp: Sequence[ThresholdView]) -> str:
    """Return the first threshold in a sentence; empty without any."""
    return "".join(f"The sharpest: {_in_sentence(one.words)}" for one in sharp[:1])


def _in_sentence(words: str) -> str:
    """Return words as the later part of a sentence."""
    return words[:1].lower() + words[1:]


def _tried(sharp: Sequence[ThresholdView]) -> str:
    """Return whether the ends hold with other seeds; empty where nothing can tell, or nothing was tried."""
    states = [one.pair.confirmation for one in sharp if one.pair is not None]
    tried = [state for state in states if state not in (Confirmation.NOT_TRIED, Confirmation.PENDING)]
    if not tried:
        return ""
    told = ", ".join(
        f"{tried.count(state):,} {state.value}"
        for state in (Confirmation.CONFIRMED, Confirmation.UNDECIDED, Confirmation.REFUTED)
    )
    return (
        f"Both ends of {counted(len(tried), 'threshold')} were simulated again with other seeds: {told}. Ends lie "
        "close to the 20 and 80% points, so that many simulations are needed to tell"
    )


def _asked(view: ThresholdsView) -> list[ThresholdView]:
    """Return the thresholds whose unsafe end was simulated with ground truth."""
    known = (ComponentPart.COMPONENT, ComponentPart.SCENARIO)
    return [one for one in view.thresholds if one.outcome is Outcome.THRESHOLD and one.blame in known]


def _blamed(asked: Sequence[ThresholdView]) -> int:
    return sum(one.blame is ComponentPart.COMPONENT for one in asked)


def _blame(view: ThresholdsView) -> str:
    """Say how many thresholds are the component's hazard; empty if there is no component or no threshold."""
    thresholds = [one for one in view.thresholds if one.outcome is Outcome.THRESHOLD]
    if not view.has_component or not thresholds:
        return ""
    asked = _asked(view)
    if not asked:
        return "Whether the component or the scenario is to blame was not tried"
    rest = len(thresholds) - len(asked)
    words = (
        f"With ground truth in place of the component, in one drive each, the unsafe end of {_blamed(asked):,} of "
        f"{counted(len(asked), 'threshold')} is safe: there, the component is to blame"
    )
    return f"{words}. For {rest:,}, that was not tried" if rest else words


def _caveats(view: ThresholdsView, noun: str) -> list[str]:
    told = []
    if any(one.outcome is Outcome.THRESHOLD for one in view.thresholds):
        told.append(
            f"Each threshold holds for its own {noun}: if anything that is held differs, the number turns elsewhere"
        )
    unstated = sorted({one.parameter for one in view.thresholds if not one.states_resolution})
    if unstated:
        told.append(
            f"The problem states no resolution of {_some(unstated)}: 1% of the range counts as the same there"
        )
    return told


def _some(names: Sequence[str]) -> str:
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")


def _trust(view: ThresholdsView, noun: str) -> list[Term]:
    drives = sum(one.drives for one in view.thresholds)
    if not drives:
        return []
    if view.computed:
        words = (
            f"{counted(drives, noun)} without chance: each threshold lies between a safe and an unsafe one."
        )
        return [Term(term="No chance", words=words)]
    return [
        Term(
            term="Fresh seeds",
            words=f"The curves rest on {drives:,} {noun}s, each with random numbers of its own. "
            f"Intervals cover the truth with a probability of {view.confidence:.0%}.",
        )
    ]


def _legend(view: ThresholdsView, noun: str) -> list[str]:
    if view.computed:
        told = [
            f"A threshold: with all else held, a {noun} turns from safe to unsafe between two values of one number "
            "that are at most two resolutions apart. Verdicts have no chance, so nothing is estimated"
        ]
    else:
        told = [
            f"A threshold: with all else held, the probability that the {noun} is unsafe passes from at most 20% to "
            "at least 80% along one number, or two that move together",
            f"50% point: where half of the {noun}s are unsafe, with the interval that contains it with a probability "
            f"of {view.confidence:.0%}; the stretch from 20 to 80% is also given as a share of the range",
            "rule: from the 80% point to the furthest value that was simulated",
            "chancy: the probability does not pass from 20 to 80% within a fifth of the range; open: more "
            "simulations would tell",
        ]
    if any(one.pair is not None for one in view.thresholds):
        told.append(
            f"both ends: the simulated {noun}s on either side, a tight pair"
            if view.computed
            else f"both ends: simulated {noun}s below 20 and above 80%, by a resolution if there are such; a tight "
            "pair if they are at most the stretch and two resolutions apart"
        )
    if view.has_component and any(one.outcome is Outcome.THRESHOLD for one in view.thresholds):
        told.append(
            "hazard: the component's if the unsafe end is safe with ground truth in place of the component, "
            "otherwise the scenario's; judged in one drive, with the seed of the search"
        )
    if any(one.window for one in view.thresholds):
        told.append(f"window: further on, {noun}s are safe again, so larger is not simply worse")
    if any("…" in one.held for one in view.thresholds):
        told.append("held: … stands for what changes")
    told.append(
        "Kinds are told apart by the number and its error, the target, the shape of the road, and how it fails"
    )
    return told


def _steps(subject: Subject, view: ThresholdsView) -> list[Step]:
    campaign = subject.campaign
    sharp = [one for one in view.thresholds if one.outcome is Outcome.THRESHOLD]
    if not sharp:
        if subject.role is not Role.SOUGHT:
            return []
        return [subject.longer("A larger budget finds more unsafe drives, and estimates more lines.")]
    steps = [
        Step(
            kind="look",
            question="How sharp is it?",
            words=f"Draws how likely a violation is along each unit, with every {subject.noun} that says so.",
            command=f"brink thresholds {campaign.id} --picture thresholds.png",
        )
    ]
    if campaign.status in ENDED:
        steps += [step for step in (_confirm(subject, sharp), _component(subject, sharp)) if step is not None]
        if any(one.pair is not None for one in sharp):
            steps.append(subject.keep("--thresholds", "the drives at both ends of each threshold"))
    return steps


def _confirm(subject: Subject, sharp: Sequence[ThresholdView]) -> Step | None:
    """Return the step that simulates both ends with other seeds; None if there is nothing left to do."""
    pairs = [one.pair for one in sharp if one.pair is not None]
    untried = [pair for pair in pairs if pair.confirmation is Confirmation.NOT_TRIED]
    running = _running(subject, FollowUpKind.CONFIRM)
    if subject.plan.problem.ignores_seeds or not (untried or running):
        return None
    most = len({end.number for pair in pairs for end in (pair.safe, pair.unsafe)}) * DEFAULT_CONFIRMATIONS
    return _ask(
        subject,
        FollowUpKind.CONFIRM,
        question="Do both ends hold?",
        label="Simulate both ends again",
        words="Simulates both ends of each threshold with other seeds, until each is confirmed or refuted.",
        cost=f"It takes at most {most:,} simulations.",
    )


def _component(subject: Subject, sharp: Sequence[ThresholdView]) -> Step | None:
    """Return the step that asks whether the component is to blame; None if there is nothing left to do."""
    untried = [one for one in sharp if one.blame is ComponentPart.NOT_TRIED]
    running = _running(subject, FollowUpKind.COMPONENT)
    if refusal(lambda: with_truth(subject.plan.problem)) or not (untried or running):
        return None
    return _ask(
        subject,
        FollowUpKind.COMPONENT,
        question="Is the component to blame?",
        label="Simulate with ground truth",
        words="Simulates each unsafe end once more, with ground truth in place of the component.",
        cost=f"It takes at most {len(sharp):,} simulations.",
        by_default=subject.role is Role.SOUGHT,
    )


def _running(subject: Subject, kind: FollowUpKind) -> StoredFollowUp | None:
    """Return the follow-up of a kind that is being simulated, if any."""
    asked = (one for one in subject.stored if one.kind is kind and one.selection is Selection.PAIRS)
    return next((one for one in asked if one.campaign.status not in ENDED), None)


def _ask(
    subject: Subject,
    kind: FollowUpKind,
    *,
    question: str,
    label: str,
    words: str,
    cost: str,
    by_default: bool = False,
) -> Step:
    running = _running(subject, kind)
    return Step(
        kind=kind.value,
        question=question,
        label=label,
        words=words if running else f"{words} {cost}",
        command=f"brink thresholds {subject.campaign.id} {question_of(kind).option}",
        request=StepRequest(path=f"{subject.path}/thresholds/follow-ups", body={"kind": kind.value}),
        follow_up=None if running is None else follow_up_view(running.kind, running.campaign),
        by_default=by_default,
        tells_more=True,
    )


KIND = ThresholdsKind()
"""Findings of the kind `thresholds`: where along one unit drives turn from safe to unsafe."""
