"""Suite files: drives that were found once, to be simulated again with every version of a system.

A file has *systems*, which say what was tested, and *entries*. An entry has an unsafe drive, a safe one, or both,
which is a pair. Entries stay in the order in which they were added. Changes are made to the text of the file, so that
comments and the layout of everything else stay as they are.
"""

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self

import yaml
from pydantic import AfterValidator, Field, model_validator

from brink.search.space import SearchSpace
from brink.server.campaigns.body import Notes, Tags
from brink.server.documents import (
    MAX_FILE_BYTES,
    Body,
    check_printable,
    errors_in_file,
    parse_document,
    parse_yaml,
    read_yaml,
)
from brink.server.errors import FieldError, InvalidInput, nearest
from brink.user_file import read_text
from brink.worker.wire import JsonValues

VERSION: Final = 1
MOST_ENTRIES: Final = 1_000
SIDES: Final = ("unsafe", "safe")
HEADER: Final = "# Drives to simulate again with each version: brink suite run FILE\n"
_SHOWN: Final = 10

Name = Annotated[str, Field(min_length=1, max_length=120), AfterValidator(check_printable)]


class System(Body):
    """What was tested.

    Attributes:
        problem: Id of the problem.
        params: Its parameters, all spelled out.
        ground_truth: Whether ground truth stood in place of the machine-learned component.
        simulator: Id of the simulator; empty if nothing is simulated.
        requirements: Ids of the requirements that give the verdict; empty if the problem does not name them.
        sources: SHA-256 of the source of each plug-in, except Brink's own.
    """

    problem: Name
    params: JsonValues = Field(default_factory=dict)
    ground_truth: bool = False
    simulator: Annotated[str, Field(max_length=200)] = ""
    requirements: list[Name] = Field(default_factory=list)
    sources: dict[Name, Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]] = Field(default_factory=dict)


class Drive(Body):
    """A drive and what is known of it.

    Attributes:
        expect: What passes: ``safe`` for a regression test, ``unsafe`` for a known hazard.
        unsafe: Simulations that violated when it was found.
        of: Simulations with a verdict then.
        found: Day on which the entry was made, such as ``2026-11-28``.
        solution: Its number in the campaign that it comes from.
        episode: Digest of its first episode; with the same one, nothing has changed. Empty if that is unknown.
        values: Every parameter by component.parameter, in its unit.
    """

    expect: Literal["safe", "unsafe"]
    unsafe: Annotated[int, Field(ge=0, le=10**9)] = 0
    of: Annotated[int, Field(ge=0, le=10**9)] = 0
    found: Annotated[str, Field(pattern=r"^\d{4}-\d\d-\d\d$")] = ""
    solution: Annotated[int, Field(ge=0)] | None = None
    episode: Annotated[str, Field(pattern=r"^([0-9a-f]{16})?$")] = ""
    values: Annotated[JsonValues, Field(min_length=1)]

    @model_validator(mode="after")
    def _check_evidence(self) -> Self:
        if self.unsafe > self.of:
            raise ValueError(f"expected unsafe to be at most of, got {self.unsafe} of {self.of}")
        return self

    @property
    def evidence(self) -> str:
        """The evidence in words."""
        return f"{self.unsafe} of {self.of} unsafe" if self.of else "none"


class Entry(Body):
    """A drive that was found unsafe, one that was found safe, or a pair of both.

    Attributes:
        name: Its name, unique in the file.
        system: Name of the system.
        seed: Decides its episode seeds.
        campaign: Id of the campaign that it comes from; empty if unknown.
        tags: Words to choose entries by.
        note: Anything.
        unsafe: The drive that was found unsafe.
        safe: The drive that was found safe.
    """

    name: Name
    system: Name
    seed: Annotated[int, Field(ge=0, lt=2**31)]
    campaign: Annotated[str, Field(max_length=16)] = ""
    tags: Tags = Field(default_factory=list)
    note: Notes = ""
    unsafe: Drive | None = None
    safe: Drive | None = None

    @model_validator(mode="after")
    def _check_drives(self) -> Self:
        if self.unsafe is None and self.safe is None:
            raise ValueError("expected a drive under unsafe, under safe, or under both")
        return self

    @property
    def kind(self) -> str:
        """``unsafe``, ``safe`` or ``pair``."""
        return "pair" if self.unsafe and self.safe else "unsafe" if self.unsafe else "safe"

    def drives(self) -> Iterator[tuple[str, Drive]]:
        """Return its drives with their sides."""
        for side, drive in zip(SIDES, (self.unsafe, self.safe), strict=True):
            if drive is not None:
                yield side, drive

    def case(self, side: str) -> str:
        """Return the name of one of its drives, unique in the file."""
        return f"{self.name} ({side})" if self.kind == "pair" else self.name


class SuiteFile(Body):
    """The content of a suite file."""

    suite: Literal[1]
    systems: Annotated[dict[Name, System], Field(min_length=1)]
    entries: Annotated[list[Entry], Field(max_length=MOST_ENTRIES)]

    def errors(self) -> list[FieldError]:
        """Return an error for each reference that is wrong."""
        found: list[FieldError] = []
        names: dict[str, int] = {}
        for place, entry in enumerate(self.entries):
            at = f"/entries/{place}"
            for name in {entry.name, *(entry.case(side) for side, _ in entry.drives())}:
                if names.setdefault(name, place) != place:
                    message = f"expected each name once; entry {names[name]} is called {name!r}, too"
                    found.append(FieldError(pointer=f"{at}/name", message=message))
            if entry.system not in self.systems:
                message = f"expected one of {', '.join(self.systems)}, got {entry.system!r}"
                near = nearest(entry.system, self.systems)
                found.append(FieldError(pointer=f"{at}/system", message=message, nearest=near))
        return found

    def entry(self, name: str) -> Entry:
        """Return an entry by its name.

        Raises:
            InvalidInput: There is none.
        """
        return self.entries[self.place(name)]

    def place(self, name: str) -> int:
        """Return the place of an entry by its name.

        Raises:
            InvalidInput: There is none.
        """
        names = [entry.name for entry in self.entries]
        if name in names:
            return names.index(name)
        shown = ", ".join(names[:_SHOWN]) + (", …" if len(names) > _SHOWN else "")
        near = nearest(name, names)
        raise InvalidInput(
            [
                FieldError(
                    pointer="NAME", message=f"expected one of {shown or 'none'}; got {name!r}", nearest=near
                )
            ]
        )


def parse_suite(document: object) -> SuiteFile:
    """Validate the document of a suite.

    Raises:
        InvalidInput: With a pointer to each invalid field.
    """
    file = parse_document(document, SuiteFile, "a suite with suite, systems and entries")
    if wrong := file.errors():
        raise InvalidInput(wrong)
    return file


def read_suite(path: Path) -> SuiteFile:
    """Read a suite file.

    Raises:
        InvalidInput: With the line of each invalid field.
    """
    with errors_in_file(path):
        return parse_suite(read_yaml(path))


@dataclass(frozen=True, slots=True, kw_only=True)
class NewEntry:
    """An entry to add, and the units of its values, by component.parameter."""

    entry: Entry
    units: Mapping[str, str]


def write_suite(path: Path, systems: Mapping[str, System], entries: Sequence[NewEntry]) -> SuiteFile:
    """Write a new suite file; return its content."""
    lines = [HEADER, f"suite: {VERSION}\n", "systems:\n"]
    lines += [_system_text(name, system) for name, system in systems.items()]
    lines += ["entries:\n", *(_entry_text(new) for new in entries)]
    return _replace(path, "".join(lines))


def add_entries(path: Path, systems: Mapping[str, System], entries: Sequence[NewEntry]) -> SuiteFile:
    """Append entries to a suite file, and the systems that it does not have; return its new content."""
    known = read_suite(path).systems
    text, root = _composed(path)
    new = "".join(_system_text(name, system) for name, system in systems.items() if name not in known)
    lines = text.splitlines(keepends=True)
    key, node = _field(root, "entries")
    at = key.start_mark.line
    if node.flow_style:
        raise _not_a_block(path, node)
    lines[at:at] = [new] if new else []
    return _replace(path, "".join(lines).rstrip("\n") + "\n" + "".join(map(_entry_text, entries)))


def remove_entries(path: Path, names: Sequence[str]) -> SuiteFile:
    """Remove entries from a suite file by name; return its new content.

    Raises:
        InvalidInput: There is no such entry, or none would be left.
    """
    file = read_suite(path)
    places = {file.place(name) for name in names}
    if len(places) == len(file.entries):
        raise InvalidInput.at("NAME", f"this would remove every entry: delete {path} instead")
    text, root = _composed(path)
    _, node = _field(root, "entries")
    if node.flow_style:
        raise _not_a_block(path, node)
    lines = text.splitlines(keepends=True)
    starts = [one.start_mark.line for one in node.value]
    ends = [*starts[1:], len(lines)]
    dropped = {line for place in places for line in range(starts[place], ends[place])}
    return _replace(path, "".join(line for place, line in enumerate(lines) if place not in dropped))


def rename_entry(path: Path, name: str, new: str) -> SuiteFile:
    """Rename an entry of a suite file; return its new content.

    Raises:
        InvalidInput: There is no such entry, or another one has the new name.
    """
    place = read_suite(path).place(name)
    text, root = _composed(path)
    _, scalar = _field(_field(root, "entries")[1].value[place], "name")
    return _replace(path, text[: scalar.start_mark.index] + _scalar(new) + text[scalar.end_mark.index :])


def _composed(path: Path) -> tuple[str, Any]:
    text = read_text(path, MAX_FILE_BYTES)
    return text, yaml.compose(text, yaml.SafeLoader)


def _field(node: yaml.Node, name: str) -> tuple[Any, Any]:
    """Return the key and the value of a field that a valid file has."""
    return next((key, value) for key, value in node.value if key.value == name)


def _not_a_block(path: Path, node: yaml.Node) -> InvalidInput:
    place = f"{path}: line {node.start_mark.line + 1}: entries"
    message = "expected a list with one `- name: …` a block, to change it without touching the rest"
    return InvalidInput([FieldError(pointer="/entries", message=message, place=place)])


def _replace(path: Path, text: str) -> SuiteFile:
    """Write the text of a suite file if it is valid, in one step; return its content."""
    file = parse_suite(parse_yaml(text))
    if len(text.encode()) > MAX_FILE_BYTES:
        raise InvalidInput.at(str(path), f"expected at most {MAX_FILE_BYTES:,} bytes: use several suites")
    beside = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        beside.write_text(text, encoding="utf-8")
        beside.replace(path)
    finally:
        beside.unlink(missing_ok=True)
    return file


def _scalar(value: object) -> str:
    text = yaml.safe_dump(value, default_flow_style=True, width=10**6, allow_unicode=True)
    return text.removesuffix("\n").removesuffix("\n...").strip()


def _system_text(name: str, system: System) -> str:
    text = yaml.safe_dump(
        {name: system.model_dump(exclude_defaults=True)}, sort_keys=False, width=10**6, allow_unicode=True
    )
    return "".join(f"  {line}" for line in text.splitlines(keepends=True))


def _entry_text(new: NewEntry) -> str:
    entry = new.entry
    lines = [
        f"{name}: {_scalar(getattr(entry, name))}"
        for name in ("name", "system", "seed", "campaign", "tags", "note")
        if getattr(entry, name) or name == "seed"
    ]
    for side, drive in entry.drives():
        lines.append(f"{side}:")
        known = drive.model_dump(exclude={"values"})
        lines += [f"  {name}: {_scalar(value)}" for name, value in known.items() if value not in (None, "")]
        lines.append("  values:")
        for name, value in drive.values.items():
            unit = new.units.get(name)
            lines.append(f"    {_scalar(name)}: {_scalar(value)}" + (f"  # {unit}" if unit else ""))
    return f"- {lines[0]}\n" + "".join(f"  {line}\n" for line in lines[1:])


def units_of(space: SearchSpace) -> dict[str, str]:
    """Return the units of parameters that have one, by component.parameter."""
    named = zip(space.column_names(), space.parameters, strict=True)
    return {name: unit for name, parameter in named if (unit := getattr(parameter, "unit", ""))}
