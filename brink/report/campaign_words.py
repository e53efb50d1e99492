"""Sentences of a campaign's report: the question, the findings, their certainty, and what was left out."""

import dataclasses
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from brink.api.live import failures_of
from brink.report.campaign_facts import LISTED, Facts
from brink.search.analysis.dependence import ParameterColumn
from brink.search.odd import odd_words
from brink.search.parameters import Categorical
from brink.search.space import FloatArray
from brink.server.campaigns.body import DEFAULT_D_TH, DEFAULT_T_B
from brink.server.campaigns.repeats import FollowUpKind
from brink.server.findings.pairs.views import PairsView
from brink.server.findings.tolerances.views import CellView, ToleranceView, Tolerated
from brink.server.problems.catalogue import ODD, is_baseline
from brink.server.problems.changes import as_sentence
from brink.server.states import CampaignStatus, OutcomeKind
from brink.sim.catalogue import REQUIREMENTS, load_plugin
from brink.sim.errors import SimulatorError

MOST_CHOICES: Final = 12
"""Choices of a parameter that are listed by name."""
LONGEST_VALUE: Final = 100
TIGHTEST: Final = 1
"""Tolerances in the first paragraph."""


@dataclass(frozen=True, slots=True)
class Term:
    """A term and its explanation."""

    term: str
    words: str


@dataclass(frozen=True, slots=True)
class Range:
    """Parameters of the search space with the same range."""

    component: str
    names: str
    values: str


def count(number: int, noun: str) -> str:
    """Return a number with its noun, such as ``1 pair`` or ``1,300 pairs``."""
    return f"{number:,} {noun}" if number == 1 else f"{number:,} {noun}s"


def share(part: int, whole: int) -> str:
    """Return a share in whole per cent, or more precisely if that would be 0 or 100."""
    if not whole:
        return "–"
    value = part / whole
    return f"{value:.0%}" if value in (0, 1) or 0.01 <= value <= 0.99 else f"{value:.2%}"


def noun(facts: Facts) -> str:
    """Return the noun for a solution."""
    return "drive" if facts.drives else "solution"


def subject(facts: Facts) -> str:
    """Return what was tested, in a few words."""
    return facts.fetched.plan.problem.summary.partition(":")[0].rstrip(".")


def others_recorded(facts: Facts) -> bool:
    """Return whether requirements were recorded that do not decide the verdict."""
    recorded = (facts.sample.verdicts if facts.sample is not None else None) or {}
    return bool(recorded.keys() - set(facts.fetched.outcomes.requirements))


_FOLLOW_UPS: Final = {
    FollowUpKind.CONFIRM: "Brink simulated {many} of {of} again, with other random numbers, to see how often each is "
    "unsafe.",
    FollowUpKind.COMPONENT: "Brink simulated unsafe {many} of {of} again, with ground truth in place of the "
    "component.",
    FollowUpKind.MINIMISE: "Brink reverted differences between {many} of {of} one by one, to find those that matter.",
}
"""What follow-ups ask."""


def purpose(facts: Facts) -> str:
    """Return the question of the campaign, in a sentence for people who have never seen Brink."""
    many, of = f"{noun(facts)}s", facts.finding.of
    if of is not None:
        return _FOLLOW_UPS[of.kind].format(many=many, of=f"campaign {of.campaign} ({of.name})")
    if facts.searched_pairs:
        return (
            f"Brink searched for pairs of {many} that are neighbours, although one is safe and the other is "
            "not: the boundary of what the system can handle runs between them."
        )
    if facts.tolerance is not None:
        return (
            "Brink measured how gross the errors of the component may be before more than "
            f"{facts.tolerance.limit:.0%} of drives violate a requirement because of them."
        )
    if facts.searched_violations:
        return (
            "Brink searched for ways in which other road users make the driving system violate a requirement, as "
            "different from each other as possible."
        )
    if facts.combinations is not None:
        return (
            "Brink searched for changes to the camera image, alone or together, that make the driving unsafe."
        )
    if is_baseline(facts.view.body.algorithm.id):
        return f"Brink drew {many} at random, as a baseline for searches that choose them."
    near = facts.fetched.plan.neighbourhood
    return (
        f"Brink searched for the hazard boundary: {many} around which about {near.p_th:.0%} of similar {many} are "
        "unsafe."
    )


def verdicts(facts: Facts) -> list[str]:
    """Return how many solutions were safe and unsafe, and with respect to which requirements."""
    many, view = f"{noun(facts)}s", facts.fetched.outcomes
    if not facts.evaluated:
        return [
            f"No {noun(facts)} has a verdict{'' if facts.ended else ' yet'}, so there is nothing to report."
        ]
    safe = facts.evaluated - facts.unsafe
    unsafe = (
        f"{facts.unsafe:,} of {count(facts.evaluated, noun(facts))} ({share(facts.unsafe, facts.evaluated)}) "
        f"{'was' if facts.unsafe == 1 else 'were'} unsafe"
    )
    if facts.tolerance is not None:
        told = [
            f"Of {count(facts.evaluated, 'drive')}, with and without errors, {facts.unsafe:,} "
            f"{view.kinds[OutcomeKind.VIOLATED]}."
        ]
        return _of_odd(told, view.odd)
    if not view.requirements:
        how = "computed: chance has no part in them" if facts.computed else "given by the problem itself"
        return _of_odd([f"{unsafe}, {safe:,} safe; the verdicts are {how}."], view.odd)
    these = "this requirement" if len(view.requirements) == 1 else "these requirements"
    told = [f"{unsafe}: {'it' if facts.unsafe == 1 else 'they'} {view.kinds[OutcomeKind.VIOLATED]}."]
    if safe:
        counts = view.words.removesuffix(view.odd).rstrip()
        rest = counts.partition("; ")[2].rstrip(".") if others_recorded(facts) else ""
        more = f"; {rest}" if rest else ""
        others = f"The other {noun(facts)} was" if safe == 1 else f"The other {safe:,} {many} were"
        within = " within the ODD" if view.odd else ""
        told.append(f"{others} safe{within} with regard to {these}{more}.")
    return _of_odd(told, view.odd)


def _of_odd(told: list[str], odd: str) -> list[str]:
    return [*told, odd] if odd else told


def findings(facts: Facts) -> list[str]:
    """Return the findings that match the campaign's purpose, with an example."""
    if not facts.evaluated:
        return []
    told = [f"The result: {facts.finding.words[0].lower()}{facts.finding.words[1:]}"]
    if facts.tolerance is not None:
        if limits := limiting(facts.tolerance):
            told.append(f"Tightest: {' '.join(cell.sentence for cell in limits[:TIGHTEST])}")
        return told
    if facts.violations is not None and facts.violations.types:
        most = facts.violations.types[0]
        which = (
            "The most frequent type"
            if most.avoidable is None
            else f"The most frequent type {most.avoidable.words}"
        )
        told.append(
            f"{which}, in {most.avoided} {noun(facts)}{'' if most.solutions == 1 else 's'}: {most.type}."
        )
    pairs = facts.pairs
    if isinstance(pairs, PairsView) and pairs.pairs and facts.finding.of is None:
        if facts.searched_pairs:
            best = pairs.pairs[0]
            told.append(f"For example, pair {best.place}: {as_sentence(best.words)}.")
        else:
            told.append(f"Without looking for them, it came across {pairs.note}.")
    return told


def limiting(view: ToleranceView) -> list[CellView]:
    """Return the cells with a limit, the tightest first."""
    found = [cell for cell in view.cells if cell.tolerated.finding is Tolerated.LIMIT]
    return sorted(found, key=lambda cell: cell.tolerated.value.severity or 0.0)


def boundary_words(facts: Facts) -> str:
    """Return how many distinct boundary solutions there are."""
    found = facts.boundary
    if not found.dbs:
        return (
            f"No boundary solution was found: no neighbourhood is near enough to the boundary (fitness at most "
            f"{DEFAULT_T_B:g})."
        )
    has = "has" if found.strict_dbs == 1 else "have"
    return (
        f"{count(found.dbs, 'distinct boundary solution')} (fitness at most {DEFAULT_T_B:g}, at least "
        f"{DEFAULT_D_TH:g} apart) {'was' if found.dbs == 1 else 'were'} found; {found.strict_dbs:,} of "
        f"them {has} both safe and unsafe neighbours, and an interval that contains the boundary."
    )


def uncertainties(facts: Facts) -> list[str]:
    """Return the uncertainties of the result."""
    told = []
    if not facts.ended:
        told.append("The campaign has not ended, so all of this may change.")
    if not facts.evaluated:
        return told
    if not facts.computed and facts.tolerance is None:
        told.append(_chance(facts))
    if facts.tolerance is not None:
        view = facts.tolerance
        told.append(
            f"Each limit has an interval that covers the truth with a probability of {view.confidence:.0%}. "
            f"{view.caveat}"
        )
        if view.open:
            told.append(
                f"Of {count(view.open, 'violation')} it is not known yet whether the error caused them; they count "
                "as caused."
            )
    if isinstance(facts.pairs, PairsView) and facts.pairs.caveat:
        caveat = facts.pairs.caveat.removesuffix(facts.fetched.outcomes.odd).rstrip()
        told += [caveat] if caveat else []
    if failed := failures_of(facts.progress):
        told.append(f"{count(failed, 'simulation')} failed; they count as neither safe nor unsafe.")
    if not facts.computed:
        chosen = (
            "Parameters are drawn evenly, which traffic does not do"
            if is_baseline(facts.view.body.algorithm.id)
            else "A search simulates where it expects to learn most"
        )
        told.append(
            f"{chosen}, so shares of simulated drives say nothing about how often something happens in traffic."
        )
    told.append(
        "Nothing was evaluated outside the search space that is listed under “What was not looked at”."
    )
    return told


def _chance(facts: Facts) -> str:
    """Describe the role of chance in the result."""
    pairs = facts.pairs
    if isinstance(pairs, PairsView) and pairs.searched and pairs.distinct:
        if pairs.tried:
            return (
                f"{pairs.confirmed:,} of {count(pairs.tried, 'pair')} that were simulated again with other seeds are "
                f"confirmed, {pairs.refuted:,} are refuted: chance has a part there. "
                f"{pairs.undecided:,} are undecided."
            )
        checked = ""
        if pairs.checked:
            which = "its sides" if pairs.distinct == 1 else f"both sides of {pairs.checked:,} of them"
            checked = f"; the search itself simulated {which} twice"
        some = "it" if pairs.distinct == 1 else "some of them"
        return f"No pair was simulated again after the search, so chance may explain {some}{checked}."
    if facts.repeats:
        return "How often single solutions are unsafe with other seeds is stated below."
    return "Each drive was simulated once, unless stated otherwise, so chance may explain a single verdict."


def trust(facts: Facts) -> list[Term]:
    """Describe how far the result can be trusted, term by term."""
    many = f"{noun(facts)}s"
    terms = []
    if facts.computed:
        terms.append(Term("Chance", "Verdicts are computed, and other seeds do not change them."))
    else:
        terms += _repeated(facts)
    known = facts.progress.known
    if known is not None and known.results:
        left_out = (
            f" {count(known.outside_odd, 'result')} outside the ODD {'was' if known.outside_odd == 1 else 'were'} "
            "left out."
            if known.outside_odd
            else ""
        )
        terms.append(
            Term(
                "Start",
                f"The search began with {count(known.results, 'result')} that it did not simulate, "
                f"{known.unsafe:,} of them unsafe; they count nowhere on this page.{left_out}",
            )
        )
    if facts.control:
        told = " ".join(f"{one}." for one in facts.control)
        terms.append(Term("Control", f"{told} A control shows what scenarios and chance alone explain."))
    terms.append(Term("Random search", _random(facts)))
    terms.append(Term("Failures", _failures(facts)))
    if facts.jobs is not None:
        terms.append(Term("Cache", _cache(facts)))
    terms.append(
        Term(
            "Intervals",
            "Intervals of shares are Wilson intervals of 95%, those of the sides of pairs exact ones of 90%. "
            f"They say how sure a share of these {many} is, not how often something happens in traffic.",
        )
    )
    return terms


def _repeated(facts: Facts) -> list[Term]:
    terms = []
    pairs = facts.pairs
    if isinstance(pairs, PairsView) and pairs.distinct and facts.tolerance is None:
        if pairs.tried or pairs.pending:
            pending = f", {pairs.pending:,} are being simulated" if pairs.pending else ""
            words = (
                f"Simulated again with other seeds: {pairs.tried:,} of {count(pairs.distinct, 'pair')}. "
                f"{pairs.confirmed:,} confirmed, {pairs.refuted:,} refuted, {pairs.undecided:,} undecided{pending}. "
                f"Confirmed means that the safe side is unsafe with a probability of at most "
                f"{pairs.rule.safe_at_most:.0%}, and the unsafe side with one of at least "
                f"{pairs.rule.unsafe_at_least:.0%}; "
                f"the error rate of either claim is {pairs.rule.error:.0%}."
            )
        else:
            words = "No pair has been simulated again with other seeds after the search."
        terms.append(Term("Confirmation", words))
        if facts.fetched.plan.problem.has_component:
            terms.append(Term("Component", _component(pairs)))
        if pairs.chance:
            terms.append(Term("Chance", " ".join(f"{words}." for words in pairs.chance)))
    terms += [Term("Repeats", f"{as_sentence(one.words)}") for one in facts.repeats if one.boundary]
    if not terms:
        terms.append(
            Term(
                "Repeats",
                "Nothing has been simulated again with other seeds, so chance may explain a verdict.",
            )
        )
    if facts.tolerance is not None and facts.tolerance.audited:
        view = facts.tolerance
        terms.append(
            Term(
                "Screening",
                "Drives that hold with the grossest error are taken to hold with milder ones. Of "
                f"{view.audited:,} that were simulated with milder ones all the same, {view.leaks:,} violated a "
                "requirement.",
            )
        )
    return terms


def _component(pairs: PairsView) -> str:
    if not pairs.component + pairs.scenario:
        return "It was not asked whether the component or the scenario is to blame for the unsafe sides."
    asked = pairs.component + pairs.scenario
    rest = f"; for {pairs.scenario:,}, the scenario alone is enough" if pairs.scenario else ""
    confirmed = pairs.component_confirmed + pairs.scenario_confirmed
    sure = (
        f" Of the confirmed pairs among them, it is {pairs.component_confirmed:,} of {confirmed:,}."
        if confirmed
        else " None of these pairs is confirmed."
    )
    return (
        f"With ground truth in place of the component, the unsafe side of {pairs.component:,} of "
        f"{count(asked, 'pair')} is safe: there the component is to blame{rest}. Judged in one drive each, with the "
        f"seed of the search.{sure}"
    )


def _random(facts: Facts) -> str:
    if is_baseline(facts.view.body.algorithm.id):
        return "This campaign is random search itself: it needs no other baseline."
    if not facts.random:
        return (
            f"None of the latest {LISTED} finished campaigns of this database is a random search on the same "
            "problem, so it is not known how much of this random draws would have found."
        )
    best = facts.random[0]
    part = share(best.campaign.unsafe, best.evaluated)
    unsafe = f"{best.campaign.unsafe:,} of {best.evaluated:,} evaluated were unsafe ({part})"
    found = f"; it found {best.found} with the same settings" if best.found else ""
    return (
        f"Campaign {best.campaign.id} drew at random on the same problem: {unsafe}{found}. This campaign evaluated "
        f"{facts.evaluated:,}."
    )


def _failures(facts: Facts) -> str:
    progress = facts.progress
    failed = failures_of(progress)
    if not failed and not progress.quarantined:
        return f"None of {count(progress.simulations, 'simulation')} failed."
    waiting = f"; {progress.quarantined:,} wait in quarantine" if progress.quarantined else ""
    return (
        f"{failed:,} of {count(progress.simulations, 'simulation')} failed and have no verdict{waiting}. "
        "What fails may be unsafe, too."
    )


def _cache(facts: Facts) -> str:
    jobs = facts.jobs
    if jobs is None or not jobs.simulated + jobs.cached:
        return "No result has been reported."
    again = f" {count(jobs.repeated, 'job')} took more than one attempt." if jobs.repeated else ""
    if not jobs.cached:
        return f"No result was taken over from another campaign: all were simulated for this one.{again}"
    return (
        f"{jobs.cached:,} of {count(jobs.simulated + jobs.cached, 'result')} "
        f"{'was' if jobs.cached == 1 else 'were'} taken over from identical simulations, with the same seed, of this "
        f"database.{again}"
    )


def requirement_words(requirement: str) -> str:
    """Return the text of a requirement from its plug-in; empty if it has none."""
    try:
        plugin = load_plugin(REQUIREMENTS, requirement)
    except (KeyError, SimulatorError):
        return ""
    first = (plugin.__doc__ or "").strip().partition("\n\n")[0]
    words = re.sub(r"^`[^`]+`:\s*", "", " ".join(first.split()))
    return as_sentence(words.replace("`", ""))


def ranges(columns: Sequence[ParameterColumn]) -> list[Range]:
    """Return the varied parameters; those whose titles differ only in digits share a row.

    Of the choices of a parameter, these are the ones that occurred: a search may have left out others.

    Args:
        columns: All parameters with their values in the evaluated solutions.
    """
    return _together([one for one in columns if len(_used(one)) > 1])


def constants(columns: Sequence[ParameterColumn]) -> list[Range]:
    """Return the parameters that had one value in all evaluated solutions, or were never active."""
    return _together([one for one in columns if len(_used(one)) < 2])


def _used(column: ParameterColumn) -> FloatArray:
    """Return the different values of a parameter where it was active."""
    return np.unique(column.values[column.active])


def _together(columns: Sequence[ParameterColumn]) -> list[Range]:
    found: dict[tuple[str, str, str], list[str]] = {}
    for column in columns:
        name = column.parameter.title or column.parameter.name
        pattern = re.sub(r"\d+", "*", name)
        found.setdefault((column.component, pattern, _values(column)), []).append(name)
    return [
        Range(component, names[0] if len(names) == 1 else f"{pattern} ({len(names)} parameters)", values)
        for (component, pattern, values), names in found.items()
    ]


def _values(column: ParameterColumn) -> str:
    parameter, used = column.parameter, _used(column)
    if not len(used):
        return "had no part"
    if not isinstance(parameter, Categorical):
        kind = parameter.unit or "(no unit)"
        if len(used) == 1:
            return f"{used[0]:g} {kind}"
        return f"{parameter.least:g} to {parameter.most:g} {kind}"
    choices = [str(parameter.choices[int(index)]) for index in used]
    if len(choices) <= MOST_CHOICES:
        return ", ".join(choices)
    return f"{', '.join(choices[:MOST_CHOICES])} and {len(choices) - MOST_CHOICES} more"


def fixed(facts: Facts) -> list[tuple[str, str, str]]:
    """Return all that was constant: settings of the problem, and parameters with one value; with units."""
    problem, params = facts.fetched.plan.problem, facts.view.body.problem.params
    about: dict[str, Mapping[str, Any]] = {
        field.name: field.metadata for field in dataclasses.fields(problem.params_type)
    }
    rows = [
        (name, _value(value, one.get("unit", "")), str(one.get("help", "")))
        for name, value in params.items()
        if name != ODD
        for one in [about.get(name, {})]
    ]
    if words := odd_words(problem.space):
        rows.append(("odd", words, "The operational design domain, to which the search was limited."))
    for one in constants(facts.columns) if facts.evaluated else ():
        same = f"{one.component}: in no {noun(facts)}" if one.values == "had no part" else one.values
        rows.append((one.names.replace("_", " "), same, f"{one.component}: the same in all {noun(facts)}s"))
    return rows


def _value(value: object, unit: str = "") -> str:
    if isinstance(value, Mapping):
        shown = ", ".join(f"{name}: {item}" for name, item in value.items()) or "none"
    elif isinstance(value, Sequence) and not isinstance(value, str):
        shown = ", ".join(map(str, value)) or "none"
    else:
        shown = str(value)
    if len(shown) > LONGEST_VALUE:
        return f"{shown[:LONGEST_VALUE]}… (see the campaign file)"
    return f"{shown} {unit}".strip()


def standing(facts: Facts) -> str:
    """Explain why the report is not final; empty if the campaign has finished."""
    progress = facts.progress
    done = f"{progress.simulations:,} of {count(progress.budget, 'simulation')}"
    reason = f" Reason: {progress.status_reason.removesuffix('.')}." if progress.status_reason else ""
    if facts.left_out:
        reason += (
            f" {count(facts.left_out, 'simulation')} of a generation that is not complete "
            f"{'is' if facts.left_out == 1 else 'are'} left out below."
        )
    match progress.status:
        case CampaignStatus.FINISHED:
            return ""
        case CampaignStatus.RUNNING | CampaignStatus.PAUSED:
            what = "is still running" if progress.status is CampaignStatus.RUNNING else "is paused"
            return f"Unfinished: the campaign {what}, after {done}. This report shows what is known so far.{reason}"
        case CampaignStatus.CANCELLED:
            return f"The campaign was cancelled after {done}; this report shows what had been found by then.{reason}"
        case _:
            return f"The campaign has failed after {done}; this report shows what had been found by then.{reason}"
