"""`brink init`: a campaign file for a program of one's own, from options, questions or OpenSCENARIO files."""

import os
import shlex
import shutil
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from brink.cli.options import AsJson, check_out, console, named_values, plain_table, print_json, program
from brink.scenarios.logical.distributions import Distributions, scenario_of
from brink.scenarios.logical.document import Document, read_document
from brink.scenarios.logical.laws import Law
from brink.server.errors import InvalidInput
from brink.sim.adapters.command.definition import with_contents
from brink.sim.errors import DefinitionError

if TYPE_CHECKING:
    from brink.scenarios.logical.campaign import Draft
    from brink.scenarios.logical.space import Axis, LogicalScenario, Wishes
    from brink.scenarios.logical.template import Template

SCENARIO_FILE: Final = "scenario.xosc"
"""Name of the scenario in the working folder."""
ESMINI: Final = (
    *("esmini", "--osc", SCENARIO_FILE, "--headless", "--fixed_timestep", "0.01"),
    *("--csv_logger", "log.csv", "--seed", "{seed}"),
)
"""The command of esmini, by its documentation."""
BUDGET: Final = 200
_MOST_BUDGET: Final = 10_000_000
_TIMES: Final = ("always", "eventually", "until")
_SHOWN: Final = 8


def init(
    from_: Annotated[
        Path | None,
        typer.Option(
            "--from",
            metavar="FILE",
            help="OpenSCENARIO file with parameters, or a distribution file that names it.",
        ),
    ] = None,
    distribution: Annotated[
        Path | None, typer.Option(metavar="FILE", help="OpenSCENARIO file with a ParameterValueDistribution.")
    ] = None,
    command: Annotated[
        str | None,
        typer.Option(
            help="Program and arguments, with placeholders such as {gap}; of a scenario by default esmini's."
        ),
    ] = None,
    ranges: Annotated[
        list[str] | None,
        typer.Option(
            "--range",
            metavar="NAME=LOW:HIGH",
            help="Range of a parameter, or LOW:HIGH:STEP, or VALUE,VALUE; may be repeated.",
        ),
    ] = None,
    keep: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="Parameter that keeps its declared value; may be repeated."),
    ] = None,
    keep_others: Annotated[
        bool,
        typer.Option("--keep-others", help="Keep the declared values of all parameters without a range."),
    ] = False,
    log: Annotated[
        str, typer.Option(help="Log that the program writes: CSV, JSON or JSON lines.")
    ] = "log.csv",
    time: Annotated[
        str | None, typer.Option(metavar="COLUMN", help="Column of the log with the time in s.")
    ] = None,
    requirement: Annotated[
        str | None, typer.Option(metavar="FORMULA", help="What must hold throughout, such as 'gap_m > 0.5'.")
    ] = None,
    unit: Annotated[
        str | None, typer.Option(help="Unit of the numbers in the requirement, such as m.")
    ] = None,
    out: Annotated[Path | None, typer.Option(metavar="FILE", help="Campaign file to write (YAML).")] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite existing files.")] = False,
    as_json: AsJson = False,
) -> None:
    """Write a campaign file for command@1; on a terminal, ask for what no option says.

    The parameters of an OpenSCENARIO file become the search space, and a template of it is written beside the file.

    Example: brink init --from cut-in.xosc --command "./sim {seed}" --range gap=5:60 --out cut-in.yaml
    """
    from brink.scenarios.logical.space import Wishes
    from brink.scenarios.logical.template import template_of

    asks = _is_terminal() and not as_json
    if asks and from_ is None and command is None:
        given = typer.prompt(
            "OpenSCENARIO file with parameters (Enter for none)", default="", show_default=False
        )
        from_ = Path(given) if given else None
    if out is None:
        if not asks:
            raise InvalidInput.at("--out", "expected the name of a campaign file, such as cut-in.yaml")
        usual = "campaign" if from_ is None else from_.stem
        out = Path(typer.prompt("Campaign file to write", default=f"{usual}.yaml"))
    template_file = out.with_name(f"{out.stem}-template.xosc")
    check_out(out, ".yaml", ".yml")
    _check_free([out] if from_ is None else [out, template_file], [from_, distribution], force=force)
    wishes = Wishes(
        ranges=named_values("--range", ranges, "gap=5:60", read=str),
        keep=frozenset(keep or ()),
        keep_others=keep_others,
    )
    if from_ is None:
        if distribution is not None or keep or keep_others:
            raise InvalidInput.at(
                "--from", "expected an OpenSCENARIO file, whose parameters the options are about"
            )
        if command is None and asks:
            command = typer.prompt(
                "Program and arguments, with a placeholder such as {gap} for each parameter"
            )
        if command is None:
            raise InvalidInput.at("--command", "expected --command, or --from with an OpenSCENARIO file")
        if not wishes.ranges and asks:
            wishes = replace(wishes, ranges=_asked_parameters())
        logical = template = None
        axes = _plain_axes(wishes.ranges)
    else:
        scenario, distribution_file = _documents(from_, distribution)
        logical = _logical(scenario, distribution_file, wishes, asks=asks)
        template = template_of(logical)
        axes = logical.axes
        if command is None and asks:
            command = typer.prompt("Program and arguments", default=shlex.join(ESMINI))
    if requirement is None and asks:
        requirement = typer.prompt(
            "What must hold throughout, such as gap_m > 0.5 (Enter to decide later)",
            default="",
            show_default=False,
        )
    draft = _draft(out, logical, template, axes, command, log, time, requirement or None, unit)
    _check(draft, template, out.parent)
    written = {out: draft.text().encode()}
    if template is not None:
        written = {template_file: template.content, **written}
    _write(written)
    if as_json:
        print_json(_document(draft, logical, list(written)))
    else:
        _show(draft, logical, list(written))


def _is_terminal() -> bool:
    return sys.stdin.isatty() and sys.stdout.isatty()


def _check_free(written: Sequence[Path], read: Sequence[Path | None], *, force: bool) -> None:
    for path in written:
        if any(one is not None and path.absolute() == one.absolute() for one in read):
            raise InvalidInput.at("--out", f"{path} is read: name another file")
        if path.exists() and not force:
            raise InvalidInput.at("--out", f"{path} exists: name another file, or overwrite it with --force")


def _documents(from_: Path, distribution: Path | None) -> tuple[Document, Document | None]:
    """Return a scenario, and its distribution file if there is one.

    Raises:
        InvalidInput: A file is malformed, or the scenario of a distribution file is not there.
    """
    first = read_document(from_)
    if first.root.first("ParameterValueDistribution") is None:
        return first, None if distribution is None else read_document(distribution)
    if distribution is not None:
        raise InvalidInput.at(
            "--from", f"{from_} is a distribution file: expected a scenario, or no --distribution"
        )
    named, element = scenario_of(first)
    beside = from_.parent / Path(named.replace("\\", "/")).name
    for path in (from_.parent / named, beside):
        if path.is_file():
            return read_document(path), first
    raise first.error(
        element,
        f"its scenario {named} is not there, nor {beside}: name it with --from, and this file with --distribution",
    )


def _logical(
    scenario: Document, distribution: Document | None, wishes: "Wishes", *, asks: bool
) -> "LogicalScenario":
    """Return a scenario with its search space, after asking for ranges that are missing."""
    from brink.scenarios.logical.space import MissingRanges, logical_scenario

    while True:
        try:
            return logical_scenario(scenario, distribution, wishes)
        except MissingRanges as error:
            if not asks:
                raise
            ranges, keep = dict(wishes.ranges), set(wishes.keep)
            for declaration, suggested in error.missing:
                hint = (
                    f", such as {suggested}"
                    if suggested and not {"LOW", "HIGH"} & set(suggested.split(":"))
                    else ""
                )
                answer = typer.prompt(
                    f"{declaration.name} ({declaration.type}): LOW:HIGH or VALUE,VALUE{hint} (Enter to keep "
                    f"{declaration.value.strip()})",
                    default="",
                    show_default=False,
                )
                if answer:
                    ranges[declaration.name] = answer
                else:
                    keep.add(declaration.name)
            wishes = replace(wishes, ranges=ranges, keep=frozenset(keep))


def _asked_parameters() -> dict[str, str]:
    ranges: dict[str, str] = {}
    while True:
        answer = typer.prompt(
            "Parameter, such as gap=5:60 or road=dry,wet (Enter after the last)",
            default="",
            show_default=False,
        )
        if not answer:
            return ranges
        ranges |= named_values("parameter", [answer], "gap=5:60", read=str)


def _plain_axes(ranges: Mapping[str, str]) -> "tuple[Axis, ...]":
    """Return the parameters that options alone describe."""
    from brink.scenarios.logical.space import Axis

    axes = []
    for name, text in ranges.items():
        declared: dict[str, Any]
        if ":" in text:
            try:
                numbers = [
                    int(one) if one.strip().lstrip("+-").isdecimal() else float(one)
                    for one in text.split(":")
                ]
                declared = dict(zip(("min", "max", "step"), numbers, strict=False))
            except ValueError:
                numbers = []
            if len(numbers) not in (2, 3):
                raise InvalidInput.at(
                    "--range", f"{name}: expected LOW:HIGH or LOW:HIGH:STEP, got {text!r:.80}"
                )
            rows: tuple[dict[str, str], ...] = ()
        else:
            values = [one.strip() for one in text.split(",")]
            declared, rows = {"values": values}, tuple({name: one} for one in values)
        axes.append(Axis(name=name, placeholders={name: name}, declared=declared, rows=rows))
    if not axes:
        raise InvalidInput.at("--range", "expected at least one parameter, such as --range gap=5:60")
    return tuple(axes)


def _draft(
    out: Path,
    logical: "LogicalScenario | None",
    template: "Template | None",
    axes: "tuple[Axis, ...]",
    command: str | None,
    log: str,
    time: str | None,
    requirement: str | None,
    unit: str | None,
) -> "Draft":
    from brink.scenarios.logical.campaign import Draft

    guesses: dict[str, str] = {}
    if command is None:
        words = list(ESMINI)
        guesses["command"] = "your simulator; this is the command of esmini"
    else:
        try:
            words = shlex.split(command)
        except ValueError as error:
            raise InvalidInput.at("--command", f"expected a program and its arguments: {error}") from None
        if not words:
            raise InvalidInput.at("--command", "expected a program and its arguments, got nothing")
    of_esmini = Path(words[0]).name == "esmini"
    signals: dict[str, Any] = {"file": log, "time": time or ("TimeStamp [s]" if of_esmini else "time")}
    if requirement is not None:
        held = requirement if any(word in requirement for word in _TIMES) else f"always ({requirement})"
        requirements: dict[str, Any] = {"safe": {"stl": held, "unit": unit or "1"}}
        if unit is None:
            guesses["requirements"] = "the unit of its numbers, 1 if they have none"
    else:
        signals, requirements, guesses["requirements"] = _guessed_requirement(
            signals, logical, of_esmini=of_esmini
        )
    if time is None and not of_esmini:
        guesses["signals"] = "the log that your simulator writes, and its column with the time in s"
    distributions = None if logical is None else logical.distributions
    runs = None if distributions is None else distributions.runs
    copies = (
        {} if template is None else {name: _relative(path, out) for name, path in template.copies.items()}
    )
    return Draft(
        name=out.stem,
        origin=_origin(logical),
        command=words,
        files={} if template is None else {SCENARIO_FILE: f"{out.stem}-template.xosc"},
        copies=_scripts(words, out, {SCENARIO_FILE, log}) | copies,
        axes=axes,
        constraints=() if logical is None else logical.constraints,
        signals=signals,
        requirements=requirements,
        budget=BUDGET if runs is None else min(max(runs, 1), _MOST_BUDGET),
        guesses=guesses,
        notes=_notes(logical, template, distributions),
    )


def _origin(logical: "LogicalScenario | None") -> str:
    if logical is None:
        return "the options of brink init"
    return f"{logical.document.path.name} by brink init"


def _notes(
    logical: "LogicalScenario | None", template: "Template | None", distributions: Distributions | None
) -> list[str]:
    notes = [] if logical is None or template is None else [*logical.notes, *template.notes]
    if distributions is not None and distributions.runs is not None:
        seed = (
            "" if distributions.random_seed is None else f" and the random seed {distributions.random_seed}"
        )
        notes.append(
            f"the distribution file asks for {distributions.runs} test runs{seed}; see budget and seed"
        )
    return notes


def _guessed_requirement(
    signals: dict[str, Any], logical: "LogicalScenario | None", *, of_esmini: bool
) -> tuple[dict[str, Any], dict[str, Any], str]:
    """Return signals and a requirement that a user has yet to state, and what to state."""
    if not of_esmini or logical is None:
        return (
            signals,
            {"safe": {"signal": "gap_m", "above": 0.0, "unit": "m"}},
            "a column of the log, and its limit",
        )
    entities = logical.document.root.first("Entities")
    if entities is None or len(entities.all("ScenarioObject")) < 2:
        speed = {"signal": "#1 Current_Speed [m/s]", "below": 50.0, "unit": "m/s"}
        return signals, {"slow": speed}, "a column of the log, and its limit"
    x, y = (f"`#1 World_Position_{axis} [m]` - `#2 World_Position_{axis} [m]`" for axis in "XY")
    return (
        signals | {"columns": {"distance_m": f"hypot({x}, {y})"}},
        {"apart": {"signal": "distance_m", "above": 5.0, "unit": "m"}},
        "how far apart the first two road users must stay, between their reference points",
    )


def _scripts(words: Sequence[str], out: Path, known: set[str]) -> dict[str, str]:
    """Return the files here that arguments name by a relative path: the working folder needs a copy."""
    relative = [one for one in words[1:] if not Path(one).is_absolute() and ".." not in Path(one).parts]
    named = [one for one in relative if one not in known]
    return {one: _relative(Path(one), out) for one in named if Path(one).is_file()}


def _relative(path: Path, out: Path) -> str:
    return os.path.relpath(path.absolute(), out.parent.absolute())


def _check(draft: "Draft", template: "Template | None", folder: Path) -> None:
    """Check that the campaign is valid but for the program, which need not be on this machine.

    Raises:
        InvalidInput: It is not.
    """
    from brink.server.problems.catalogue import make_problem

    params = draft.params()
    if template is not None:
        params["files"] = {SCENARIO_FILE: {"content": template.content.decode()}}
    try:
        params = with_contents(params, folder)
    except DefinitionError as error:
        raise InvalidInput.at(f"/problem/params/{error.field}", str(error)) from None
    make_problem("command@1", params)


def _write(files: Mapping[Path, bytes]) -> None:
    """Write all files, or none."""
    partial = {path: path.with_name(f".{path.name}.{os.getpid()}") for path in files}
    try:
        for path, content in files.items():
            partial[path].write_bytes(content)
        for path, one in partial.items():
            one.replace(path)
    finally:
        for one in partial.values():
            one.unlink(missing_ok=True)


def _space_words(declared: Mapping[str, Any]) -> str:
    if "values" in declared:
        values = declared["values"]
        shown = ", ".join(values[:_SHOWN]) + (", …" if len(values) > _SHOWN else "")
        gives = "; ".join(
            f"{name}: {', '.join(texts[:_SHOWN])}" + (", …" if len(texts) > _SHOWN else "")
            for name, texts in declared.get("gives", {}).items()
        )
        return f"{shown} ({gives})" if gives else shown
    step = f" in steps of {declared['step']:g}" if "step" in declared else ""
    return f"{declared['min']:g} to {declared['max']:g}{step}"


def _law_words(law: Law | None) -> str:
    if law is None:
        return ""
    match law["kind"]:
        case "weights":
            shares = [f"{value} {share:.3g}" for value, share in law["weights"].items()]
            return "weights " + ", ".join(shares[:_SHOWN]) + (", …" if len(shares) > _SHOWN else "")
        case "histogram":
            return f"histogram of {len(law['weights'])} bins"
    numbers = ", ".join(f"{name} {law[name]:g}" for name in ("mean", "sd") if name in law)
    return f"{law['kind']} {numbers}".strip()


def _document(draft: "Draft", logical: "LogicalScenario | None", written: Sequence[Path]) -> dict[str, Any]:
    return {
        "files": [str(path) for path in written],
        "parameters": [
            {
                "name": axis.name,
                "sets": dict(axis.placeholders),
                "space": dict(axis.declared),
                "distribution": axis.law,
            }
            for axis in draft.axes
        ],
        "constraints": list(draft.constraints),
        "fixed": {} if logical is None else dict(logical.fixed),
        "notes": list(draft.notes),
        "edit": dict(draft.guesses),
    }


def _show(draft: "Draft", logical: "LogicalScenario | None", written: Sequence[Path]) -> None:
    screen = console()
    rows = [(axis.name, _space_words(axis.declared), _law_words(axis.law), axis.about) for axis in draft.axes]
    screen.print(plain_table("parameter", "values", "distribution", "from", rows=rows))
    for one in draft.constraints:
        screen.print(f"constraint: {one}", soft_wrap=True, markup=False)
    for name, value in ({} if logical is None else logical.fixed).items():
        screen.print(f"fixed: {name} = {value}", soft_wrap=True, markup=False)
    for one in draft.notes:
        screen.print(f"note: {one}", soft_wrap=True, markup=False)
    out = written[-1]
    for path in written:
        screen.print(f"wrote {path}", soft_wrap=True, markup=False)
    for name, words in draft.guesses.items():
        screen.print(f"edit {name}: {words}", soft_wrap=True, markup=False)
    name = draft.command[0]
    if shutil.which(str(out.parent / name) if "/" in name else name) is None:
        screen.print(f"the program {name} is not on this machine", soft_wrap=True, markup=False)
    screen.print(f"next: {program()} try {shlex.quote(str(out))}", soft_wrap=True, markup=False)
