"""The report of a campaign: one HTML page, for people who have never seen Brink.

The page is complete in itself: pictures and style are part of it, nothing is loaded, and no script is needed to read
it. The same finished campaign gives the same page.
"""

import asyncio
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import yaml

from brink import __version__
from brink.api.client import Api
from brink.api.results import TRACE_TIMEOUT_S
from brink.report.campaign_facts import Facts, Show, fetch_facts
from brink.report.campaign_sections import Album, Section, finding_section, map_section
from brink.report.campaign_words import (
    Range,
    figures,
    findings,
    fixed,
    others_recorded,
    purpose,
    ranges,
    requirement_words,
    standing,
    subject,
    trust,
    uncertainties,
    verdicts,
)
from brink.report.detector import COLUMNS, NUMBERS, evidence, row_of, small_print
from brink.report.figures import Drawing
from brink.report.kind_pictures import KindPictures, draw_pictures, read_pictures
from brink.report.limits import MOST_PAIRS
from brink.report.page import page_template
from brink.server.findings.finding import Term
from brink.server.findings.table import Column, Format, Table
from brink.server.findings.tolerances.views import DetectorView
from brink.server.findings.words import counted
from brink.server.problems.base import SimulatedProblem
from brink.server.states import CampaignStatus

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
    kinds = await read_pictures(api, facts, most_pairs)
    if pictures is not None:
        return await asyncio.to_thread(_compose, facts, kinds, pictures)
    with TemporaryDirectory(prefix="brink-report-") as folder:
        drawing = Drawing(
            api=api,
            campaign=facts.view.id,
            folder=Path(folder),
            stop=asyncio.Event(),
            timeout_s=TRACE_TIMEOUT_S,
            workers=workers,
            show=show,
        )
        drawn = await draw_pictures(drawing, facts, kinds)
        return await asyncio.to_thread(_compose, facts, kinds, drawn)


def _compose(facts: Facts, kinds: Mapping[str, KindPictures], pictures: Mapping[str, Path]) -> str:
    """Return the report of a campaign as an HTML page.

    Args:
        facts: The facts about the campaign.
        kinds: The pictures that only some kinds of its findings have.
        pictures: The files of all pictures, by name; those that are missing are left out.
    """
    album = Album(pictures)
    sections = [kinds[one.kind].illustrate(finding_section(one, facts.view.id), album) for one in facts.found]
    others = [detector_section(facts.detector, album)]
    if not facts.finding.exclusive:
        others.append(map_section(facts.rules, facts.fetched.plan.problem.space.titles(), album))
    sections[1:1] = [one for one in others if one is not None]
    return page_template("campaign.html").render(
        title=facts.view.name,
        subject=subject(facts),
        standing=standing(facts),
        version=__version__,
        found=[purpose(facts), *verdicts(facts), *findings(facts)],
        uncertain=uncertainties(facts),
        requirements=[
            Term(term=name, words=requirement_words(name, facts.fetched.plan.problem))
            for name in facts.fetched.outcomes.requirements
        ],
        others_recorded=others_recorded(facts),
        figures=figures(facts),
        noun=facts.noun,
        sections=sections,
        trust=trust(facts, kinds),
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


def detector_section(view: DetectorView | None, album: Album) -> Section | None:
    """Return whether the detector of another campaign meets the requirement; None if none was named."""
    if view is None:
        return None
    words = "Shares of drives that errors of this size make violate, against the limit"
    columns = [_column(name, right=name in NUMBERS) for name in COLUMNS]
    rows = [list(row_of(cell)) for cell in evidence(view)]
    return Section(
        title=f"Does {view.detector} meet the requirement?",
        paragraphs=[f"{view.note}.", view.meaning, *small_print(view)],
        pictures=album("detector.png", words),
        lists=[("What to record next", [f"{words}." for words in view.next])] if view.next else [],
        tables=[Table(name="detector", title="Results of the detector", columns=columns, rows=rows)],
    )


def _column(name: str, *, right: bool = False) -> Column:
    """Return a column of texts."""
    return Column(name=name, title=name, format=Format.NUMBER if right else Format.TEXT)


def _space(facts: Facts) -> Table | None:
    if not facts.evaluated:
        return None
    found: list[Range] = ranges(facts.columns)
    return Table(
        name="space",
        title="What was varied",
        columns=[_column(name) for name in ("component", "parameter", "range")],
        rows=[
            [one.component.replace("_", " "), one.names.replace("_", " "), one.values]
            for one in found[:MOST_PARAMETERS]
        ],
        left_out=max(0, len(found) - MOST_PARAMETERS),
    )


def _fixed(facts: Facts) -> Table | None:
    rows = [list(row) for row in fixed(facts)]
    columns = [_column(name) for name in ("parameter", "value", "meaning")]
    return (
        Table(name="fixed", title="What was not varied", columns=columns, rows=list(rows)) if rows else None
    )


def _computed(facts: Facts) -> list[Term]:
    view, progress, problem = facts.view, facts.progress, facts.fetched.plan.problem
    provenance = (facts.sample.provenance if facts.sample is not None else None) or {}
    versions = {"brink": __version__, **provenance}
    told = [
        Term(term="Campaign", words=f"{view.id} ({view.name})"),
        Term(term="Problem", words=f"{view.body.problem.id}: {problem.summary}"),
        Term(term="Algorithm", words=f"{view.body.algorithm.id}: {facts.fetched.plan.algorithm.summary}"),
        Term(
            term="Budget",
            words=f"{counted(view.budget, 'simulation')}, of which {progress.simulations:,} were made",
        ),
        Term(term="Seed", words=f"{view.body.seed}"),
        Term(term="Submitted", words=_moment(view.created_at)),
    ]
    if view.finished_at is not None:
        told.append(Term(term="Ended", words=_moment(view.finished_at)))
    told.append(
        Term(
            term="Time",
            words=f"{progress.elapsed_s:,.0f} s from submission to {'end' if facts.ended else 'now'}",
        )
    )
    if isinstance(problem, SimulatedProblem):
        told.append(Term(term="Simulator", words=str(provenance.get("simulator", problem.needs))))
        told.append(Term(term="Workers", words="not recorded: results do not depend on how many there are"))
    known = [
        f"{name} {versions[name]}" for name in ("brink", "python", "numpy", "pybullet") if name in versions
    ]
    told.append(Term(term="Versions", words=", ".join(known)))
    if "instruction_set" in provenance:
        told.append(
            Term(
                term="Arithmetic",
                words=f"{provenance['instruction_set']}: machines with the same value agree bit for bit",
            )
        )
    if progress.digest:
        told.append(Term(term="Archive", words=f"SHA-256 {progress.digest}"))
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
    campaign, told = facts.view.id, []
    if _campaign_file(facts):
        told.append(("brink run campaign.yaml --workers 2", _again(facts)))
    told += [(step.command, step.question) for step in facts.finding.steps if step.command]
    told += [
        (f"brink export {campaign} --out campaign.brink", "hand on all results, for brink import elsewhere"),
        (f"brink report {campaign} --out report.html", "write this page again"),
    ]
    return [Term(term=command, words=words) for command, words in dict(told).items()]
