"""The files that `brink run` writes of each kind of findings: its tables, and the pictures that only one kind has.

`FILES` is the only place on the command line that knows kinds by name.
"""

import asyncio
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from brink.api.client import Api, CoordinatorError
from brink.api.results import FetchedArchive, NoTrace, find_pair, read_all_pairs
from brink.cli.options import write_json
from brink.report.combinations import draw_chains
from brink.report.comparison import compared_archives
from brink.report.figures import VIOLATION_TYPES, Drawing
from brink.report.pair_pictures import write_pair
from brink.report.thresholds import draw_thresholds
from brink.report.tolerance import requirement_document
from brink.report.violations import draw_gallery, figure_types
from brink.search.algorithms.multi_objective import CRITICALITY, MultiObjectiveConfig
from brink.search.analysis.comparison import control_summaries
from brink.search.errors import TooManyPairs
from brink.search.space import FloatArray
from brink.server.api.schemas import SolutionPage
from brink.server.campaigns.body import DEFAULT_D_TH, DEFAULT_T_B
from brink.server.csv_text import csv_text
from brink.server.findings.boundary.views import Boundary
from brink.server.findings.combinations.views import Combinations
from brink.server.findings.finding import Finding, Findings, Role
from brink.server.findings.pairs.views import MOST_PAIRS, PairsView, PairView
from brink.server.findings.tolerances.views import ToleranceView
from brink.server.findings.violations.views import Violations
from brink.server.problems.npc_actions import UNAVOIDABLE_M, NpcActions
from brink.sim.errors import SimulatorError

CHAINS_DRAWN: Final = 3
TYPES_DRAWN: Final = 12
_PAIR_FORMATS: Final = ("jsonl", "csv")
_UNDRAWABLE: Final = (
    NoTrace,
    CoordinatorError,
    SimulatorError,
    LookupError,
    ValueError,
    TypeError,
    ArithmeticError,
)
"""A simulator may record anything, so a picture that fails is noted and left out."""


class KindFiles:
    """The files of one kind of findings: by default, its tables.

    Args:
        fetched: The campaign.
        finding: Its finding of the kind.

    Attributes:
        numbers: Solutions that are worth a replay, best first.
        notes: What else there is to say at the end of a run, in sentences.
        warning: Why a picture is missing; empty if none is.
    """

    def __init__(self, fetched: FetchedArchive, finding: Finding) -> None:
        self._fetched = fetched
        self._finding = finding
        self._path = f"/campaigns/{fetched.id}"
        self.numbers: Sequence[int] = ()
        self.notes: Sequence[str] = ()
        self.warning = ""

    async def read(self, api: Api) -> None:
        """Read what is written and drawn."""

    async def write(self, api: Api, folder: Path) -> list[Path]:
        """Write the tables as CSV, without empty ones; return the files."""
        files = []
        for table in self._finding.tables:
            if table.rows:
                params = {"format": "csv", "table": table.name}
                path = f"{self._path}/findings/{self._finding.kind}"
                files.append(folder / f"{table.name}.csv")
                files[-1].write_bytes((await api.request("GET", path, params=params)).content)
        return files

    async def draw(self, drawing: Drawing) -> list[Path]:
        """Draw the pictures; return the files of those that could be drawn."""
        return []

    def summary(self) -> dict[str, Any]:
        """Return what ``brink run --json`` prints of this kind besides its sentence."""
        return {}

    @property
    def marked(self) -> PairsView | TooManyPairs | None:
        """The pairs to mark in figures of all solutions, instead of boundary solutions."""
        return None


class PairFiles(KindFiles):
    """Pairs with all parameters, and a picture of the one with the best evidence."""

    _view: PairsView | TooManyPairs
    _tables: Mapping[str, bytes]

    @property
    def marked(self) -> PairsView | TooManyPairs | None:
        """The pairs, if the search was for them."""
        return self._view if self._finding.role is Role.SOUGHT else None

    async def read(self, api: Api) -> None:
        """Read the pairs and their tables."""
        self._view, tables = await read_all_pairs(api, self._fetched.id), {}
        for form in _PAIR_FORMATS if isinstance(self._view, PairsView) and self._view.pairs else ():
            params = {"limit": MOST_PAIRS, "format": form}
            tables[form] = (await api.request("GET", f"{self._path}/pairs", params=params)).content
        self._tables = tables

    async def write(self, api: Api, folder: Path) -> list[Path]:
        """Write the pairs with all parameters, unless there is none; return the files."""
        files = []
        for form, table in self._tables.items():
            files.append(folder / f"pairs.{form}")
            files[-1].write_bytes(table)
        return files

    def differs_from(self, file: Path) -> bool:
        """Return whether a file that `write` wrote says something else by now."""
        return bool(self._tables) and file.read_bytes() != self._tables[file.suffix.removeprefix(".")]

    async def draw(self, drawing: Drawing) -> list[Path]:
        """Draw the pair with the best evidence if the search was for pairs; return the files.

        If an earlier run drew another one, that is drawn again, because more may be known of it by now.
        """
        view = self.marked
        if not isinstance(view, PairsView) or not view.pairs or drawing.stop.is_set():
            return []
        chosen = [view.pairs[0]]
        first = find_pair(view, 1)
        if first is not None and first != chosen[0] and _file_of(drawing, first).is_file():
            chosen.append(first)
        files = []
        for pair in chosen:
            file = _file_of(drawing, pair)
            try:
                # Not by workers: after --resume of a finished campaign there is none.
                await write_pair(drawing.api, view, pair, file, workers=False, show=drawing.show)
            except _UNDRAWABLE as error:
                self.warning = f"no picture of pair {pair.place}: {error}"
                break
            files.append(file)
        return files

    def summary(self) -> dict[str, Any]:
        """Return the counts of pairs; the pairs themselves are in the files."""
        if isinstance(self._view, TooManyPairs):
            searched = self._finding.role is Role.SOUGHT
            return {"pairs": {"searched": searched, "too_many": str(self._view)}}
        left_out = {"pairs", "table", "legend", "follow_ups", "offers", "name", "campaign"}
        return {"pairs": self._view.model_dump(mode="json", exclude=left_out)}


def _file_of(drawing: Drawing, pair: PairView) -> Path:
    return drawing.folder / f"pair-{pair.place}.png"


class _BoundaryFiles(KindFiles):
    """Boundary solutions with all that their episodes measured, replays, and the comparison with a control."""

    _view: Boundary
    _control: Sequence[str]

    async def read(self, api: Api) -> None:
        params = {"t_b": DEFAULT_T_B, "d_th": DEFAULT_D_TH}
        self._view = await api.read(Boundary, f"{self._path}/boundary", params)
        self.numbers = [one.number for one in self._view.solutions if one.spec is not None]
        compared = compared_archives([self._fetched], control=True)
        self._control = control_summaries(compared, DEFAULT_T_B, DEFAULT_D_TH)
        if self._finding.role is Role.SOUGHT:
            self.notes = self._control

    async def write(self, api: Api, folder: Path) -> list[Path]:
        if not self._view.solutions and self._finding.role is not Role.SOUGHT:
            return []
        files = [folder / "boundary.csv", folder / "boundary.json"]
        files[0].write_bytes(
            (await api.request("GET", f"{self._path}/boundary", params={"format": "csv"})).content
        )
        write_json(files[1], self._view.model_dump(mode="json"))
        return files

    def summary(self) -> dict[str, Any]:
        told = self._view.model_dump(
            mode="json", include={"t_b", "d_th", "dbs", "strict_dbs", "grid", "within_budget"}
        )
        return {**told, "control": list(self._control)}


class _ToleranceFiles(KindFiles):
    """The requirement as a document, and the curves."""

    _view: ToleranceView

    async def read(self, api: Api) -> None:
        self._view = await api.read(ToleranceView, f"{self._path}/tolerance")
        self.numbers = [cell.examples[0].number for cell in self._view.cells if cell.examples]

    async def write(self, api: Api, folder: Path) -> list[Path]:
        document, page = folder / "tolerance.json", folder / "tolerance.md"
        write_json(document, self._view.model_dump(mode="json"))
        page.write_text(requirement_document(self._view, "tolerance.png"), encoding="utf-8")
        return [*await super().write(api, folder), document, page]

    async def draw(self, drawing: Drawing) -> list[Path]:
        file = drawing.folder / "tolerance.png"
        await asyncio.to_thread(draw_tolerance, self._view, file)
        return [file]


def draw_tolerance(view: ToleranceView, path: Path) -> None:
    """Draw the curves of a campaign to a file."""
    # matplotlib takes half a second to load: only commands that draw wait for it.
    from brink.plots.tolerance import figure_tolerance

    figure_tolerance(view).savefig(path)


class _CombinationFiles(KindFiles):
    """The chains with all details, and pictures of the clearest ones beside their parts."""

    _view: Combinations

    async def read(self, api: Api) -> None:
        self._view = await api.read(Combinations, f"{self._path}/combinations")

    async def write(self, api: Api, folder: Path) -> list[Path]:
        document = folder / "combinations.json"
        write_json(document, self._view.model_dump(mode="json"))
        return [document, *await super().write(api, folder)]

    async def draw(self, drawing: Drawing) -> list[Path]:
        return await draw_chains(self._view, drawing, CHAINS_DRAWN)


class _ThresholdFiles(KindFiles):
    """How likely a violation is along the unit of each threshold."""

    async def draw(self, drawing: Drawing) -> list[Path]:
        if self._finding.view is None:
            return []
        file = drawing.folder / "thresholds.png"
        await asyncio.to_thread(draw_thresholds, self._finding, file)
        return [file]


class _ViolationFiles(KindFiles):
    """Every violation, figures of the types over time, and an example of each of the first types."""

    _view: Violations

    async def read(self, api: Api) -> None:
        self._view = await api.read(Violations, f"{self._path}/violations")

    async def write(self, api: Api, folder: Path) -> list[Path]:
        return [*write_violations(self._view, folder), *await super().write(api, folder)]

    async def draw(self, drawing: Drawing) -> list[Path]:
        files = [await asyncio.to_thread(draw_types, self._view, drawing.folder)]
        config = self._fetched.plan.config
        if isinstance(config, MultiObjectiveConfig):
            criticality = await _criticality(drawing.api, self._fetched)
            fronts = await asyncio.to_thread(_draw_fronts, self._fetched, config, criticality, drawing.folder)
            files.append(fronts)
        return files + await draw_gallery(self._view, drawing, TYPES_DRAWN)


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
    table.write_text(csv_text([header, *rows]), encoding="utf-8", newline="")
    return [document, table]


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


FILES: Final[Mapping[str, type[KindFiles]]] = {
    "pairs": PairFiles,
    "boundary": _BoundaryFiles,
    "thresholds": _ThresholdFiles,
    "tolerances": _ToleranceFiles,
    "combinations": _CombinationFiles,
    "violations": _ViolationFiles,
}


async def read_files(api: Api, fetched: FetchedArchive, found: Findings) -> dict[str, KindFiles]:
    """Return the files of each kind of findings of a campaign, not written yet, by kind."""
    files = {one.kind: FILES.get(one.kind, KindFiles)(fetched, one) for one in found.findings}
    for one in files.values():
        await one.read(api)
    return files
