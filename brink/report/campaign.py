"""The report of a campaign: one HTML page, for people who have never seen Brink.

The page is complete in itself: pictures and style are part of it, nothing is loaded, and no script is needed to read
it. The same finished campaign gives the same page.
"""

import asyncio
from collections import Counter
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import yaml

from brink import __version__
from brink.api.client import Api
from brink.report.campaign_facts import Facts, Show, fetch_facts
from brink.report.campaign_pictures import draw_pictures, shown_pairs
from brink.report.campaign_sections import (
    Album,
    Table,
    boundary_section,
    combinations_section,
    detector_section,
    outcomes_section,
    pairs_section,
    tolerance_section,
    violations_section,
)
from brink.report.campaign_words import (
    Range,
    Term,
    count,
    findings,
    fixed,
    noun,
    others_recorded,
    purpose,
    ranges,
    requirement_words,
    share,
    standing,
    subject,
    trust,
    uncertainties,
    verdicts,
)
from brink.report.tables import finding_section
from brink.report.text import page_template
from brink.search.analysis.combinations import MIN_PLACES
from brink.server.findings.pairs.views import DEFAULT_CONFIRMATIONS, PairsView
from brink.server.findings.tolerances.views import ToleranceView, Tolerated
from brink.server.problems.base import SimulatedProblem
from brink.server.states import CampaignStatus, OutcomeKind

MOST_PAIRS: Final = 6
WITH_SECTION: Final = ("pairs", "tolerances", "violations", "combinations", "boundary", "verdicts")
"""Kinds of findings whose section has pictures or more; any other is told by its sentence and its tables."""
MOST_PARAMETERS: Final = 40
LONGEST_FILE: Final = 12_000
"""Letters of a campaign file that are printed; the file of repeats may have thousands of numbers."""


async def campaign_report(
    api: Api,
    campaign: str,
    *,
    pictures: Mapping[str, Path] | None = None,
    most_pairs: int = MOST_PAIRS,
    episodes: str | None = None,
    workers: bool = False,
    show: Show = lambda _what, _done, _total: None,
) -> str:
    """Return the report of a campaign as an HTML page that is complete in itself.

    Args:
        api: Coordinator of the campaign.
        campaign: Id of the campaign, or a unique prefix of it.
        pictures: Pictures that were drawn before, by file name, such as ``pair-1.png``; no others are shown then.
            None draws them.
        most_pairs: Most pairs to show in full; the others are in a table.
        episodes: Id of a campaign with a detector in the loop, to check against tolerances; None for none.
        workers: Whether the coordinator's workers run episodes again for pictures; otherwise this machine does.
        show: Called with what is being done, in words, how much of it is done, and how much there is; 0 if that is
            unknown.

    Raises:
        CoordinatorError: The campaign does not exist.
        InvalidInput: Its problem or algorithm is not installed here.
    """
    facts = await fetch_facts(api, campaign, show, episodes=episodes)
    if pictures is not None:
        return await asyncio.to_thread(compose, facts, pictures, most_pairs=most_pairs)
    with TemporaryDirectory(prefix="brink-report-") as folder:
        drawn = await draw_pictures(
            api, facts, Path(folder), most_pairs=most_pairs, workers=workers, show=show
        )
        return await asyncio.to_thread(compose, facts, drawn, most_pairs=most_pairs)


def compose(facts: Facts, pictures: Mapping[str, Path], *, most_pairs: int = MOST_PAIRS) -> str:
    """Return the report of a campaign as an HTML page.

    Args:
        facts: What is known of the campaign.
        pictures: Its pictures, by file name; those that are missing are left out.
        most_pairs: Most pairs to show in full.
    """
    album = Album(pictures)
    full = shown_pairs(facts, most_pairs)
    pairs = pairs_section(facts, album, full)
    searched = facts.searched_pairs
    sections = [
        pairs if searched else None,
        tolerance_section(facts, album),
        detector_section(facts, album),
        violations_section(facts, album),
        combinations_section(facts, album),
        boundary_section(facts, album),
        None if searched else pairs,
        *(
            finding_section(finding, facts.view.id)
            for finding in facts.finding.findings
            if finding.kind not in WITH_SECTION and not finding.is_empty
        ),
        outcomes_section(facts),
    ]
    return page_template("campaign.html").render(
        title=facts.view.name,
        subject=subject(facts),
        standing=standing(facts),
        version=__version__,
        found=[purpose(facts), *verdicts(facts), *findings(facts)],
        uncertain=uncertainties(facts),
        requirements=[Term(name, requirement_words(name)) for name in facts.fetched.outcomes.requirements],
        others_recorded=others_recorded(facts),
        figures=_key_figures(facts),
        noun=noun(facts),
        sections=[section for section in sections if section is not None],
        trust=trust(facts),
        space=_space(facts),
        fixed=_fixed(facts),
        computed=_computed(facts),
        file=_campaign_file(facts),
        commands=_commands(facts),
        tags=facts.view.tags,
        notes=facts.view.notes,
    )


def write_page(file: Path, page: str) -> int:
    """Write a page to a file, which appears only when it is complete; return its size in bytes."""
    data = page.encode()
    part = file.with_name(f".{file.name}.part")
    try:
        part.write_bytes(data)
        part.replace(file)
    finally:
        part.unlink(missing_ok=True)
    return len(data)


def _key_figures(facts: Facts) -> list[Term]:
    """Return the key figures, each with its caption."""
    if not facts.evaluated:
        return []
    view = facts.fetched.outcomes
    unsafe = view.kinds[OutcomeKind.VIOLATED] if view.requirements else "unsafe"
    verb = "simulated" if facts.drives else "evaluated"
    told = [Term(f"{facts.evaluated:,}", f"{noun(facts)}s {verb}, with a verdict")]
    if facts.tolerance is None:
        told.append(Term(share(facts.unsafe, facts.evaluated), f"of these {unsafe}"))
    pairs = facts.pairs
    if facts.searched_pairs and isinstance(pairs, PairsView):
        distinct = "distinct pair" if pairs.distinct == 1 else "distinct pairs"
        told.append(Term(f"{pairs.distinct:,}", f"{distinct}: neighbours, one safe, one unsafe"))
        if pairs.tried:
            told.append(Term(f"{pairs.confirmed:,} of {pairs.tried:,}", "pairs confirmed with other seeds"))
        told += _blamed_figures(pairs)
    elif facts.tolerance is not None:
        told += _tolerance_figures(facts.tolerance)
    elif facts.violations is not None:
        told.append(Term(f"{len(facts.violations.types):,}", "types of violations"))
    elif facts.combinations is not None:
        chains = facts.combinations.combinations
        judged = [one for one in chains if one.trials >= MIN_PLACES]
        hazardous = sum(one.hazardous for one in judged)
        told.append(
            Term(
                f"{hazardous:,} of {len(judged):,}",
                f"chains of changes hazardous, driven in {MIN_PLACES} streets or more",
            )
        )
    elif "boundary" in facts.progress.finds:
        solutions = "distinct boundary solution" + ("" if facts.boundary.dbs == 1 else "s")
        told.append(Term(f"{facts.boundary.dbs:,}", solutions))
    return told


def _blamed_figures(pairs: PairsView) -> list[Term]:
    """Return for how many pairs the component is to blame: of the confirmed ones, if there are any."""
    blamed, asked, which = pairs.component, pairs.component + pairs.scenario, "pairs, confirmed or not"
    if confirmed := pairs.component_confirmed + pairs.scenario_confirmed:
        blamed, asked, which = pairs.component_confirmed, confirmed, "confirmed pairs"
    if not asked:
        return []
    return [
        Term(f"{blamed:,} of {asked:,}", f"{which}: the component is to blame, judged with one seed each")
    ]


def _tolerance_figures(view: ToleranceView) -> list[Term]:
    found = Counter(cell.tolerated.finding for cell in view.cells)
    return [
        Term(f"{found[Tolerated.LIMIT]:,} of {len(view.cells):,}", "cells with a limit within the scale"),
        Term(f"{found[Tolerated.THROUGHOUT]:,}", "cells in which no limit was found"),
        Term(f"{found[Tolerated.UNDECIDED]:,}", "cells undecided"),
    ]


def _space(facts: Facts) -> Table | None:
    if not facts.evaluated:
        return None
    found: list[Range] = ranges(facts.columns)
    rows = [
        (one.component.replace("_", " "), one.names.replace("_", " "), one.values)
        for one in found[:MOST_PARAMETERS]
    ]
    more = len(found) - len(rows)
    return Table(
        label="What was varied",
        columns=("component", "parameter", "range"),
        rows=rows,
        more=f"{more} more" if more else "",
    )


def _fixed(facts: Facts) -> Table | None:
    rows = fixed(facts)
    if not rows:
        return None
    return Table(label="What was not varied", columns=("parameter", "value", "meaning"), rows=rows)


def _computed(facts: Facts) -> list[Term]:
    view, progress, problem = facts.view, facts.progress, facts.fetched.plan.problem
    provenance = (facts.sample.provenance if facts.sample is not None else None) or {}
    versions = {"brink": __version__, **provenance}
    told = [
        Term("Campaign", f"{view.id} ({view.name})"),
        Term("Problem", f"{view.body.problem.id}: {problem.summary}"),
        Term("Algorithm", f"{view.body.algorithm.id}: {facts.fetched.plan.algorithm.summary}"),
        Term("Budget", f"{count(view.budget, 'simulation')}, of which {progress.simulations:,} were made"),
        Term("Seed", f"{view.body.seed}"),
        Term("Submitted", _moment(view.created_at)),
    ]
    if view.finished_at is not None:
        told.append(Term("Ended", _moment(view.finished_at)))
    told.append(
        Term("Time", f"{progress.elapsed_s:,.0f} s from submission to {'end' if facts.ended else 'now'}")
    )
    if isinstance(problem, SimulatedProblem):
        told.append(Term("Simulator", str(provenance.get("simulator", problem.needs))))
        told.append(Term("Workers", "not recorded: results do not depend on how many there are"))
    known = [
        f"{name} {versions[name]}" for name in ("brink", "python", "numpy", "pybullet") if name in versions
    ]
    told.append(Term("Versions", ", ".join(known)))
    if "instruction_set" in provenance:
        told.append(
            Term(
                "Arithmetic",
                f"{provenance['instruction_set']}: machines with the same value agree bit for bit",
            )
        )
    if progress.digest:
        told.append(Term("Archive", f"SHA-256 {progress.digest}"))
    return told


def _moment(moment: datetime) -> str:
    return f"{moment.astimezone(UTC):%Y-%m-%d %H:%M:%S} UTC"


def _campaign_file(facts: Facts) -> str:
    """Return the campaign file, with every parameter spelled out; empty if it is too long to print."""
    document = facts.view.body.document()
    for name in ("llm", "repeats", "ground_truth", "start_from"):
        if not document[name]:
            del document[name]
    text = yaml.safe_dump(document, sort_keys=False, allow_unicode=True, width=100)
    return text if len(text) <= LONGEST_FILE else ""


def _again(facts: Facts) -> str:
    """Describe the result of running the campaign file again."""
    body, digest = facts.view.body, facts.progress.digest
    if body.llm is not None:
        return "run it again; a language model may answer differently, and then the search differs, too"
    start = body.start_from
    from_campaign = start is not None and start.campaign
    where = f", in a database that has campaign {from_campaign}," if from_campaign else ""
    same = "the same file gives the same archive"
    if facts.progress.status is CampaignStatus.FINISHED and digest:
        same += f", so its digest must be {digest[:12]}…"
    return f"simulate it again{where}: {same}"


def _commands(facts: Facts) -> list[Term]:
    """Return commands with their purposes."""
    campaign, pairs, told = facts.view.id, facts.pairs, []
    if _campaign_file(facts):
        told.append(Term("brink run campaign.yaml --workers 2", _again(facts)))
    if isinstance(pairs, PairsView) and pairs.distinct and not facts.computed and not pairs.tried:
        options = f"--confirm {DEFAULT_CONFIRMATIONS}"
        if facts.fetched.plan.problem.has_component:
            options += " --component"
        told.append(Term(f"brink pairs {campaign} {options}", "ask whether the pairs hold with other seeds"))
    elif facts.boundary.dbs and not facts.computed and not facts.repeats and not facts.searched_pairs:
        told.append(Term(f"brink repeats {campaign}", "simulate the boundary again with other seeds"))
    told.append(
        Term(
            f"brink export {campaign} --out campaign.brink", "hand on all results, for brink import elsewhere"
        )
    )
    told.append(Term(f"brink report {campaign} --out report.html", "write this page again"))
    return told
