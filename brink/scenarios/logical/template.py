"""Templates of OpenSCENARIO files for `command@1`: placeholders in place of values, and the files that they need."""

import html
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from brink.scenarios.logical.declarations import declarations_of
from brink.scenarios.logical.document import Document, Element
from brink.scenarios.logical.expressions import is_reference
from brink.scenarios.logical.space import LogicalScenario
from brink.sim.adapters.command.definition import MAX_FILES, MAX_FILES_BYTES

_BRACES: Final = re.compile(rb"\{\{|\$?\{([A-Za-z_][A-Za-z0-9_.-]*)\}")
"""What `command@1` would replace in a template."""
_PLACEHOLDER: Final = re.compile(r"\{[A-Za-z_][A-Za-z0-9_.-]*\}")


@dataclass(frozen=True, slots=True, kw_only=True)
class Template:
    """A scenario with placeholders.

    Attributes:
        content: The file.
        copies: Other files that it needs in the working folder, by their name there.
        notes: What a reader should know of files that it needs.
    """

    content: bytes
    copies: dict[str, Path]
    notes: tuple[str, ...]


def template_of(logical: LogicalScenario) -> Template:
    """Return the template of a scenario.

    Values of the parameters that vary become placeholders. The road network and catalogues that the scenario names by
    a relative path come along, as far as their size allows; it names larger ones by their absolute path.

    Args:
        logical: The scenario with its search space.
    """
    document = logical.document
    declared = declarations_of(document)
    edits: list[tuple[int, int, bytes]] = []
    for name, value in logical.fixed.items():
        edits.append((*document.span(declared[name].element, "value"), _escaped(value)))
    for axis in logical.axes:
        for name, placeholder in axis.placeholders.items():
            edits.append((*document.span(declared[name].element, "value"), f"{{{placeholder}}}".encode()))
    files = _Files(document)
    edits.extend(files.edits())
    parts, place = [], 0
    for start, end, replacement in sorted(edits):
        parts += [_inert(document.data[place:start]), replacement]
        place = end
    parts.append(_inert(document.data[place:]))
    return Template(content=b"".join(parts), copies=files.copies, notes=tuple(files.notes))


def varied_parameters(document: Document) -> list[str]:
    """Return the parameters of a template whose values are placeholders, in the order of the file."""
    group = document.root.first("ParameterDeclarations")
    return [
        one.attributes.get("name", "")
        for one in ([] if group is None else group.all("ParameterDeclaration"))
        if _PLACEHOLDER.fullmatch(one.attributes.get("value", ""))
    ]


def _escaped(value: str) -> bytes:
    return _inert(html.escape(value, quote=True).encode())


def _inert(text: bytes) -> bytes:
    """Return a text that `command@1` leaves as it was."""
    return _BRACES.sub(lambda match: match[0].replace(b"{", b"{{"), text)


class _Files:
    """The road network and the catalogues of a scenario."""

    def __init__(self, document: Document) -> None:
        self._document = document
        self._left = MAX_FILES_BYTES - len(document.data) - 4_096  # placeholders make it longer
        self.copies: dict[str, Path] = {}
        self.notes: list[str] = []

    def edits(self) -> Iterator[tuple[int, int, bytes]]:
        """Yield the paths to replace in the scenario, and note what is missing."""
        for element, attribute in self._named():
            path = element.attributes.get(attribute, "")
            if not path or is_reference(path) or os.path.isabs(path):
                continue
            found = self._document.path.absolute().parent / path
            files = _files_in(found)
            if not files:
                self.notes.append(
                    f"line {element.line}: {element.tag} {path} is not there: your simulator may miss it"
                )
                continue
            name = self._free(found.resolve().name)
            size = sum(one.stat().st_size for one in files)
            if size <= self._left and len(files) + len(self.copies) < MAX_FILES:
                self._left -= size
                self.copies |= {name if found.is_file() else f"{name}/{one.name}": one for one in files}
                new = name
            else:
                new = str(found.resolve())
                self.notes.append(
                    f"line {element.line}: {element.tag} is too large to travel with the campaign: every worker "
                    f"needs {new}"
                )
            yield (*self._document.span(element, attribute), _escaped(new))

    def _named(self) -> Iterator[tuple[Element, str]]:
        root = self._document.root
        network, catalogues = root.first("RoadNetwork"), root.first("CatalogLocations")
        for element in [] if network is None else network.all("LogicFile"):
            yield element, "filepath"
        for location in [] if catalogues is None else catalogues.children:
            for element in location.all("Directory"):
                yield element, "path"

    def _free(self, name: str) -> str:
        taken = {one.partition("/")[0] for one in self.copies}
        free, count = name, 1
        while free in taken:
            count += 1
            free = f"{count}-{name}"
        return free


def _files_in(path: Path) -> list[Path]:
    """Return a road network, or the catalogues in a folder; nothing else is ever copied."""
    if path.is_dir():
        return sorted(one for one in path.iterdir() if one.suffix == ".xosc" and one.is_file())
    return [path] if path.suffix == ".xodr" and path.is_file() else []
