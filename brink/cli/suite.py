"""`brink suite`: drives that were found once, simulated again with every version of a system.

Exit codes of `brink suite run`: 0 if every drive is as expected, 1 if one is not, 2 for wrong usage or a wrong file.
"""

import asyncio
import functools
import re
from collections.abc import Callable, Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, ParamSpec

import typer
from rich.console import Console

from brink.api.client import Api
from brink.api.following import Silent, follow
from brink.api.live import Steps
from brink.api.terminal import echo
from brink.cli.findings import print_table
from brink.cli.local import CommandSession, run_locally, stopping
from brink.cli.options import (
    AsJson,
    Database,
    New,
    Server,
    Workers,
    check_out,
    console,
    named_values,
    plain_table,
    print_json,
    print_line,
    settings_with,
    with_api,
)
from brink.server.errors import InvalidInput
from brink.user_file import read_text
from brink.worker.printable import printable

if TYPE_CHECKING:
    from brink.api.suites import Chosen
    from brink.server.suites.campaigns import SystemRun
    from brink.server.suites.file import SuiteFile
    from brink.server.suites.results import CaseResult, SuiteResults

USAGE: Final = 2
PAIRS: Final = ("confirmed", "all")
PAIR: Final = re.compile(r"\d{1,9}-\d{1,9}")
EXAMPLE: Final = "detector=onnx:new.onnx"
MOST_PICTURES: Final = 20

suite = typer.Typer(
    name="suite",
    help="Keep hazards fixed: simulate drives again that were found earlier.",
    no_args_is_help=True,
    rich_markup_mode=None,
)
P = ParamSpec("P")


def _usage(command: Callable[P, None]) -> Callable[P, None]:
    """Let a command exit with 2 on wrong input, so that a CI can tell it from a hazard."""

    @functools.wraps(command)
    def run(*args: P.args, **kwargs: P.kwargs) -> None:
        try:
            command(*args, **kwargs)
        except InvalidInput as error:
            for one in error.errors:
                echo(f"brink: {printable(str(one))}", err=True)
            raise typer.Exit(USAGE) from None

    return run


class ViolationsTaken(StrEnum):
    """Which types of violations of a campaign to take."""

    AVOIDABLE = "avoidable"
    ALL = "all"


SuitePath = Annotated[Path, typer.Argument(metavar="FILE", help="Suite file.", show_default=False)]
Campaigns = Annotated[
    list[str], typer.Argument(metavar="ID...", help="Campaigns to take drives from.", show_default=False)
]
Pairs = Annotated[
    str | None,
    typer.Option(
        metavar="confirmed|all|N-N,...",
        help="Take pairs, both drives of each: the confirmed ones, all, or some by the numbers of their drives.",
        show_default=False,
    ),
]
Violated = Annotated[
    ViolationsTaken | None,
    typer.Option(
        help="Take a drive of each type of violations: avoidable takes the types that a careful driver avoids.",
        show_default=False,
    ),
]
Solutions = Annotated[
    str | None,
    typer.Option(metavar="N,N,...", help="Take solutions by number, such as 3,17.", show_default=False),
]
Thresholds = Annotated[
    bool, typer.Option("--thresholds", help="Take the drives at both ends of each threshold.")
]
Named = Annotated[
    str, typer.Option("--name", help="Name of the entries; several are numbered (default: what happened).")
]


def _chosen(
    pairs: str | None, violations: ViolationsTaken | None, solutions: str | None, *, thresholds: bool
) -> "Chosen":
    from brink.api.suites import Chosen

    if pairs not in (None, *PAIRS) and not all(map(PAIR.fullmatch, str(pairs).split(","))):
        raise InvalidInput.at(
            "--pairs", f"expected {' or '.join(PAIRS)}, or pairs such as 12-40,3-17; got {pairs!r}"
        )
    numbers = []
    for one in filter(None, map(str.strip, (solutions or "").split(","))):
        if not one.isdecimal():
            raise InvalidInput.at("--solutions", f"expected numbers such as 3,17; got {solutions!r}")
        numbers.append(int(one))
    if not (pairs or violations or numbers or thresholds):
        raise InvalidInput.at(
            "--pairs",
            "expected one of --pairs, --violations, --solutions, --thresholds: which drives to take",
        )
    return Chosen(
        pairs=pairs or "",
        violations=violations or "",
        solutions=list(dict.fromkeys(numbers)),
        thresholds=thresholds,
    )


@suite.command()
@_usage
def create(
    campaigns: Campaigns,
    out: Annotated[Path, typer.Option(help="File to write.")] = Path("hazards.yaml"),
    pairs: Pairs = None,
    violations: Violated = None,
    solutions: Solutions = None,
    thresholds: Thresholds = False,
    name: Named = "",
    force: Annotated[bool, typer.Option("--force", help="Replace an existing file.")] = False,
    database: Database = None,
    server: Server = None,
) -> None:
    """Write a suite file with drives that campaigns found.

    Example: brink suite create 3f2a --pairs confirmed --out hazards.yaml
    """
    check_out(out, ".yaml", ".yml")
    if out.exists() and not force:
        raise InvalidInput.at("--out", f"{out} exists: brink suite add {out} adds to it, --force replaces it")
    chosen = _chosen(pairs, violations, solutions, thresholds=thresholds)
    _add(out, campaigns, chosen, name, server, database, new=True)


@suite.command()
@_usage
def add(
    file: SuitePath,
    campaigns: Campaigns,
    pairs: Pairs = None,
    violations: Violated = None,
    solutions: Solutions = None,
    thresholds: Thresholds = False,
    name: Named = "",
    database: Database = None,
    server: Server = None,
) -> None:
    """Add drives that campaigns found to a suite file; nothing else in it changes.

    Example: brink suite add hazards.yaml 3f2a --solutions 17 --name late-braking
    """
    from brink.server.suites.file import read_suite

    read_suite(file)
    _add(
        file,
        campaigns,
        _chosen(pairs, violations, solutions, thresholds=thresholds),
        name,
        server,
        database,
        new=False,
    )


def _add(
    file: Path,
    campaigns: Sequence[str],
    chosen: "Chosen",
    name: str,
    server: str | None,
    database: str | None,
    *,
    new: bool,
) -> None:
    from brink.api.suites import NewEntries, find_entries
    from brink.server.suites.campaigns import system_name
    from brink.server.suites.file import add_entries, read_suite, write_suite

    screen = console()

    async def work(api: Api) -> list[NewEntries]:
        return [await find_entries(api, campaign, chosen) for campaign in campaigns]

    found = with_api(server, database, work)
    known = None if new else read_suite(file)
    systems = {} if known is None else dict(known.systems)
    have = [] if known is None else known.entries
    taken, kept = [entry.name for entry in have], []
    drives = {str((entry.system, side, drive.values)) for entry in have for side, drive in entry.drives()}
    again = 0
    for one in found:
        for note in one.notes:
            screen.print(f"campaign {one.campaign}: {note}", soft_wrap=True)
        system = system_name(one.system, systems)
        systems[system] = one.system
        for entry in one.named(system, name, taken):
            keys = {str((system, side, drive.values)) for side, drive in entry.entry.drives()}
            if keys <= drives:
                again += 1
                continue
            drives |= keys
            kept.append(entry)
            taken.append(entry.entry.name)
    if again:
        screen.print(f"{again} already in the suite")
    if not kept:
        raise InvalidInput.at(str(file), "nothing to add")
    written = write_suite(file, systems, kept) if new else add_entries(file, systems, kept)
    screen.print(
        f"{file}: {len(kept)} entries {'written' if new else f'added, {len(written.entries)} in all'}; simulate them "
        f"with: brink suite run {file}",
        soft_wrap=True,
    )


@suite.command()
@_usage
def remove(
    file: SuitePath, names: Annotated[list[str], typer.Argument(metavar="NAME...", help="Entries to remove.")]
) -> None:
    """Remove entries from a suite file.

    Example: brink suite remove hazards.yaml late-braking
    """
    from brink.server.suites.file import remove_entries

    left = remove_entries(file, names)
    print_line(f"{file}: {len(left.entries)} entries left")


@suite.command()
@_usage
def rename(
    file: SuitePath,
    name: Annotated[str, typer.Argument(metavar="NAME", help="The entry.")],
    new: Annotated[str, typer.Argument(metavar="NEW", help="Its new name.")],
) -> None:
    """Rename an entry of a suite file.

    Example: brink suite rename hazards.yaml hit-a-pedestrian-17 late-braking
    """
    from brink.server.suites.file import rename_entry

    rename_entry(file, name, new)
    print_line(f"{file}: {name} is now {new}")


@suite.command()
@_usage
def show(file: SuitePath, as_json: AsJson = False) -> None:
    """Show the entries of a suite file.

    Example: brink suite show hazards.yaml
    """
    from brink.server.suites.campaigns import cases_of
    from brink.server.suites.file import read_suite

    read = read_suite(file)
    if as_json:
        print_json(read.model_dump(mode="json"))
        return
    table = plain_table("drive", "kind", "system", "expected", "evidence", "found", "tags")
    for case in cases_of(read):
        table.add_row(
            case.name,
            case.entry.kind,
            case.entry.system,
            case.drive.expect,
            case.drive.evidence,
            case.drive.found,
            " ".join(case.entry.tags),
        )
    console().print(table)


@suite.command()
@_usage
def run(
    file: SuitePath,
    changes: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="NAME=VALUE",
            show_default=False,
            help="Simulate with another value of a parameter of the problem, such as detector=onnx:new.onnx, "
            "driving=idm:Idm or fidelity=bicycle; may be repeated.",
        ),
    ] = None,
    label: Annotated[
        str, typer.Option(help="What is tested, such as a release (default: what is changed).")
    ] = "",
    tag: Annotated[
        str | None, typer.Option(help="Simulate only entries with this tag.", show_default=False)
    ] = None,
    junit: Annotated[
        Path | None, typer.Option(help="JUnit XML file to write, for a CI.", show_default=False)
    ] = None,
    comment: Annotated[
        Path | None,
        typer.Option("--markdown", help="Markdown file to write, for a pull request.", show_default=False),
    ] = None,
    pictures: Annotated[
        Path | None,
        typer.Option(
            help="Folder for a picture of each drive that is not as expected; --markdown shows them.",
            show_default=False,
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Results file to write, for --against and for the matrix.", show_default=False),
    ] = None,
    against: Annotated[
        Path | None, typer.Option(help="Results of an earlier run, to compare with.", show_default=False)
    ] = None,
    new: New = False,
    workers: Workers = 2,
    database: Database = None,
    server: Server = None,
    as_json: AsJson = False,
) -> None:
    """Simulate a suite and say which drives are broken, fixed, still unsafe or still safe.

    Each drive is simulated until a sequential test decides: a clear one 5 times, others up to 20 times. Without
    --server, the command runs a coordinator and workers. Exits with 0 if all is as expected, with 1 if not.

    Example: brink suite run hazards.yaml --set detector=onnx:new.onnx --junit hazards.xml
    """
    from brink.api.suites import suite_results
    from brink.report.campaign import write_page
    from brink.report.suite import junit_xml, markdown
    from brink.server.findings.suite.table import cases_table
    from brink.server.suites.campaigns import cases_of, prepare_runs
    from brink.server.suites.file import read_suite
    from brink.server.suites.results import sorted_cases

    for option, path, endings in (
        ("--junit", junit, (".xml",)),
        ("--markdown", comment, (".md",)),
        ("--out", out, (".json",)),
    ):
        if path is not None:
            check_out(path, *endings, option=option)
    earlier = None if against is None else _read_results(against, "--against")
    given = named_values("--set", changes, EXAMPLE)
    read = _tagged(read_suite(file), tag)
    runs = prepare_runs(read, given, name=file.stem, path=file, here=server is None)
    screen = console(stderr=as_json)
    _notes(screen, runs)
    cases, complete, drawn = _simulate(
        runs, screen, workers, database, server, label=label, resume=not new, pictures=pictures
    )
    results = suite_results(
        file.stem,
        runs,
        cases,
        [case.name for case in cases_of(read)],
        changes=given,
        label=label,
        complete=complete,
    )
    if earlier is not None:
        results = results.compared(earlier)
    if out is not None:
        write_page(out, results.model_dump_json(indent=1) + "\n")
    if junit is not None:
        write_page(junit, junit_xml(results))
    if comment is not None:
        write_page(comment, markdown(results, drawn))
    if as_json:
        print_json(results.model_dump(mode="json"))
    else:
        print_table(screen, cases_table(sorted_cases(results.cases)))
        screen.print(f"{results.words}.", soft_wrap=True)
    raise typer.Exit(int(not (results.passed and complete)))


def _tagged(file: "SuiteFile", tag: str | None) -> "SuiteFile":
    if tag is None:
        return file
    entries = [entry for entry in file.entries if tag in entry.tags]
    if not entries:
        known = sorted({one for entry in file.entries for one in entry.tags})
        raise InvalidInput.at("--tag", f"expected one of {', '.join(known) or 'none'}; got {tag!r}")
    return file.model_copy(update={"entries": entries})


def _notes(screen: Console, runs: "Sequence[SystemRun]") -> None:
    for run in runs:
        if run.unaffected:
            names = " and ".join(run.unaffected)
            screen.print(f"{run.system}: its problem has no parameter {names}, so it is simulated as it was")


def _simulate(
    runs: "Sequence[SystemRun]",
    screen: Console,
    workers: int,
    database: str | None,
    server: str | None,
    *,
    label: str,
    resume: bool,
    pictures: Path | None,
) -> "tuple[list[CaseResult], bool, dict[str, str]]":
    """Simulate a suite; return the verdicts, whether all simulations have ended, and pictures by drive."""
    from brink.api.suites import run_suite
    from brink.server.suites.results import CaseResult

    if server is None:

        async def work(session: CommandSession) -> tuple[list[CaseResult], bool, dict[str, str]]:
            async def with_workers(campaign: str) -> object:
                if not session.processes.pids:
                    session.processes.start(workers)
                return await session.follow_campaign(campaign)

            async with stopping(session.stop):
                cases, complete = await run_suite(session.api, runs, with_workers, label=label, resume=resume)
            return cases, complete, await _draw(session.api, cases, pictures, screen, elsewhere=False)

        return run_locally(settings_with(database=database, port=0), screen, work)

    async def ask(api: Api) -> tuple[list[CaseResult], bool, dict[str, str]]:
        cases, complete = await run_suite(
            api, runs, lambda campaign: follow(api, campaign, Silent()), label=label, resume=resume
        )
        return cases, complete, await _draw(api, cases, pictures, screen, elsewhere=True)

    return with_api(server, database, ask)


async def _draw(
    api: Api, cases: "Sequence[CaseResult]", folder: Path | None, screen: Console, *, elsewhere: bool
) -> dict[str, str]:
    """Draw each drive that is not as expected; return the files by drive."""
    from brink.api.results import UNDRAWABLE, fetch_requirements, trace_of
    from brink.pictures import render  # heavy, and only for pictures

    failing = [case for case in cases if not case.passed and case.solution is not None]
    if folder is None or not failing:
        return {}
    folder.mkdir(parents=True, exist_ok=True)
    files: dict[str, str] = {}
    with Steps(console(stderr=True), "drawing") as steps:
        for case in failing[:MOST_PICTURES]:
            assert case.solution is not None
            path = folder / f"{_file_name(case.name)}.png"
            try:
                trace = await trace_of(api, case.campaign, case.solution, workers=elsewhere)
                requirement = await fetch_requirements(api, case.campaign)
                drawn = steps.of(f"drawing {path}")
                await asyncio.to_thread(render, trace, path, requirement=requirement, on_progress=drawn)
            except UNDRAWABLE as error:
                screen.print(f"{case.name}: no picture: {error}", soft_wrap=True)
                continue
            files[case.name] = path.as_posix()
    return files


def _file_name(name: str) -> str:
    return "".join(letter if letter.isalnum() or letter in "-_." else "-" for letter in name)[:100]


def _read_results(path: Path, option: str) -> "SuiteResults":
    from brink.server.suites.results import MOST_RESULT_BYTES, parse_results

    try:
        return parse_results(read_text(path, MOST_RESULT_BYTES), f"{option} {path}")
    except (OSError, UnicodeDecodeError) as error:
        raise InvalidInput.at(option, f"{path}: {getattr(error, 'strerror', None) or error}") from None


@suite.command()
@_usage
def matrix(
    results: Annotated[
        list[Path],
        typer.Argument(
            metavar="RESULTS...", help="Results that brink suite run --out wrote.", show_default=False
        ),
    ],
    out: Annotated[Path, typer.Option(help="File to write: .html or .png.")] = Path("matrix.html"),
) -> None:
    """Draw the drives of a suite by versions: what turned unsafe is on top, the newest version comes first.

    Example: brink suite matrix 1.0.json 1.1.json --out matrix.html
    """
    from brink.report.campaign import write_page
    from brink.report.suite import matrix_page
    from brink.server.suites.matrix import matrix_of

    check_out(out, ".html", ".png")
    runs = [_read_results(path, "RESULTS") for path in results]
    drawn = matrix_of(runs)
    title = runs[0].suite
    if out.suffix == ".html":
        write_page(out, matrix_page(drawn, title))
    else:
        from brink.plots.suite import figure_matrix  # matplotlib takes half a second

        figure_matrix(drawn, title).savefig(out)
    print_line(f"{out}: {drawn.words}")
