"""Findings other than the boundary: `brink violations` and `brink combinations`, and the same at the end of a run.

Each kind of findings is a class that prints, writes and draws itself.
"""

import asyncio
from collections.abc import Collection, Iterable, Sequence
from pathlib import Path
from typing import Annotated, Final, Protocol

import numpy as np
import typer
from rich.console import Console
from rich.text import Text

from brink.api.client import Api
from brink.api.results import FetchedArchive
from brink.cli.options import (
    AsJson,
    CampaignId,
    Database,
    Server,
    console,
    plain_table,
    print_json,
    print_line,
    program,
    with_api,
    write_json,
)
from brink.cli.tolerance import fetch_tolerance_findings
from brink.report.combinations import (
    COLUMNS,
    added_harm_words,
    claim_words,
    combination_rows,
    draw_chains,
    tally_words,
    variant_words,
)
from brink.report.figures import VIOLATION_TYPES, Drawing
from brink.report.violations import draw_gallery, figure_types
from brink.search.algorithms.multi_objective import CRITICALITY, MultiObjectiveConfig
from brink.search.analysis.avoidable import Avoidable
from brink.search.errors import UnsupportedSpace
from brink.search.slots import slots_of
from brink.search.space import FloatArray
from brink.server.api.schemas import SolutionPage
from brink.server.csv_text import csv_text
from brink.server.errors import InvalidInput
from brink.server.findings.combinations.views import Combinations, StepTally
from brink.server.findings.violations.views import Violations, ViolationView
from brink.server.problems.base import ReportsViolations
from brink.server.problems.npc_actions import UNAVOIDABLE_M, NpcActions
from brink.server.states import SolutionVerdict
from brink.server.views import SolutionView
from brink.sim.verdict import clock_words

CHAINS_SHOWN: Final = 10
CHAINS_DRAWN: Final = 3
TYPES_SHOWN: Final = 12
TYPES_DRAWN: Final = 12


class Findings(Protocol):
    """One kind of findings of a campaign.

    Attributes:
        name: The kind, in one word.
        examples: Numbers of solutions that are worth a replay, best first.
    """

    name: str
    examples: Sequence[int]

    def sentence(self) -> str:
        """Return the findings in one sentence."""
        ...

    def show(self, screen: Console) -> None:
        """Print the findings."""
        ...

    def write(self, folder: Path) -> list[Path]:
        """Write the findings to files; return the files."""
        ...

    async def draw(self, drawing: Drawing) -> list[Path]:
        """Draw the findings whose traces are available; return the files."""
        ...

    def hints(self, campaign: str, database: str) -> list[tuple[str, str]]:
        """Return commands to suggest to the user next, each with its purpose."""
        ...


async def fetch_findings(api: Api, fetched: FetchedArchive) -> Sequence[Findings]:
    """Return all kinds of findings that the problem of a campaign supports."""
    found: list[Findings] = []
    path = f"/campaigns/{fetched.id}"
    try:
        slots_of(fetched.plan.problem.space)
    except UnsupportedSpace:
        pass  # no ordered techniques, so no combinations
    else:
        found.append(CombinationFindings(await api.read(Combinations, f"{path}/combinations")))
    if fetched.plan.is_for("tolerances"):
        found.append(await fetch_tolerance_findings(api, fetched.id))
    if isinstance(fetched.plan.problem, ReportsViolations):
        found.append(ViolationFindings(await api.read(Violations, f"{path}/violations"), fetched))
    return found


def combinations(
    campaign: CampaignId,
    shown: Annotated[int, typer.Option(min=1, help="Number of rows in each table.")] = CHAINS_SHOWN,
    database: Database = None,
    server: Server = None,
    as_json: AsJson = False,
) -> None:
    """Show which techniques are hazardous alone, only together, or in one order but not in another.

    Example: brink combinations 3f2a
    """
    path = f"/campaigns/{campaign}/combinations"
    document = with_api(server, database, lambda api: api.get(path))
    if as_json:
        print_json(document)
    else:
        CombinationFindings(Combinations.model_validate(document)).show(console(), shown)


class CombinationFindings:
    """Hazardous chains of techniques."""

    name = "combinations"
    examples: Sequence[int] = ()

    def __init__(self, found: Combinations) -> None:
        self._found = found
        self._missing: Collection[int] = ()

    def sentence(self) -> str:
        """Return a sentence on how many chains are hazardous, and how."""
        return self._found.words

    def show(self, screen: Console, shown: int = CHAINS_SHOWN) -> None:
        """Print the chains, the techniques, and the summary sentence."""
        chains = self._found.combinations
        table = plain_table("chain", "unsafe", "its parts", "other order", "added harm", "")
        for one in chains[:shown]:
            table.add_row(
                one.words,
                tally_words(one),
                "\n".join(variant_words(one.parts)) or "not simulated",
                "\n".join(map(tally_words, one.orders)),
                added_harm_words(one),
                claim_words(one),
            )
        if chains:
            screen.print(table)
            if len(chains) > shown:
                screen.print(
                    f"… and {len(chains) - shown} more: --shown {len(chains)}, or combinations.json of a run",
                    style="dim",
                )
        steps = [step for step in self._found.steps if step.alone_unsafe or step.joined_unsafe]
        if steps:
            table = plain_table("technique at a level", "alone", "with others")
            for step in sorted(steps, key=_unsafe_shares, reverse=True)[:shown]:
                table.add_row(
                    step.words,
                    _ratio(step.alone_unsafe, step.alone_trials),
                    _ratio(step.joined_unsafe, step.joined_trials),
                )
            screen.print(table)
        if self._found.explanation:
            screen.print(self._found.explanation, style="dim")
        screen.print(self.sentence())

    def write(self, folder: Path) -> list[Path]:
        """Write everything as JSON, and the chains and the hazards of each technique as CSV; return the files."""
        document, table = folder / "combinations.json", folder / "hazards.csv"
        chains = folder / "combinations.csv"
        write_json(document, self._found.model_dump(mode="json"))
        tallies = ("alone_unsafe", "alone_trials", "joined_unsafe", "joined_trials")
        rows = [
            [one.step.technique, one.step.level, one.step.levels, *(getattr(one, name) for name in tallies)]
            for one in self._found.steps
        ]
        _write_csv(table, [["technique", "level", "levels", *tallies], *rows])
        _write_csv(chains, [list(COLUMNS), *(list(row.values()) for row in combination_rows(self._found))])
        return [document, chains, table]

    async def draw(self, drawing: Drawing) -> list[Path]:
        """Draw the clearest combinations, each with its parts and other orders; return the files."""
        self._missing = drawing.missing
        return await draw_chains(self._found, drawing, CHAINS_DRAWN)

    def hints(self, campaign: str, database: str) -> list[tuple[str, str]]:
        """Return commands to suggest to the user next, each with its purpose."""
        if not self._found.combinations:
            return []
        hints = [(f"combinations {campaign}{database}", "list all chains of techniques")]
        hazards = [number for one in self._found.combinations for number in (*one.together, *one.turned)]
        if hazards and hazards[0] not in self._missing:
            hints.append((f"replay {campaign} {hazards[0]} --out hazard.mp4{database}", "watch the hazard"))
        return hints


def _ratio(unsafe: int, trials: int) -> str:
    return f"{unsafe} of {trials}" if trials else "–"


def _unsafe_shares(step: StepTally) -> tuple[float, float]:
    return step.alone_unsafe / max(1, step.alone_trials), step.joined_unsafe / max(1, step.joined_trials)


def violations(
    campaign: CampaignId,
    number: Annotated[
        int | None,
        typer.Option(min=0, help="Show only this solution; with --name or --unname, the solution to change."),
    ] = None,
    requirement: Annotated[
        str | None,
        typer.Option(
            help="Show only violations of this requirement; with --name or --unname, the violation to change."
        ),
    ] = None,
    name: Annotated[str | None, typer.Option(help="Name the violation; the name becomes its type.")] = None,
    unname: Annotated[
        bool, typer.Option("--unname", help="Remove the name; the rules determine the type again.")
    ] = False,
    avoidable: Annotated[
        Avoidable | None,
        typer.Option(
            help="Show only violations that this driver would have avoided (no: neither would have), and the types "
            "with one."
        ),
    ] = None,
    shown: Annotated[
        int | None, typer.Option(min=1, help="Number of rows, or of violations; without it, all.")
    ] = None,
    database: Database = None,
    server: Server = None,
    as_json: AsJson = False,
) -> None:
    """Show all types of violations that a campaign found, and name violations.

    Example: brink violations 3f2a --number 71 --requirement no-collision@1 --name "overtakes into oncoming traffic"
    """
    if (name is not None or unname) and number is None:
        raise InvalidInput.at(
            "--number", "expected the number of the solution whose violation is to be named or unnamed"
        )
    if name is not None and unname:
        raise InvalidInput.at("--unname", "expected only one of --name and --unname, got both")

    async def work(api: Api) -> Violations:
        if number is not None and (name is not None or unname):
            await _name(api, campaign, number, requirement, name)
        found = await api.read(Violations, f"/campaigns/{campaign}/violations")
        selected = await _selected(api, campaign, found, number, requirement)
        if avoidable is not None:
            params = {"avoidable": avoidable.value, "types_only": True}
            found = await api.read(Violations, f"/campaigns/{campaign}/violations", params)
        return found.model_copy(
            update={"violations": [one for one in selected if avoidable in (None, one.avoidable)]}
        )

    found = with_api(server, database, work)
    if as_json:
        print_json(found.model_dump(mode="json"))
    elif number is None and requirement is None:
        print_violations(console(), found, shown)
    else:
        for one in found.violations[:shown]:
            by = "" if one.avoidable is None else f"; {one.avoidable.words}"
            how = "" if one.avoided_by is None else f", who avoids it by {one.avoided_by}"
            print_line(f"{one.number} at {clock_words(one.time_s)}, {one.requirement}: {one.type}{by}{how}")
        more = len(found.violations) - len(found.violations[:shown])
        if more or not found.violations:
            print_line(f"… and {more:,} more" if more else "none of these violations")


async def _selected(
    api: Api, campaign: str, found: Violations, number: int | None, requirement: str | None
) -> list[ViolationView]:
    """Return the violations of a solution, of a requirement, or of both.

    Raises:
        InvalidInput: There are none.
        Missing: There is no such solution.
    """
    of_number = [one for one in found.violations if number in (None, one.number)]
    if not of_number and number is not None:
        solution = await api.read(SolutionView, f"/campaigns/{campaign}/solutions/{number}")
        safe = solution.verdict is SolutionVerdict.SAFE
        raise InvalidInput.at(
            "--number", f"solution {number} {'violates nothing' if safe else f'is {solution.verdict}'}"
        )
    chosen = [one for one in of_number if requirement in (None, one.requirement)]
    if not chosen and requirement is not None:
        violated = ", ".join(sorted({one.requirement for one in of_number}))
        raise InvalidInput.at(
            "--requirement",
            f"expected one of {violated or 'none, as nothing was violated'}; got {requirement!r}",
        )
    return chosen


async def _name(api: Api, campaign: str, number: int, requirement: str | None, name: str | None) -> None:
    """Name a violation; None removes the name."""
    if requirement is None:
        found = await api.read(Violations, f"/campaigns/{campaign}/violations")
        violated = [one.requirement for one in await _selected(api, campaign, found, number, None)]
        if len(violated) != 1:
            raise InvalidInput.at("--requirement", f"expected one of {', '.join(violated)}")
        requirement = violated[0]
    path = f"/campaigns/{campaign}/violations/{number}/{requirement}/name"
    if name is None:
        await api.request("DELETE", path)
    else:
        await api.request("PUT", path, json={"name": name})


class ViolationFindings:
    """Types of violations.

    Args:
        found: The violations.
        fetched: The campaign.
    """

    name = "violations"
    examples: Sequence[int] = ()

    def __init__(self, found: Violations, fetched: FetchedArchive) -> None:
        self._found = found
        self._fetched = fetched
        self._missing: Collection[int] = ()

    def sentence(self) -> str:
        """Return the findings in one sentence."""
        return self._found.words

    def show(self, screen: Console) -> None:
        """Print the first types, and the summary sentence."""
        print_violations(screen, self._found, TYPES_SHOWN, more=f"{program()} violations {self._fetched.id}")

    def write(self, folder: Path) -> list[Path]:
        """Write the findings to files; return the files."""
        return write_violations(self._found, folder)

    async def draw(self, drawing: Drawing) -> list[Path]:
        """Plot types over time and Pareto fronts, and draw a replay of each of the first types; return the files."""
        self._missing = drawing.missing
        files = [await asyncio.to_thread(draw_types, self._found, drawing.folder)]
        config = self._fetched.plan.config
        if isinstance(config, MultiObjectiveConfig):
            criticality = await _criticality(drawing.api, self._fetched)
            fronts = await asyncio.to_thread(_draw_fronts, self._fetched, config, criticality, drawing.folder)
            files.append(fronts)
        return files + await draw_gallery(self._found, drawing, TYPES_DRAWN)

    def hints(self, campaign: str, database: str) -> list[tuple[str, str]]:
        """Return commands to suggest to the user next, each with its purpose."""
        types = self._found.types
        if not types:
            return []
        hints = [(f"violations {campaign}{database}", "list all types of violations")]
        example = types[0].example
        if example not in self._missing:
            hints.append((f"replay {campaign} {example} --out violation.mp4{database}", "watch one"))
        return hints


def print_violations(
    screen: Console,
    found: Violations,
    shown: int | None = None,
    *,
    more: str = "without --shown, all of them",
) -> None:
    """Print types of violations, avoidable ones first, and a summary sentence.

    Args:
        screen: Where to print.
        found: The violations.
        shown: Number of types to print; None prints all.
        more: How to see the others.
    """
    types = found.types
    numbers = ("solutions", "distinct", "example")
    table = plain_table("avoidable by", "how", *numbers, "type of violation", right=numbers)
    for kind in types[:shown]:
        words = Text.assemble(kind.type, (" (named)" if kind.named else "", "dim"))
        table.add_row(
            kind.avoider, kind.avoided_by or "", kind.avoided, str(kind.instances), str(kind.example), words
        )
    if types:
        screen.print(table)
        hidden = len(types) - len(types[:shown])
        if hidden:
            screen.print(f"… and {hidden} more types: {more}", style="dim")
        if any(kind.avoidable for kind in types):
            screen.print(found.explanation, style="dim")
    screen.print(found.words)


def write_violations(found: Violations, folder: Path) -> list[Path]:
    """Write all violations as JSON, and as CSV with one row for each violation; return the files."""
    document, table = folder / "violations.json", folder / "violations.csv"
    write_json(document, found.model_dump(mode="json"))
    signature = list(found.violations[0].signature) if found.violations else []
    rows = [
        [
            one.number,
            round(one.time_s, 3),
            one.type,
            one.name or "",
            one.avoidable or "",
            one.avoided_by or "",
            one.at_fault,
            *(one.signature[name] for name in signature),
        ]
        for one in found.violations
    ]
    header = ["number", "time_s", "type", "name", "avoidable", "avoided_by", "at_fault", *signature]
    _write_csv(table, [header, *rows])
    return [document, table]


def _write_csv(file: Path, rows: Iterable[Sequence[object]]) -> None:
    file.write_text(csv_text(rows), encoding="utf-8", newline="")


def draw_types(found: Violations, folder: Path) -> Path:
    """Plot how the numbers of known types and of avoidable ones grow with the solutions; return the file."""
    path = folder / f"{VIOLATION_TYPES}.png"
    figure_types(found).savefig(path, dpi=120)
    return path


async def _criticality(api: Api, fetched: FetchedArchive) -> FloatArray:
    """Return the criticality of all archived solutions in the order of the archive, shape ``(n,)``."""
    found: dict[int, float] = {}
    async for page in api.pages(SolutionPage, f"/campaigns/{fetched.id}/solutions", {"limit": 1000}):
        for solution in page.solutions:
            if solution.objectives is not None:
                found[solution.number] = solution.objectives[CRITICALITY]
    return np.array([found[int(number)] for number in fetched.archive.numbers])


def _draw_fronts(
    fetched: FetchedArchive, config: MultiObjectiveConfig, criticality: FloatArray, folder: Path
) -> Path:
    """Plot how the Pareto front moved over the generations; return the file."""
    # matplotlib takes half a second to load: only commands that draw wait for it.
    from brink.plots.campaign import figure_fronts

    problem = fetched.plan.problem
    figure = figure_fronts(
        fetched.body.name,
        problem.space,
        fetched.archive.vectors,
        fetched.generations,
        criticality,
        config,
        by_gap=not isinstance(problem, NpcActions) or problem.by_gap,
        unavoidable=UNAVOIDABLE_M,
    )
    path = folder / "fronts.png"
    figure.savefig(path)
    return path
