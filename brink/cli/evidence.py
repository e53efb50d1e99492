"""`brink evidence`: export a folder with which others can verify and use a campaign's boundary."""

import asyncio
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console

from brink import __version__
from brink.api.client import Api
from brink.api.live import Steps
from brink.cli.options import (
    AsJson,
    CampaignId,
    Database,
    DistanceThreshold,
    FitnessThreshold,
    Server,
    console,
    print_json,
    with_api,
    write_json,
)
from brink.extras import install_command
from brink.search.errors import MissingExtra, TooManyPairs
from brink.server.campaigns.body import DEFAULT_D_TH, DEFAULT_T_B
from brink.server.errors import InvalidInput
from brink.server.findings.boundary.views import Boundary
from brink.server.findings.table import FORMATS, Row, has_parquet, table_bytes

if TYPE_CHECKING:
    from brink.api.results import FetchedArchive
    from brink.cli.evidence_pairs import PairEvidence
    from brink.search.analysis.rules import Rules
    from brink.sim.trace import Trace


@dataclass(frozen=True, slots=True, kw_only=True)
class _Options:
    folder: Path
    t_b: float
    d_th: float
    replays: int
    pairs: int
    film: str | None
    server: str | None


def evidence(
    campaign: CampaignId,
    out: Annotated[Path, typer.Option(help="Folder to write.")],
    t_b: FitnessThreshold = DEFAULT_T_B,
    d_th: DistanceThreshold = DEFAULT_D_TH,
    replays: Annotated[
        int, typer.Option(min=0, help="Number of boundary solutions to replay, best first.")
    ] = 1000,
    pairs: Annotated[
        int, typer.Option(min=0, help="Number of pairs to draw after a search for pairs, best first.")
    ] = 5,
    film: Annotated[
        str | None, typer.Option(help="gif or mp4: also write replays as videos, which takes longer.")
    ] = None,
    database: Database = None,
    server: Server = None,
    as_json: AsJson = False,
) -> None:
    """Export the boundary of a campaign: tables, rules, replays, and the boxes of true and detected objects.

    Of a boundary with more than 1,000 solutions, the best 1,000 are exported.

    After a search for pairs, export these: tables, the evidence for them, and pictures of the best ones.

    Without --server, this machine runs the episodes again; with it, the coordinator's workers do.

    Example: brink evidence 3f2a --out evidence --film mp4
    """
    if film not in (None, "gif", "mp4"):
        raise InvalidInput.at("--film", f"expected gif or mp4, got {film!r}")
    screen = console(stderr=as_json)
    options = _Options(folder=out, t_b=t_b, d_th=d_th, replays=replays, pairs=pairs, film=film, server=server)
    summary = with_api(server, database, lambda api: _write(api, campaign, options, screen))
    if as_json:
        print_json(summary)
        return
    for line in summary["notes"]:
        screen.print(line, soft_wrap=True)
    counts = f"{summary['words']}, {summary['replays']} with replays"
    if summary["pairs"] is not None:
        counts = f"{summary['pairs']} pairs, {summary['pictures']} with pictures; {counts}"
    screen.print(f"{out}: {counts}; start with {out / 'README.md'}", soft_wrap=True)


async def _write(api: Api, campaign: str, options: _Options, screen: Console) -> dict[str, Any]:
    from brink.api.results import fetch_archive
    from brink.cli.evidence_pairs import draw_pair_evidence, write_pair_tables
    from brink.search.analysis.rules import Rules
    from brink.server.findings.boundary.table import boundary_columns, boundary_rows

    fetched = await fetch_archive(api, campaign)
    params = {"t_b": options.t_b, "d_th": options.d_th}
    boundary = await api.read(Boundary, f"/campaigns/{fetched.id}/boundary", params)
    options.folder.mkdir(parents=True, exist_ok=True)
    rows, notes = boundary_rows(boundary, fetched.id, fetched.body), list[str]()
    columns = boundary_columns(fetched.plan.problem.space)
    searched = fetched.plan.is_for("pairs")
    if not has_parquet():
        notes.append(f"no Parquet: {install_command('analysis')}")
    if rows or not searched:
        _tables(rows, options.folder, columns)
    found: list[Rules] = []
    with Steps(screen, "finding rules"):
        try:
            found = await asyncio.to_thread(_rules, fetched, options.t_b)
        except MissingExtra as error:
            notes.append(f"no rules: {error}")
    document = [asdict(one) for one in found]
    write_json(options.folder / "rules.json", document)
    pairs = await write_pair_tables(api, fetched, options.folder) if searched else None
    if isinstance(pairs, TooManyPairs):
        notes.append(f"no list of pairs: {pairs}")
        pairs = None
    # The slow part comes last, so that Ctrl-C leaves everything else complete.
    readme = options.folder / "README.md"
    readme.write_text(_readme(fetched, boundary, options, found, notes, 0, pairs), encoding="utf-8")
    if pairs is not None:
        with Steps(screen, "drawing pairs") as steps:
            pairs = await draw_pair_evidence(
                api,
                pairs,
                options.folder,
                pictures=options.pairs,
                film=options.film,
                workers=options.server is not None,
                show=steps.show,
            )
        notes += pairs.notes
    drawn, missing = await _replays(api, fetched, rows, boundary, options, screen)
    notes += missing
    if rows or not searched:
        _tables(rows, options.folder, columns)
    readme.write_text(_readme(fetched, boundary, options, found, notes, drawn, pairs), encoding="utf-8")
    return {
        "campaign": fetched.id,
        "folder": str(options.folder),
        "solutions": len(rows),
        "words": boundary.words,
        "replays": drawn,
        "pairs": None if pairs is None else len(pairs.view.pairs),
        "pictures": None if pairs is None else len(pairs.drawn),
        "rules": document,
        "notes": notes,
    }


def _tables(rows: Sequence[Row], folder: Path, columns: Mapping[str, type]) -> None:
    for form in FORMATS:
        if form != "parquet" or has_parquet():
            (folder / f"boundary.{form}").write_bytes(table_bytes(rows, form, columns))


def _rules(fetched: "FetchedArchive", t_b: float) -> "list[Rules]":
    from brink.search.analysis.rules import region_rules

    archive, space, seed = fetched.archive, fetched.plan.problem.space, fetched.body.seed
    regions = {
        f"the boundary (fitness at most {t_b:g})": archive.fitness <= t_b,
        "the unsafe region": archive.unsafe,
    }
    return [
        region_rules(archive, space, inside, name, seed=seed, recorded=fetched.active)
        for name, inside in regions.items()
        if inside.any() and not inside.all()
    ]


async def _replays(
    api: Api,
    fetched: "FetchedArchive",
    rows: Sequence[Row],
    boundary: Boundary,
    options: _Options,
    screen: Console,
) -> tuple[int, list[str]]:
    """Write replays and add detection counts to the rows; return the number of replays and a note per failure."""
    from brink.api.results import UNDRAWABLE, fetch_requirements, trace_of
    from brink.report.component import DetectionCounts, count_detections

    chosen = [
        (row, solution.number)
        for row, solution in zip(rows, boundary.solutions, strict=True)
        if solution.spec is not None
    ][: options.replays]
    if not chosen:
        return 0, []
    folder = options.folder / "episodes"
    folder.mkdir(exist_ok=True)
    requirement = await fetch_requirements(api, fetched.id)
    names = DetectionCounts(truth=0, detected=0, matched=0).to_columns()
    for row in rows:
        row.update({f"component.{name}": None for name in names} | {"replay": None})
    drawn, notes = 0, []
    with Steps(screen, "drawing replays") as steps:
        for done, (row, number) in enumerate(chosen):
            steps.show("drawing replays", done, len(chosen))
            try:
                trace = await trace_of(api, fetched.id, number, workers=options.server is not None)
                counts = count_detections(trace).to_columns()
                await asyncio.to_thread(_draw, trace, folder, number, options.film, requirement)
            except UNDRAWABLE as error:
                notes.append(f"solution {number} has no replay: {type(error).__name__}: {error}")
                continue
            row.update({f"component.{name}": count for name, count in counts.items()})
            row["replay"] = f"episodes/{number}.{options.film or 'png'}"
            drawn += 1
    return drawn, notes


def _draw(
    trace: "Trace", folder: Path, number: int, film: str | None, requirement: tuple[str, ...] | None
) -> None:
    from brink.pictures import render
    from brink.report.component import write_boxes

    (folder / f"{number}.npz").write_bytes(trace.to_bytes())
    write_boxes(trace, folder / f"{number}-boxes.csv")
    render(trace, folder / f"{number}.png", requirement=requirement)
    if film:
        render(trace, folder / f"{number}.{film}", requirement=requirement)


def _readme(
    fetched: "FetchedArchive",
    boundary: Boundary,
    options: _Options,
    found: "Sequence[Rules]",
    notes: Sequence[str],
    drawn: int,
    pairs: "PairEvidence | None",
) -> str:
    from brink.search.analysis.rules import rules_markdown
    from brink.server.findings.boundary.table import MEANINGS

    body = fetched.body
    with_boundary = bool(boundary.solutions) or pairs is None
    parts = [
        f"# {'Boundary' if pairs is None else 'Pairs'} of {body.name}",
        f"Campaign {fetched.id}: {body.algorithm.id} on {body.problem.id}, seed {body.seed}, "
        f"{len(fetched.archive):,} evaluated solutions, {int(fetched.archive.unsafe.sum()):,} of them unsafe. "
        f"{fetched.outcomes.words} Brink {__version__}.".lstrip(),
        *(_pairs_words(fetched) if pairs is not None else []),
        *(_boundary_words(fetched, boundary, options) if with_boundary else []),
        *(f"> {note}" for note in notes),
        "# Files",
        _files(options.film, drawn, pairs, boundary.words, with_boundary=with_boundary),
        *([] if pairs is None else [pairs.section()]),
    ]
    if with_boundary:
        parts.append(
            "# Columns\n\n| column | meaning |\n|---|---|\n"
            + "\n".join(f"| `{name}` | {meaning} |" for name, meaning in MEANINGS.items())
        )
    if found:
        parts += [
            "# Rules\n\nFrom shallow decision trees over all evaluated solutions. "
            "A search concentrates on the boundary, so shares refer to evaluated solutions, not to traffic.",
            rules_markdown(found),
        ]
    return "\n\n".join(parts).rstrip() + "\n"


def _pairs_words(fetched: "FetchedArchive") -> list[str]:
    return [
        "This campaign searched for pairs across the boundary: two neighbouring solutions, one safe and "
        f"one unsafe. `brink pairs {fetched.id}` shows them, and can simulate them again."
    ]


def _boundary_words(fetched: "FetchedArchive", boundary: Boundary, options: _Options) -> list[str]:
    near = fetched.plan.neighbourhood
    return [
        f"{boundary.dbs} distinct boundary solutions, {boundary.strict_dbs} of them strict: fitness at most "
        f"{options.t_b:g}, at least {options.d_th:g} apart, around the region that is unsafe with probability "
        f"{near.p_th:g}; neighbours within {near.radius:g}, intervals with z = {near.z:g}. {boundary.note}",
        "Each solution was simulated once. `brink repeats` estimates how likely the solution itself is to be unsafe.",
    ]


def _files(
    film: str | None, drawn: int, pairs: "PairEvidence | None", words: str, *, with_boundary: bool
) -> str:
    lines = [] if pairs is None else pairs.files()
    if with_boundary:
        tables = ", ".join(f"`boundary.{form}`" for form in FORMATS if form != "parquet" or has_parquet())
        lines.append(f"- {tables}: {words}, one row each, best first.")
    if drawn:
        films = f" and `episodes/NUMBER.{film}`" if film else ""
        lines += [
            f"- `episodes/NUMBER.png`{films}: replay of a solution.",
            "- `episodes/NUMBER-boxes.csv`: boxes of the true objects in the image, and of the detections given to "
            "the driving system.",
            "- `episodes/NUMBER.npz`: trace of the episode.",
        ]
    return "\n".join([*lines, "- `rules.json`: the rules below."])
