"""Sentences of a campaign's report: the question, the findings, their certainty, and what was left out."""

import dataclasses
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from brink.api.live import failures_of
from brink.report.campaign_facts import LISTED, Facts
from brink.report.kind_pictures import KindPictures
from brink.search.analysis.dependence import ParameterColumn
from brink.search.distribution import distribution_words
from brink.search.odd import odd_words
from brink.search.parameters import Categorical
from brink.search.space import FloatArray
from brink.server.campaigns.follow_ups.question import question_of
from brink.server.findings.finding import Role, Term
from brink.server.findings.table import share_text
from brink.server.findings.words import as_sentence, counted, full_sentence
from brink.server.problems.base import Problem, SimulatedProblem
from brink.server.problems.catalogue import DISTRIBUTION, ODD, is_baseline
from brink.server.states import CampaignStatus, OutcomeKind, Selection
from brink.sim.catalogue import REQUIREMENTS, load_plugin
from brink.sim.errors import SimulatorError

MOST_CHOICES: Final = 12
"""Choices of a parameter that are listed by name."""
LONGEST_VALUE: Final = 100


@dataclass(frozen=True, slots=True)
class Range:
    """Parameters of the search space with the same range."""

    component: str
    names: str
    values: str


def share(part: int, whole: int) -> str:
    """Return a share in per cent, which is never rounded to none or all."""
    return share_text(part / whole) if whole else "–"


def subject(facts: Facts) -> str:
    """Return what was tested, in a few words."""
    return facts.fetched.plan.problem.summary.partition(":")[0].rstrip(".")


def others_recorded(facts: Facts) -> bool:
    """Return whether requirements were recorded that do not decide the verdict."""
    recorded = (facts.sample.verdicts if facts.sample is not None else None) or {}
    return bool(recorded.keys() - set(facts.fetched.outcomes.requirements))


def purpose(facts: Facts) -> str:
    """Return what the campaign asked, in a sentence for people who have never seen Brink."""
    many, of = f"{facts.noun}s", facts.finding.of
    if of is not None:
        return question_of(of.kind).purpose.format(many=many, of=f"campaign {of.campaign} ({of.name})")
    if is_baseline(facts.view.body.algorithm.id):
        return f"Brink drew {many} at random, as a baseline for searches that choose them."
    return next((one.purpose for one in facts.finding.findings), "")


def verdicts(facts: Facts) -> list[str]:
    """Return how many solutions were safe and unsafe, and with respect to which requirements."""
    many, view = f"{facts.noun}s", facts.fetched.outcomes
    if not facts.evaluated:
        return [
            f"No {facts.noun} has a verdict{'' if facts.ended else ' yet'}, so there is nothing to report."
        ]
    safe = facts.evaluated - facts.unsafe
    unsafe = (
        f"{facts.unsafe:,} of {counted(facts.evaluated, facts.noun)} ({share(facts.unsafe, facts.evaluated)}) "
        f"{'was' if facts.unsafe == 1 else 'were'} unsafe"
    )
    if facts.finding.exclusive:
        words = (
            f"Of {counted(facts.evaluated, facts.noun)}, {facts.unsafe:,} {view.kinds[OutcomeKind.VIOLATED]}."
        )
        return _of_odd([words], view.odd)
    if not view.requirements:
        how = "computed: they are deterministic" if facts.computed else "given by the problem itself"
        return _of_odd([f"{unsafe}, {safe:,} safe; the verdicts are {how}."], view.odd)
    these = "this requirement" if len(view.requirements) == 1 else "these requirements"
    told = [f"{unsafe}: {'it' if facts.unsafe == 1 else 'they'} {view.kinds[OutcomeKind.VIOLATED]}."]
    if safe:
        counts = view.words.removesuffix(view.odd).rstrip()
        rest = counts.partition("; ")[2].rstrip(".") if others_recorded(facts) else ""
        more = f"; {rest}" if rest else ""
        others = f"The other {facts.noun} was" if safe == 1 else f"The other {safe:,} {many} were"
        within = " within the ODD" if view.odd else ""
        told.append(f"{others} safe{within} with regard to {these}{more}.")
    return _of_odd(told, view.odd)


def _of_odd(told: list[str], odd: str) -> list[str]:
    return [*told, odd] if odd else told


def findings(facts: Facts) -> list[str]:
    """Return what the campaign found of what it looked for, with examples, and what it came across."""
    if not facts.evaluated:
        return []
    told = [f"The result: {facts.finding.words[0].lower()}{facts.finding.words[1:]}"]
    if facts.finding.of is not None:
        return told
    for one in facts.found:
        if one.role is Role.SOUGHT and one.example:
            told.append(full_sentence(one.example))
        elif one.role is Role.MET:
            told.append(f"Without looking for it, it came across {one.sentence}.")
    return told


def figures(facts: Facts) -> list[Term]:
    """Return the numbers that matter, each with what it is of."""
    if not facts.evaluated:
        return []
    view = facts.fetched.outcomes
    verb = "simulated" if facts.drives else "evaluated"
    told = [Term(term=f"{facts.evaluated:,}", words=f"{facts.noun}s {verb}, with a verdict")]
    if not facts.finding.exclusive:
        unsafe = view.kinds[OutcomeKind.VIOLATED] if view.requirements else "unsafe"
        told.append(Term(term=share(facts.unsafe, facts.evaluated), words=f"of these {unsafe}"))
    return told + [figure for one in facts.found if one.role is Role.SOUGHT for figure in one.figures]


def uncertainties(facts: Facts) -> list[str]:
    """Return the uncertainties of the result."""
    told = []
    if not facts.ended:
        told.append("The campaign has not ended, so all of this may change.")
    if not facts.evaluated:
        return told
    caveats = [full_sentence(words) for one in facts.found for words in one.caveats]
    if not caveats and not facts.computed:
        caveats.append(
            "How often single solutions are unsafe with other seeds is stated below."
            if facts.repeats
            else "Each drive was simulated once, unless stated otherwise, so chance may explain a single verdict."
        )
    told += caveats
    if failed := failures_of(facts.progress):
        told.append(f"{counted(failed, 'simulation')} failed; they count as neither safe nor unsafe.")
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
        "Nothing was evaluated outside the search space that is listed under “What was not examined”."
    )
    return told


def trust(facts: Facts, pictures: Mapping[str, KindPictures]) -> list[Term]:
    """Return how far the result can be trusted, term by term.

    Args:
        facts: The facts about the campaign.
        pictures: Sentences that only some kinds of findings have.
    """
    many = f"{facts.noun}s"
    terms = []
    if facts.computed:
        terms.append(Term(term="Chance", words="Verdicts are computed, and other seeds do not change them."))
    else:
        terms += [term for one in facts.found for term in one.trust]
        terms += [
            Term(term="Repeats", words=as_sentence(one.words))
            for one in facts.repeats
            if one.selection is Selection.BOUNDARY
        ]
        if not terms:
            words = "Nothing has been simulated again with other seeds, so chance may explain a verdict."
            terms.append(Term(term="Repeats", words=words))
    known = facts.progress.known
    if known is not None and known.results:
        left_out = (
            f" {counted(known.outside_odd, 'result')} outside the ODD {'was' if known.outside_odd == 1 else 'were'} "
            "left out."
            if known.outside_odd
            else ""
        )
        terms.append(
            Term(
                term="Start",
                words=f"The search began with {counted(known.results, 'result')} that it did not simulate, "
                f"{known.unsafe:,} of them unsafe; this page does not count them.{left_out}",
            )
        )
    terms += [term for one in pictures.values() for term in one.trust]
    elsewhere = next((one.elsewhere for one in pictures.values() if one.elsewhere), "")
    terms.append(Term(term="Random search", words=_random(facts, elsewhere)))
    terms.append(Term(term="Failures", words=_failures(facts)))
    if facts.jobs is not None:
        terms.append(Term(term="Cache", words=_cache(facts)))
    terms.append(
        Term(
            term="Intervals",
            words="Intervals of shares are Wilson intervals of 95%, those of the sides of pairs exact ones of 90%. "
            f"They say how sure a share of these {many} is, not how often something happens in traffic.",
        )
    )
    return terms


def _random(facts: Facts, elsewhere: str) -> str:
    if is_baseline(facts.view.body.algorithm.id):
        return "This campaign is random search itself: it needs no other baseline."
    if not facts.random:
        return (
            f"None of the latest {LISTED} finished campaigns of this database is a random search on the same "
            "problem, so it is not known how much of this random draws would have found."
        )
    best = facts.random[0]
    evaluated = best.simulations - best.failed - best.measured
    unsafe = f"{best.unsafe:,} of {evaluated:,} evaluated were unsafe ({share(best.unsafe, evaluated)})"
    found = f"; it found {elsewhere} with the same settings" if elsewhere else ""
    return (
        f"Campaign {best.id} drew at random on the same problem: {unsafe}{found}. This campaign evaluated "
        f"{facts.evaluated:,}."
    )


def _failures(facts: Facts) -> str:
    progress = facts.progress
    failed = failures_of(progress)
    if not failed and not progress.quarantined:
        return f"None of {progress.simulations:,} simulations failed."
    waiting = f"; {progress.quarantined:,} wait in quarantine" if progress.quarantined else ""
    return (
        f"{failed:,} of {counted(progress.simulations, 'simulation')} failed and have no verdict{waiting}. "
        "What fails may be unsafe, too."
    )


def _cache(facts: Facts) -> str:
    jobs = facts.jobs
    if jobs is None or not jobs.simulated + jobs.cached:
        return "No result has been reported."
    again = f" {counted(jobs.repeated, 'job')} took more than one attempt." if jobs.repeated else ""
    if not jobs.cached:
        return f"No result was taken over from another campaign: all were simulated for this one.{again}"
    return (
        f"{jobs.cached:,} of {counted(jobs.simulated + jobs.cached, 'result')} "
        f"{'was' if jobs.cached == 1 else 'were'} taken over from identical simulations, with the same seed, of this "
        f"database.{again}"
    )


def requirement_words(requirement: str, problem: Problem) -> str:
    """Return a requirement's formula, or the text of its plug-in; empty if it has none."""
    stated = problem.formulas.get(requirement) if isinstance(problem, SimulatedProblem) else None
    if isinstance(stated, dict):
        return f"{stated['stl']} (robustness in {stated['unit']})"
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
        if name not in (ODD, DISTRIBUTION)
        for one in [about.get(name, {})]
    ]
    if words := odd_words(problem.space):
        rows.append(("odd", words, "The operational design domain, to which the search was limited."))
    if problem.space.distribution is not None:
        words = distribution_words(problem.space)
        rows.append((DISTRIBUTION, words, "How often values occur in operation, as stated."))
    for one in constants(facts.columns) if facts.evaluated else ():
        same = f"{one.component}: in no {facts.noun}" if one.values == "had no part" else one.values
        rows.append((one.names.replace("_", " "), same, f"{one.component}: the same in all {facts.noun}s"))
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
    done = f"{progress.simulations:,} of {counted(progress.budget, 'simulation')}"
    reason = f" Reason: {progress.status_reason.removesuffix('.')}." if progress.status_reason else ""
    if facts.left_out:
        reason += (
            f" {counted(facts.left_out, 'simulation')} of a generation that is not complete "
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
