"""Types of violations: tables for people, files, one replay a type, and how many were known when."""

import asyncio
import csv
import io
import json
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np
import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from brink.api.client import Api, CoordinatorSaid
from brink.cli.draw import FetchedArchive, NoTrace, fetch_trace
from brink.cli.findings.drawing import Drawing
from brink.cli.options import AsJson, CampaignId, Database, Server, console, print_json, with_api
from brink.search.algorithms.multi_objective import CRITICALITY, MultiObjectiveConfig
from brink.search.space import FloatArray
from brink.server.errors import FieldError, InvalidInput
from brink.server.problems.base import TellsViolations
from brink.sim.replay import render

SHOWN: Final = 12
PICTURES: Final = 12
"""Types that get a replay, those with most solutions first."""


class ViolationFindings:
    """What a campaign found about violations.

    Args:
        found: As the coordinator tells it.
        fetched: The campaign.
    """

    name = "violations"

    def __init__(self, found: dict[str, Any], fetched: FetchedArchive) -> None:
        self._found = found
        self._fetched = fetched

    def sentence(self) -> str:
        """Return it in a sentence."""
        return in_words(self._found)

    def show(self, screen: Console) -> None:
        """Print it for people."""
        print_violations(screen, self._found)

    def write(self, folder: Path) -> list[Path]:
        """Write it to files."""
        return write_violations(self._found, folder)

    async def draw(self, drawing: Drawing) -> list[Path]:
        """Draw types over time, how the fronts moved, and a replay of each of the commonest types."""
        files = [await asyncio.to_thread(draw_types, self._found, drawing.folder)]
        if isinstance(self._fetched.plan.config, MultiObjectiveConfig):
            criticality = await _criticality(drawing.api, self._fetched)
            files.append(await asyncio.to_thread(draw_fronts, self._fetched, criticality, drawing.folder))
        return files + await draw_gallery(self._found, drawing)

    def hints(self, campaign: str, database: str) -> list[tuple[str, str]]:
        """Return commands to go on with, and what each is for."""
        hints = [(f"violations {campaign}{database}", "all types of violations")]
        if types := commonest(self._found):
            first = types[0]["first"]
            hints.append((f"replay {campaign} {first} --out violation.mp4{database}", "watch one"))
        return hints


async def fetch_violations(api: Api, fetched: FetchedArchive) -> ViolationFindings | None:
    """Return what a campaign found about violations; None if its problem tells none."""
    if not isinstance(fetched.plan.problem, TellsViolations):
        return None
    return ViolationFindings(await api.get(f"/campaigns/{fetched.id}/violations"), fetched)


def violations(
    campaign: CampaignId,
    number: Annotated[
        int | None,
        typer.Option(min=0, help="Only this solution's; with --name or --unname, whose violation."),
    ] = None,
    requirement: Annotated[
        str | None,
        typer.Option(
            help="Only violations of this; with --name or --unname, which one if there are several."
        ),
    ] = None,
    name: Annotated[str | None, typer.Option(help="Say what that violation is; it becomes its type.")] = None,
    unname: Annotated[bool, typer.Option("--unname", help="Give it back the type of the rules.")] = False,
    shown: Annotated[int, typer.Option(min=1, help="Rows of the table.")] = SHOWN,
    database: Database = None,
    server: Server = None,
    as_json: AsJson = False,
) -> None:
    """Say which types of violations a campaign found, and name them.

    Example: brink violations 3f2a --number 71 --name "overtakes into oncoming traffic"
    """
    if (name is not None or unname) and number is None:
        raise InvalidInput([FieldError(pointer="--number", message="expected which solution is named")])
    if name is not None and unname:
        raise InvalidInput([FieldError(pointer="--unname", message="expected it without --name")])

    async def work(api: Api) -> None:
        if number is not None and (name is not None or unname):
            await _name(api, campaign, number, requirement, name)
        found = await api.get(f"/campaigns/{campaign}/violations")
        if number is not None or requirement is not None:
            found["violations"] = [
                one
                for one in found["violations"]
                if number in (None, one["number"]) and requirement in (None, one["requirement"])
            ]
        if as_json:
            print_json(found)
        elif number is not None or requirement is not None:
            if not found["violations"]:
                console().print("no such violation")
            for one in found["violations"]:
                console().print(
                    f"{one['number']} at {one['time_s']:.1f} s, {one['requirement']}: {one['type']}",
                    soft_wrap=True,
                    markup=False,
                )
        else:
            print_violations(console(), found, shown)

    with_api(server, database, work)


async def _name(api: Api, campaign: str, number: int, requirement: str | None, name: str | None) -> None:
    """Name a violation, or take its name away."""
    if requirement is None:
        found = await api.get(f"/campaigns/{campaign}/violations")
        its = [one["requirement"] for one in found["violations"] if one["number"] == number]
        if len(its) != 1:
            message = f"expected one of {', '.join(its)}" if its else f"solution {number} has no violation"
            raise InvalidInput([FieldError(pointer="--requirement", message=message)])
        requirement = its[0]
    path = f"/campaigns/{campaign}/violations/{number}/{requirement}/name"
    if name is None:
        await api.request("DELETE", path)
    else:
        await api.request("PUT", path, json={"name": name})


def commonest(found: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the types, those with most solutions first."""
    return sorted(found["types"], key=lambda kind: (-kind["solutions"], kind["first"]))


def print_violations(screen: Console, found: dict[str, Any], shown: int = SHOWN) -> None:
    """Print the commonest types, and in a sentence how many there are."""
    types = commonest(found)
    table = Table(box=None, pad_edge=False, header_style="dim")
    for column in ("solutions", "distinct", "first"):
        table.add_column(column, justify="right")
    table.add_column("type of violation")
    for kind in types[:shown]:
        named = " [dim](named)[/dim]" if kind["named"] else ""
        table.add_row(
            str(kind["solutions"]), str(kind["instances"]), str(kind["first"]), escape(kind["type"]) + named
        )
    if types:
        screen.print(table)
        if len(types) > shown:
            screen.print(
                f"[dim]… and {len(types) - shown} more types: --shown {len(types)}, or violations.csv of a run[/dim]"
            )
    screen.print(in_words(found))


def in_words(found: dict[str, Any]) -> str:
    """Return what a campaign found about violations in a sentence."""
    types = found["types"]
    solutions = len({number for kind in types for number in kind["numbers"]})
    fault = sum(kind["at_fault"] is True for kind in types)
    return (
        f"{len(types)} types of violations in {solutions} solutions; "
        f"in {fault} of the types the ego was at fault by the rules"
    )


def write_violations(found: dict[str, Any], folder: Path) -> list[Path]:
    """Write everything as JSON, and a row a violation as CSV."""
    document, table = folder / "violations.json", folder / "violations.csv"
    document.write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    signature = list(found["violations"][0]["signature"]) if found["violations"] else []
    writer.writerow(["number", "time_s", "type", "name", *signature])
    for one in found["violations"]:
        words = [one["signature"][name] for name in signature]
        writer.writerow([one["number"], one["time_s"], one["type"], one["name"] or "", *words])
    table.write_text(text.getvalue(), encoding="utf-8")
    return [document, table]


def draw_types(found: dict[str, Any], folder: Path) -> Path:
    """Draw how many types were known after how many solutions."""
    # matplotlib takes half a second to load: only those who draw wait for it.
    from matplotlib.figure import Figure

    firsts = sorted(kind["first"] for kind in found["types"])
    fault = sorted(kind["first"] for kind in found["types"] if kind["at_fault"] is True)
    last = max((one["number"] for one in found["violations"]), default=0)
    figure = Figure(figsize=(6, 3.4), layout="constrained")
    axes = figure.subplots()
    for numbers, colour, label in (
        (firsts, "#0072b2", "all types"),
        (fault, "#d55e00", "types with the ego at fault"),
    ):
        axes.step(
            [0, *numbers, last], [0, *range(1, len(numbers) + 1), len(numbers)], where="post", color=colour,
            label=label,
        )  # fmt: skip
    axes.set(xlabel="solutions asked", ylabel="types of violations known", xlim=(0, None), ylim=(0, None))
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False)
    path = folder / "violation-types.png"
    figure.savefig(path, dpi=120)
    return path


async def _criticality(api: Api, fetched: FetchedArchive) -> FloatArray:
    """Return the criticality of all archived solutions, in the archive's order."""
    found: dict[int, float] = {}
    after: int | None = -1
    while after is not None:
        page = await api.get(f"/campaigns/{fetched.id}/solutions", {"after": after, "limit": 1000})
        for solution in page["solutions"]:
            if solution["objectives"] is not None:
                found[solution["number"]] = solution["objectives"][CRITICALITY]
        after = page["next"]
    return np.array([found[int(number)] for number in fetched.archive.numbers])


def draw_fronts(fetched: FetchedArchive, criticality: FloatArray, folder: Path) -> Path:
    """Draw how the Pareto front moved."""
    # matplotlib takes half a second to load: only those who draw wait for it.
    from brink.plots.fronts import figure_fronts

    figure = figure_fronts(
        fetched.body.name, fetched.plan.problem.space, fetched.archive.vectors, fetched.generations,
        criticality, fetched.plan.config,
    )  # fmt: skip
    path = folder / "fronts.png"
    figure.savefig(path)
    return path


async def draw_gallery(found: dict[str, Any], drawing: Drawing) -> list[Path]:
    """Draw one replay a type, of its first solution; those that cannot be had are left out."""
    files = []
    requirement = {(one["number"], one["type"]): one["requirement"] for one in found["violations"]}
    for place, kind in enumerate(commonest(found)[:PICTURES], start=1):
        if drawing.stop.is_set():
            break
        try:
            trace = await fetch_trace(drawing.api, drawing.campaign, kind["first"], drawing.patience_s)
        except (NoTrace, CoordinatorSaid):
            continue
        path = drawing.folder / f"violation-{place}.png"
        violated = requirement[kind["first"], kind["type"]]
        await asyncio.to_thread(render, trace, path, requirement=violated)
        files.append(path)
    return files
