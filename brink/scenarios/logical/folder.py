"""Writes the files of simulated solutions of `command@1`: templates with their values, and the values as a list."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path, PurePosixPath
from typing import Any, Final

from brink.scenarios.exportable import NotExportable
from brink.scenarios.logical.document import Document, parse_document
from brink.scenarios.logical.template import varied_parameters
from brink.scenarios.logical.value_sets import value_sets
from brink.server.errors import InvalidInput
from brink.server.views import SolutionView
from brink.sim.adapters.command.definition import SEED, Definition, filled

VERDICTS_FILE: Final = "verdicts.json"
VALUE_SETS_FILE: Final = "value-sets.xosc"


@dataclass(frozen=True, slots=True, kw_only=True)
class Exported:
    """A solution to export.

    Attributes:
        solution: The solution.
        folder: Folder for its files, relative to that of the export; empty for the latter.
    """

    solution: SolutionView
    folder: str = ""


def write_solutions(
    params: Mapping[str, Any],
    exported: Sequence[Exported],
    out: Path,
    *,
    campaign: str,
    name: str,
    created_at: datetime,
) -> list[Path]:
    """Write the files that the program read in the episodes of solutions.

    Beside those of each solution are its verdicts and its command. Several solutions whose template is an
    OpenSCENARIO file with parameters are listed in a distribution file, too.

    Args:
        params: Parameters of the campaign's problem, `command@1`.
        exported: The solutions.
        out: Folder to write to; created if missing. Files of an earlier export are replaced.
        campaign: Id of the campaign.
        name: Its name.
        created_at: When they are written.

    Returns:
        The files.

    Raises:
        NotExportable: A solution was not simulated.
    """
    definition = Definition.of(params)
    all_files = []
    for one in exported:
        if one.solution.spec is None:
            raise NotExportable(f"solution {one.solution.number} was not simulated: it has no files")
        texts = _texts(definition, one.solution.spec, (out / one.folder).absolute())
        command = [definition.command[0], *(filled(word, texts) for word in definition.command[1:])]
        all_files.append((one, command, dict(definition.files(texts))))
    written: dict[Path, bytes] = {}
    for one, command, files in all_files:
        folder = out / one.folder
        written |= {folder / path: content for path, content in files.items()}
        verdicts = {
            "campaign": campaign,
            "campaign_name": name,
            "solution": one.solution.number,
            "words": one.solution.words,
            "verdict": one.solution.verdict,
            "requirements": one.solution.verdicts,
            "command": command,
            "spec": one.solution.spec,
        }
        written[folder / VERDICTS_FILE] = f"{json.dumps(verdicts, indent=2)}\n".encode()
    template = _parametric(definition)
    if len(exported) > 1 and template is not None:
        path, document = template
        listed = value_sets(
            str(PurePosixPath(exported[0].folder) / path),
            [_values(document, files[path]) for _, _, files in all_files],
            description=f"Brink campaign {campaign}, solutions "
            + ", ".join(str(one.solution.number) for one in exported),
            created_at=created_at,
        )
        written[out / VALUE_SETS_FILE] = listed
    for file, content in written.items():
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(content)
    return list(written)


def _texts(definition: Definition, spec: Mapping[str, Any], folder: Path) -> dict[str, str]:
    values: dict[str, Any] = {}
    for part in spec["scenario"].values():
        values |= part
    return definition.texts(values) | {SEED: str(spec["seed"]), "out": str(folder), "number": "0"}


def _parametric(definition: Definition) -> tuple[str, Document] | None:
    """Return the first template that is an OpenSCENARIO file whose parameters have placeholders."""
    for path, text in definition.templates.items():
        if PurePosixPath(path).suffix.lower() == ".xosc":
            try:
                document = parse_document(Path(path), text.encode())
            except InvalidInput:
                continue
            if varied_parameters(document):
                return path, document
    return None


def _values(template: Document, content: bytes) -> dict[str, str]:
    """Return the values of the parameters that vary, in a file made from a template."""
    group = parse_document(template.path, content).root.first("ParameterDeclarations")
    assert group is not None
    values = {one.attributes["name"]: one.attributes["value"] for one in group.all("ParameterDeclaration")}
    return {name: values[name] for name in varied_parameters(template)}
