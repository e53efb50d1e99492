"""Definitions of commands: the program that simulates an episode, and the values that it may be given.

Whoever may submit a campaign must not thereby run programs. So a worker runs only the definitions that are installed
on it, and a campaign names one by its digest. The digest covers whatever decides what is executed: the command, the
content of all files, the environment, the choices of its parameters, and the program itself. A campaign contributes
values alone, and a definition accepts only numbers and its own choices.
"""

import base64
import binascii
import hashlib
import html
import json
import math
import os
import re
import shutil
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, Final, Self

from brink.sim.episode import COMMAND_PREFIX, Json, nearest
from brink.sim.errors import DefinitionError, SimulationCrashed
from brink.sim.programs import Supervisor, exit_words
from brink.user_file import read_file

SEED: Final = "seed"
ALWAYS: Final = (SEED, "out", "number")
"""Placeholders that every command has: the episode's seed, its working folder, and a number that no other episode
running on this machine has, such as for ports."""
MAX_FILES: Final = 64
MAX_FILES_BYTES: Final = 512 * 1024
"""Maximum size of all files of a definition together, as their content is part of the campaign."""
MAX_ARGUMENTS: Final = 256
MAX_ARGUMENT_CHARS: Final = 4096
FIELDS: Final = ("command", "files", "copies", "environment", "version", "success", "space")
"""The parameters of a campaign that make up the definition; of the space only the choices count."""
VERSION_TIMEOUT_S: Final = 20.0

_PLACEHOLDER: Final = re.compile(r"\{\{|\$?\{([A-Za-z_][A-Za-z0-9_.-]*)\}")
_VARIABLE: Final = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_XML: Final = (".xml", ".xosc", ".xodr", ".sumocfg", ".html", ".svg", ".sdf", ".urdf", ".osm")
_DIGITS: Final = 16


@dataclass(frozen=True, slots=True, kw_only=True)
class Definition:
    """A command with its files.

    Attributes:
        command: Program and arguments; all but the program may have placeholders.
        templates: Text of the files with placeholders, by name in the working folder.
        copies: Content of the other files.
        environment: Environment variables, besides a path and a home.
        version: Command whose output identifies the program; empty for the content of its files.
        success: Exit statuses of an episode that has a verdict.
        choices: The parameters; None for a number, else the values that it may have.
        absent: Those that may be absent, each with the text that then stands in its place.
        gives: Further placeholders whose text a parameter decides: by parameter and placeholder, the text for each of
            its choices.
    """

    command: tuple[str, ...]
    templates: Mapping[str, str]
    copies: Mapping[str, bytes]
    environment: Mapping[str, str]
    version: tuple[str, ...]
    success: tuple[int, ...]
    choices: Mapping[str, tuple[str, ...] | None]
    absent: Mapping[str, str]
    gives: Mapping[str, Mapping[str, tuple[str, ...]]]

    @classmethod
    def of(cls, params: Mapping[str, Any]) -> Self:
        """Return the definition in the parameters of a campaign, whose files are given by content.

        Raises:
            DefinitionError: It is malformed, or its placeholders and parameters do not match.
        """
        files, copies = (_checked_mapping(name, params.get(name, {})) for name in ("files", "copies"))
        choices = _choices(params.get("space", {}))
        definition = cls(
            command=_arguments("command", params.get("command")),
            templates={name: _content("files", name, given, "content") for name, given in files.items()},
            copies={name: _bytes(name, given) for name, given in copies.items()},
            environment=_environment(params.get("environment", {})),
            version=_arguments("version", params["version"]) if params.get("version") else (),
            success=_statuses(params.get("success", [0])),
            choices=choices,
            absent=_absent(params.get("space", {})),
            gives=_gives(params.get("space", {}), choices),
        )
        _check_names([*files, *copies])
        size = sum(map(len, definition.copies.values())) + sum(
            len(text.encode()) for text in definition.templates.values()
        )
        if size > MAX_FILES_BYTES:
            raise DefinitionError(
                "files",
                f"expected files and copies of at most {MAX_FILES_BYTES:,} bytes together, got {size:,}: name larger "
                "ones by an absolute path in the command",
            )
        definition._check_placeholders()
        return definition

    def _check_placeholders(self) -> None:
        used: set[str] = set()
        given = [name for texts in self.gives.values() for name in texts]
        for field, where, text in [
            *(("command", f"argument {place}", one) for place, one in enumerate(self.command)),
            *(("files", name, text) for name, text in self.templates.items()),
        ]:
            names = [match[1] for match in _PLACEHOLDER.finditer(text) if match[1]]
            known = (*self.choices, *given, *ALWAYS)
            for name in names:
                if name not in known:
                    raise DefinitionError(
                        field,
                        f"{where}: no parameter is called {name!r}{nearest(name, known)}; expected one of "
                        f"{', '.join(known)}; write {{{{ for a brace",
                    )
            used.update(names)
        if _PLACEHOLDER.search(self.command[0]):
            raise DefinitionError(
                "command", f"expected a program without placeholders, got {self.command[0]!r}"
            )
        needed = [*(name for name in self.choices if name not in self.gives), *given]
        if unused := [name for name in needed if name not in used]:
            raise DefinitionError(
                "space",
                f"no file and no argument has the placeholder {{{unused[0]}}}: the parameter would have no effect",
            )

    @property
    def takes_seed(self) -> bool:
        """Whether a file or an argument has the placeholder of the seed."""
        texts = (*self.command, *self.templates.values())
        return any(match[1] == SEED for text in texts for match in _PLACEHOLDER.finditer(text))

    def document(self) -> dict[str, Json]:
        """Return the definition as the parameters of a campaign, whose space has no ranges."""
        return {
            "command": list(self.command),
            "files": {name: {"content": text} for name, text in self.templates.items()},
            "copies": {
                name: {"base64": base64.b64encode(data).decode()} for name, data in self.copies.items()
            },
            "environment": dict(self.environment),
            "version": list(self.version),
            "success": list(self.success),
            "space": {"values": {name: self._described(name) for name in self.choices}},
        }

    def _described(self, name: str) -> dict[str, Json]:
        choices = self.choices[name]
        described: dict[str, Json] = {} if choices is None else {"values": list(choices)}
        if name in self.gives:
            described["gives"] = {key: list(texts) for key, texts in self.gives[name].items()}
        return described | ({"absent": self.absent[name]} if name in self.absent else {})

    def simulator_id(self, program: str) -> str:
        """Return the id of the simulator that runs this definition with a program.

        Args:
            program: Digest of the program, as `program` returns it.
        """
        text = json.dumps([self.document(), program], sort_keys=True, separators=(",", ":"))
        return f"{COMMAND_PREFIX}{hashlib.sha256(text.encode()).hexdigest()[:_DIGITS]}@1"

    def program(self, here: Path) -> str:
        """Return the SHA-256 of the program on this machine.

        That is the output of `version` or, without it, the content of the executable and of all files that arguments
        name by an absolute path.

        Args:
            here: Folder to run `version` in.

        Raises:
            DefinitionError: The program is not found, or `version` fails.
        """
        executable = self.executable()
        if self.version:
            return hashlib.sha256(self._version_words(here).encode()).hexdigest()
        files = [executable, *(one for one in self.command[1:] if os.path.isabs(one) and os.path.isfile(one))]
        digest = hashlib.sha256()
        for name in files:
            with open(name, "rb") as file:
                digest.update(hashlib.file_digest(file, "sha256").digest())
        return digest.hexdigest()

    def _version_words(self, here: Path) -> str:
        environment = self.variables(here)
        command = (_found(self.version[0], environment, "version"), *self.version[1:])
        try:
            with (
                Supervisor() as supervisor,
                supervisor.start(command, folder=here, environment=environment) as program,
            ):
                ending = program.wait(time.monotonic() + VERSION_TIMEOUT_S)
                words = program.output()
        except (OSError, SimulationCrashed) as error:
            raise DefinitionError("version", f"{command[0]} cannot be run: {error}") from None
        if ending is None or ending.status != 0:
            how = f"did not end in {VERSION_TIMEOUT_S:g} s" if ending is None else exit_words(ending.status)
            raise DefinitionError("version", f"{command[0]} {how}: {words[-400:]}")
        return words

    def executable(self) -> str:
        """Return the path of the program on this machine.

        Raises:
            DefinitionError: It is not found, or is not executable.
        """
        return _found(self.command[0], self.variables(Path("/")), "command")

    def variables(self, folder: Path) -> dict[str, str]:
        """Return the environment variables of an episode: those of the definition, a path, and a home."""
        return {
            "PATH": os.environ.get("PATH", os.defpath),
            "LANG": "C.UTF-8",
            "HOME": str(folder),
            "TMPDIR": str(folder),
            **self.environment,
        }

    def texts(self, values: Mapping[str, object]) -> dict[str, str]:
        """Return the values of an episode as text.

        Args:
            values: The value of each parameter.

        Raises:
            DefinitionError: A value is missing, unknown, not a finite number, or none of the choices.
        """
        if unknown := (set(values) ^ set(self.choices)) - (set(self.absent) - set(values)):
            raise DefinitionError(
                "space", f"expected values of {', '.join(self.choices)}; {min(unknown)!r} differs"
            )
        texts = dict(self.absent)
        for name, given in self.gives.items():
            texts |= dict.fromkeys(given, self.absent.get(name, ""))
        for name, value in values.items():
            choices = self.choices[name]
            if choices is not None:
                if value not in choices:
                    raise DefinitionError(
                        "space", f"{name}: expected one of {', '.join(choices)}; got {value!r:.80}"
                    )
                texts[name] = str(value)
                place = choices.index(str(value))
                texts |= {key: given[place] for key, given in self.gives.get(name, {}).items()}
            elif isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
                raise DefinitionError("space", f"{name}: expected a finite number, got {value!r:.80}")
            else:
                texts[name] = repr(value)
        return texts

    def arguments(self, texts: Mapping[str, str]) -> tuple[str, ...]:
        """Return program and arguments with their values."""
        return (self.executable(), *(filled(one, texts) for one in self.command[1:]))

    def files(self, texts: Mapping[str, str]) -> Iterator[tuple[str, bytes]]:
        """Yield name and content of all files, with values escaped as XML or JSON by the name's ending."""
        for name, text in self.templates.items():
            ending = PurePosixPath(name).suffix.lower()
            escape = _as_json if ending == ".json" else _as_xml if ending in _XML else str
            yield name, filled(text, {key: escape(value) for key, value in texts.items()}).encode()
        yield from self.copies.items()


def filled(text: str, texts: Mapping[str, str]) -> str:
    """Return a text with its placeholders replaced: ``{name}`` and ``${name}``, and ``{{`` for a brace."""
    return _PLACEHOLDER.sub(lambda match: texts[match[1]] if match[1] else "{", text)


def read_files(params: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Return the parameters in a campaign file with the content of their files, and the digest of the program.

    Args:
        params: The parameters.
        folder: Folder of the campaign file.

    Raises:
        DefinitionError: A file cannot be read, the definition is malformed, or the program is not here.
    """
    read = with_contents(params, folder)
    if "program" not in read:
        with tempfile.TemporaryDirectory(prefix="brink-") as here:
            read["program"] = Definition.of(read).program(Path(here))
    return read


def with_contents(params: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Return parameters with the content of the files that they name by path.

    Args:
        params: Parameters of a campaign, as they stand in its file.
        folder: Folder of the campaign file.

    Raises:
        DefinitionError: A file cannot be read, or is too large.
    """
    read = dict(params)
    for field in ("command", "version"):
        match params.get(field):
            case [str(program), *arguments] if "/" in program:
                read[field] = [str((folder / program).absolute()), *arguments]
    for field, key in (("files", "content"), ("copies", "base64")):
        given = params.get(field, {})
        if isinstance(given, list):
            given = {name: name for name in given if isinstance(name, str)}
        if isinstance(given, Mapping):
            read[field] = {
                name: {key: _read(field, folder / one, key)} if isinstance(one, str) else one
                for name, one in given.items()
            }
    return {name: value for name, value in read.items() if value != {} or name in params}


def _read(field: str, path: Path, key: str) -> str:
    try:
        content = read_file(path, MAX_FILES_BYTES)
        return content.decode() if key == "content" else base64.b64encode(content).decode()
    except UnicodeDecodeError:
        raise DefinitionError(
            field, f"{path}: expected text in UTF-8; list other files under copies"
        ) from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise DefinitionError(field, f"{path} cannot be read: {reason}") from None


def _checked_mapping(field: str, given: object) -> Mapping[str, Any]:
    if not isinstance(given, Mapping) or len(given) > MAX_FILES:
        raise DefinitionError(
            field, f"expected at most {MAX_FILES} files by name, such as {{scenario.xml: cut-in.xml}}"
        )
    return given


def _check_names(names: Sequence[object]) -> None:
    for name in names:
        parts = name.split("/") if isinstance(name, str) else [""]
        if any(part in ("", ".", "..") or not part.isprintable() or len(part) > 200 for part in parts):
            raise DefinitionError("files", f"expected names inside the working folder, got {name!r:.80}")
    if len(set(names)) < len(names):
        raise DefinitionError("copies", "expected each name once among files and copies")
    for name in names:
        if any(str(other).startswith(f"{name}/") for other in names):
            raise DefinitionError("files", f"{name!r} is a file, and a folder of another one")


def _content(field: str, name: object, given: object, key: str) -> str:
    if isinstance(given, Mapping) and list(given) == [key] and isinstance(given[key], str):
        return str(given[key])
    raise DefinitionError(
        field,
        f"{name}: expected {{{key}: …}}, which brink run and brink submit read from the file that a path names; "
        f"got {given!r:.80}",
    )


def _bytes(name: object, given: object) -> bytes:
    try:
        return base64.b64decode(_content("copies", name, given, "base64"), validate=True)
    except (binascii.Error, ValueError):
        raise DefinitionError("copies", f"{name}: expected base64") from None


def _arguments(field: str, given: object) -> tuple[str, ...]:
    if (
        isinstance(given, list | tuple)
        and 1 <= len(given) <= MAX_ARGUMENTS
        and all(isinstance(one, str | int | float) and not isinstance(one, bool) for one in given)
    ):
        words = tuple(str(one) for one in given)
        if words[0] and all("\0" not in one and len(one) <= MAX_ARGUMENT_CHARS for one in words):
            return words
    raise DefinitionError(
        field,
        f"expected a list of a program and its arguments, such as [./sim, '--seed', '{{seed}}']; got {given!r:.80}",
    )


def _environment(given: object) -> dict[str, str]:
    if isinstance(given, Mapping) and len(given) <= MAX_ARGUMENTS:
        words = {name: str(value) for name, value in given.items()}
        if all(isinstance(name, str) and _VARIABLE.fullmatch(name) for name in words) and not any(
            "\0" in value or len(value) > MAX_ARGUMENT_CHARS for value in words.values()
        ):
            return words
    raise DefinitionError("environment", f"expected texts by the name of a variable, got {given!r:.80}")


def _statuses(given: object) -> tuple[int, ...]:
    if (
        isinstance(given, list | tuple)
        and given
        and all(type(one) is int and 0 <= one < 256 for one in given)
    ):
        return tuple(given)
    raise DefinitionError("success", f"expected exit statuses from 0 to 255, got {given!r:.80}")


def choice_text(value: object) -> str:
    """Return a choice of a parameter as text: itself if it is one, otherwise as in JSON."""
    return value if isinstance(value, str) else json.dumps(value)


def _declared(space: object) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield name and description of each parameter of a declared space, whose form is checked elsewhere."""
    for component in space.values() if isinstance(space, Mapping) else ():
        for name, stated in component.items() if isinstance(component, Mapping) else ():
            yield str(name), stated if isinstance(stated, Mapping) else {}


def _choices(space: object) -> dict[str, tuple[str, ...] | None]:
    """Return the parameters of a declared space: None for a number, else the texts of its choices."""
    choices: dict[str, tuple[str, ...] | None] = {}
    for name, stated in _declared(space):
        if name in choices or name in ALWAYS:
            raise DefinitionError(
                "space",
                f"{name}: expected names that differ, in all components, from each other and from "
                f"{', '.join(ALWAYS)}",
            )
        values = stated.get("values")
        texts = tuple(map(choice_text, values)) if isinstance(values, list) else None
        if texts is not None and not all(text.isprintable() for text in texts):
            raise DefinitionError("space", f"{name}: expected values without control characters")
        choices[name] = texts
    return choices


def _absent(space: object) -> dict[str, str]:
    """Return what stands in place of each parameter of a declared space that may be absent."""
    absent = {}
    for name, stated in _declared(space):
        if "absent" in stated or "when" in stated:
            text = stated.get("absent")
            if not isinstance(text, str) or not text.isprintable():
                raise DefinitionError(
                    "space",
                    f"{name}: expected, beside when, absent: the text that stands in its place where it is "
                    f"absent, such as '' or '0'; got {text!r:.80}",
                )
            absent[name] = text
    return absent


def _gives(
    space: object, choices: Mapping[str, tuple[str, ...] | None]
) -> dict[str, dict[str, tuple[str, ...]]]:
    """Return the placeholders whose text a parameter of a declared space decides."""
    gives: dict[str, dict[str, tuple[str, ...]]] = {}
    taken = {*choices, *ALWAYS}
    for name, stated in _declared(space):
        if "gives" not in stated:
            continue
        values, given = choices[name], stated["gives"]
        if not isinstance(given, Mapping) or not given or values is None:
            raise DefinitionError(
                "space",
                f"{name}: expected, beside values, gives as a list of values for each placeholder, such as "
                f"{{speed: [10, 20]}}; got {given!r:.80}",
            )
        gives[name] = {}
        for key, one in given.items():
            texts = tuple(map(choice_text, one)) if isinstance(one, list) else ()
            if len(texts) != len(values) or not all(text.isprintable() for text in texts):
                raise DefinitionError(
                    "space",
                    f"{name}: gives {key}: expected a list of {len(values)} values, one for each of its values, "
                    f"without control characters; got {one!r:.80}",
                )
            if key in taken:
                raise DefinitionError("space", f"{name}: gives {key}, which has a value already")
            taken.add(key)
            gives[name][str(key)] = texts
    return gives


def _found(name: str, environment: Mapping[str, str], field: str) -> str:
    found = shutil.which(name, path=environment["PATH"])
    if found is None:
        expected = "an executable file" if "/" in name else f"an executable on the path {environment['PATH']}"
        raise DefinitionError(field, f"no program {name!r} here: expected {expected}")
    return os.path.abspath(found)


def _as_json(value: str) -> str:
    return json.dumps(value)[1:-1]


def _as_xml(value: str) -> str:
    return html.escape(value, quote=True)
