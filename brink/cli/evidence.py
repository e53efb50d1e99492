"""`brink evidence`: everything that somebody else needs to believe, and to use, the boundary of a campaign."""

import asyncio
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import Progress

from brink import __version__
from brink.api.client import Api, CoordinatorSaid
from brink.cli.draw import FetchedArchive, NoTrace, fetch_archive, fetch_trace, requirement_of, run_again
from brink.cli.options import AsJson, CampaignId, Database, Server, console, print_json, with_api
from brink.report.component import seen_and_said, write_boxes
from brink.search.analysis.rules import Rules, region_rules, rules_markdown
from brink.search.errors import MissingExtra, install_command
from brink.server.api.boundary_table import (
    FORMATS,
    MEANINGS,
    Row,
    boundary_rows,
    has_parquet,
    table_bytes,
)
from brink.server.api.schemas import Boundary
from brink.server.campaigns.body import DEFAULT_D_TH, DEFAULT_T_B
from brink.server.errors import FieldError, InvalidInput
from brink.sim.errors import SimulatorError
from brink.sim.replay import render
from brink.sim.trace import Trace
from brink.worker.errors import WorkerError

PATIENCE_S = 120.0
UNDRAWABLE = (
    NoTrace, CoordinatorSaid, SimulatorError, WorkerError, LookupError, ValueError, TypeError, ArithmeticError,
)  # fmt: skip
"""A simulator may record anything; what cannot be had or drawn is noted, and the next one follows."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Wanted:
    folder: Path
    t_b: float
    d_th: float
    replays: int
    film: str | None
    server: str | None


def evidence(
    campaign: CampaignId,
    out: Annotated[Path, typer.Option(help="Folder to write.")],
    t_b: Annotated[float, typer.Option("--t-b", min=0.0, max=1.0, help="Largest fitness.")] = DEFAULT_T_B,
    d_th: Annotated[
        float, typer.Option("--d-th", min=0.0, max=1.0, help="Least distance apart.")
    ] = DEFAULT_D_TH,
    replays: Annotated[
        int, typer.Option(min=0, help="Boundary solutions of which there are replays, the best ones.")
    ] = 1000,
    film: Annotated[
        str | None, typer.Option(help="gif or mp4: replays as films, too, which takes longer.")
    ] = None,
    database: Database = None,
    server: Server = None,
    as_json: AsJson = False,
) -> None:
    """Write a campaign's boundary into a folder: tables, rules, replays, what was seen beside what was said.

    Without --server episodes are run again on this machine; with it, the coordinator's workers run them.

    Example: brink evidence 3f2a --out evidence --film mp4
    """
    if film not in (None, "gif", "mp4"):
        raise InvalidInput([FieldError(pointer="--film", message=f"expected gif or mp4, got {film!r}")])
    screen = Console(stderr=True, highlight=False) if as_json else console()
    wanted = _Wanted(folder=out, t_b=t_b, d_th=d_th, replays=replays, film=film, server=server)
    said = with_api(server, database, lambda api: _write(api, campaign, wanted, screen))
    if as_json:
        print_json(said)
        return
    for line in said["notes"]:
        screen.print(line, soft_wrap=True, markup=False)
    found = f"{said['solutions']} boundary solutions, {said['replays']} with replays"
    screen.print(f"{out}: {found}; begin with {out / 'README.md'}", soft_wrap=True, markup=False)


async def _write(api: Api, campaign: str, wanted: _Wanted, screen: Console) -> dict[str, Any]:
    fetched = await fetch_archive(api, campaign)
    params = {"t_b": wanted.t_b, "d_th": wanted.d_th}
    answer = await api.request("GET", f"/campaigns/{fetched.id}/boundary", params=params)
    boundary = Boundary.model_validate_json(answer.content)
    wanted.folder.mkdir(parents=True, exist_ok=True)
    rows, notes = boundary_rows(boundary, fetched.id, fetched.body), list[str]()
    if not has_parquet():
        notes.append(f"no boundary.parquet: {install_command('analysis')}")
    _tables(rows, wanted.folder)
    found: list[Rules] = []
    with screen.status("finding rules"):
        try:
            found = await asyncio.to_thread(_rules, fetched, wanted.t_b)
        except MissingExtra as error:
            notes.append(f"no rules: {error}")
    document = [asdict(one) for one in found]
    (wanted.folder / "rules.json").write_text(json.dumps(document, indent=2) + "\n", encoding="utf-8")
    # What takes long comes last: whoever stops it has all the rest.
    readme = wanted.folder / "README.md"
    readme.write_text(_readme(fetched, boundary, wanted, found, notes, 0), encoding="utf-8")
    drawn, missing = await _replays(api, fetched, rows, boundary, wanted, screen)
    notes += missing
    _tables(rows, wanted.folder)
    readme.write_text(_readme(fetched, boundary, wanted, found, notes, drawn), encoding="utf-8")
    return {
        "campaign": fetched.id, "folder": str(wanted.folder), "solutions": len(rows), "replays": drawn,
        "rules": document, "notes": notes,
    }  # fmt: skip


def _tables(rows: Sequence[Row], folder: Path) -> None:
    for form in FORMATS:
        if form != "parquet" or has_parquet():
            (folder / f"boundary.{form}").write_bytes(table_bytes(rows, form))


def _rules(fetched: FetchedArchive, t_b: float) -> list[Rules]:
    archive, space, seed = fetched.archive, fetched.plan.problem.space, fetched.body.seed
    regions = {
        f"the boundary (fitness at most {t_b:g})": archive.fitness <= t_b,
        "what is unsafe": archive.unsafe,
    }
    return [
        region_rules(archive, space, inside, name, seed=seed)
        for name, inside in regions.items()
        if inside.any() and not inside.all()
    ]


async def _replays(
    api: Api,
    fetched: FetchedArchive,
    rows: Sequence[Row],
    boundary: Boundary,
    wanted: _Wanted,
    screen: Console,
) -> tuple[int, list[str]]:
    """Write replays, and add to the rows what they say of the component; return how many, and what went wrong."""
    chosen = [
        (row, solution.number)
        for row, solution in zip(rows, boundary.solutions, strict=True)
        if solution.spec is not None
    ][: wanted.replays]
    if not chosen:
        return 0, []
    folder = wanted.folder / "episodes"
    folder.mkdir(exist_ok=True)
    requirement = await requirement_of(api, fetched.id)
    names = ("seen", "said", "matched", "missed", "invented")
    for row in rows:
        row.update({f"component.{name}": None for name in names} | {"replay": None})
    drawn, notes = 0, []
    with Progress(console=screen, transient=True) as progress:
        for row, number in progress.track(chosen, description="replays"):
            try:
                trace = await _trace(api, fetched.id, number, wanted)
                compared = seen_and_said(trace)
                await asyncio.to_thread(_draw, trace, folder, number, wanted.film, requirement)
            except UNDRAWABLE as error:
                notes.append(f"solution {number} has no replay: {type(error).__name__}: {error}")
                continue
            row.update({f"component.{name}": getattr(compared, name) for name in names})
            row["replay"] = f"episodes/{number}.{wanted.film or 'png'}"
            drawn += 1
    return drawn, notes


async def _trace(api: Api, campaign: str, number: int, wanted: _Wanted) -> Trace:
    if wanted.server is None:
        return await run_again(api, campaign, number)
    return await fetch_trace(api, campaign, number, PATIENCE_S)


def _draw(trace: Trace, folder: Path, number: int, film: str | None, requirement: str | None) -> None:
    (folder / f"{number}.npz").write_bytes(trace.to_bytes())
    write_boxes(trace, folder / f"{number}-boxes.csv")
    render(trace, folder / f"{number}.png", requirement=requirement)
    if film:
        render(trace, folder / f"{number}.{film}", requirement=requirement)


def _readme(
    fetched: FetchedArchive,
    boundary: Boundary,
    wanted: _Wanted,
    found: Sequence[Rules],
    notes: Sequence[str],
    drawn: int,
) -> str:
    body, near = fetched.body, fetched.plan.neighbourhood
    parts = [
        f"# Boundary of {body.name}",
        f"Campaign {fetched.id}: {body.algorithm.id} on {body.problem.id}, seed {body.seed}, "
        f"{len(fetched.archive):,} evaluated solutions, {int(fetched.archive.unsafe.sum()):,} of them unsafe. "
        f"Brink {__version__}.",
        f"{boundary.dbs} distinct boundary solutions, {boundary.strict_dbs} of them strict: fitness at most "
        f"{wanted.t_b:g}, at least {wanted.d_th:g} apart, around the region that is unsafe with probability "
        f"{near.p_th:g}; neighbours within {near.radius:g}, intervals with z = {near.z:g}. {boundary.note}",
        "A solution here was simulated once. `brink repeats` says how likely it is unsafe itself.",
        *(f"> {note}" for note in notes),
        "# Files",
        _files(wanted.film, drawn),
        "# Columns\n\n| column | meaning |\n|---|---|\n"
        + "\n".join(f"| `{name}` | {meaning} |" for name, meaning in MEANINGS.items()),
    ]  # fmt: skip
    if found:
        parts += [
            "# Rules\n\nOf shallow decision trees over all evaluated solutions. "
            "A search looks where the boundary is, so shares are those of what it evaluated, not of traffic.",
            rules_markdown(found),
        ]
    return "\n\n".join(parts).rstrip() + "\n"


def _files(film: str | None, drawn: int) -> str:
    tables = ", ".join(f"`boundary.{form}`" for form in FORMATS if form != "parquet" or has_parquet())
    lines = [f"- {tables}: one row a solution, best first."]
    if drawn:
        films = f" and `episodes/NUMBER.{film}`" if film else ""
        lines += [
            f"- `episodes/NUMBER.png`{films}: the replay of a solution.",
            "- `episodes/NUMBER-boxes.csv`: every box that the component saw (ground truth of the picture) and said "
            "(what the driving system was given).",
            "- `episodes/NUMBER.npz`: the trace of the episode.",
        ]
    return "\n".join([*lines, "- `rules.json`: the rules below."])
