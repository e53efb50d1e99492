"""Driving systems in a process of their own: their definitions, and the processes that drive.

A definition is a file of YAML:

    command: [./build/planner, --model, weights.bin]
    files: [maps]
    environment: {PLANNER_THREADS: "1"}
    step_timeout_s: 1

A campaign names it as ``command:NAME@DIGEST``. The digest covers the command, the environment, and the content of the
program and of all files, so the id alone decides what drives. Workers run a definition only if it is in the folder
``driving`` of `brink.sim.programs.installed.commands_folder`.
"""

import hashlib
import json
import os
import re
import shutil
import socket
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Self

from brink.sim.driving.interface import Observation
from brink.sim.driving_systems.interface import Decision, Needs, Start
from brink.sim.driving_systems.protocol import (
    Hello,
    read_decision,
    read_hello,
    read_ready,
    start_message,
    step_message,
)
from brink.sim.errors import (
    DefinitionError,
    DrivingSystemFailed,
    PluginMissing,
    SimulationCrashed,
    SimulatorError,
)
from brink.sim.programs import Program, Supervisor, exit_words, plain_environment
from brink.sim.programs.installed import commands_folder, own_folder
from brink.user_file import open_file, read_text

PREFIX: Final = "command:"
OPTION: Final = "driving"
"""Name of the option of episodes, and of the parameter of problems."""
CHANNEL_VARIABLE: Final = "BRINK_DRIVING_FD"
"""Environment variable with the number of the program's socket."""
FOLDER: Final = "driving"
MAX_DEFINITION_BYTES: Final = 64 * 1024
MAX_FILES: Final = 10_000
MAX_ANSWER_BYTES: Final = 4 * 1024**2
DIGITS: Final = 16
"""Digits of a digest in an id."""
KEPT: Final = 4
"""Number of programs that a simulation process keeps."""
_SUFFIXES: Final = (".yaml", ".yml")
_ID: Final = re.compile(rf"command:[A-Za-z0-9_.-]{{1,80}}@[0-9a-f]{{{DIGITS}}}")
_NAME: Final = re.compile(r"[A-Za-z0-9_.-]{1,80}")
_EXIT_S: Final = 1.0
_OUTPUT_LINES: Final = 12
_READ_BYTES: Final = 1 << 16


@dataclass(frozen=True, slots=True, kw_only=True)
class Definition:
    """What to run.

    Attributes:
        path: The file.
        command: Program and arguments. A program with a slash, and files among the arguments, are relative to the
            folder of the file.
        files: Further files that decide how it drives, and folders of such files.
        environment: Environment variables, besides those of `plain_environment`.
        step_timeout_s: Time limit of an answer.
        start_timeout_s: Time limit of ``hello``.
    """

    path: Path
    command: tuple[str, ...]
    files: tuple[str, ...] = ()
    environment: Mapping[str, str] = field(default_factory=dict)
    step_timeout_s: float = 1.0
    start_timeout_s: float = 30.0

    @classmethod
    def of(cls, path: Path) -> Self:
        """Read a definition.

        Raises:
            DefinitionError: The file cannot be read, or is no definition.
        """
        import yaml  # only for those who use it

        try:
            document = yaml.safe_load(read_text(path, MAX_DEFINITION_BYTES))
        except (OSError, ValueError, yaml.YAMLError, RecursionError) as error:
            raise DefinitionError(OPTION, f"{path}: cannot be read as YAML: {error}") from None
        wanted = ("command", "files", "environment", "step_timeout_s", "start_timeout_s")
        if not isinstance(document, dict) or "command" not in document or document.keys() - set(wanted):
            raise DefinitionError(
                OPTION, f"{path}: expected command and perhaps {', '.join(wanted[1:])}; got {document!r:.120}"
            )
        if not _NAME.fullmatch(path.resolve().stem):
            raise DefinitionError(OPTION, f"{path}: expected a file name of letters, digits, - and _")
        command = _texts(path, "command", document["command"])
        files = _texts(path, "files", document.get("files", []))
        environment = document.get("environment", {})
        if not command or not isinstance(environment, dict):
            raise DefinitionError(
                OPTION, f"{path}: expected a program in command, and an object of texts as environment"
            )
        _texts(path, "environment", [*environment, *environment.values()])
        limits = {name: document[name] for name in wanted[3:] if name in document}
        for name, limit_s in limits.items():
            if type(limit_s) not in (int, float) or not 0 < limit_s <= 3600:
                raise DefinitionError(
                    OPTION, f"{path}: {name}: expected seconds in (0, 3600], got {limit_s!r:.80}"
                )
        return cls(path=path.resolve(), command=command, files=files, environment=environment, **limits)

    def id(self) -> str:
        """Return the id by which campaigns name it, for the present content of its files.

        Raises:
            DefinitionError: The program or a file is missing or cannot be executed.
        """
        digest = hashlib.sha256()
        for part in (self.command, sorted(self.environment.items())):
            digest.update(json.dumps(part).encode())
        for name, file in sorted(self._counted()):
            digest.update(json.dumps([name, _file_digest(file)]).encode())
        return f"{PREFIX}{self.path.stem}@{digest.hexdigest()[:DIGITS]}"

    def variables(self) -> dict[str, str]:
        """Return the environment variables of the program."""
        return {**plain_environment(), **self.environment}

    def program(self) -> str:
        """Return the path of the program.

        Raises:
            DefinitionError: It is missing or cannot be executed.
        """
        name = self.command[0]
        found = shutil.which(
            str(self.path.parent / name) if "/" in name else name, path=self.variables().get("PATH")
        )
        if found is None:
            where = "relative to its folder" if "/" in name else "on PATH"
            raise DefinitionError(
                OPTION, f"{self.path}: command: {name}: no program that can be executed, {where}"
            )
        return found

    def _counted(self) -> Iterator[tuple[str, Path]]:
        """Yield the name and path of each file that decides how it drives."""
        folder = self.path.parent
        yield self.command[0], Path(self.program())
        for name in self.command[1:]:
            # An argument may be no path at all, or too long for one.
            if len(name) < 1024 and "\0" not in name and (folder / name).is_file():
                yield name, folder / name
        count = 0
        for name in self.files:
            top = folder / name
            found = sorted(one for one in top.rglob("*") if one.is_file()) if top.is_dir() else [top]
            count += len(found)
            if count > MAX_FILES:
                raise DefinitionError(OPTION, f"{self.path}: files: expected at most {MAX_FILES:,}")
            yield from ((os.path.relpath(one, folder), one) for one in found)


def _texts(path: Path, name: str, values: object) -> tuple[str, ...]:
    if not isinstance(values, list) or not all(isinstance(one, str) and "\0" not in one for one in values):
        raise DefinitionError(
            OPTION, f"{path}: {name}: expected texts (numbers in quotes), got {values!r:.120}"
        )
    return tuple(values)


def _file_digest(file: Path) -> str:
    try:
        with open_file(file) as opened:
            digest = hashlib.sha256()
            while part := opened.read(_READ_BYTES):
                digest.update(part)
            return digest.hexdigest()
    except OSError as error:
        raise DefinitionError(OPTION, f"{file}: cannot be read: {error.strerror}") from None


_read: dict[str, Definition] = {}
"""The definitions whose files this process has read, by id."""


def read_reference(driving: str, folder: Path) -> str:
    """Return the id of a driving system that a campaign file names as ``command:FILE``; any other name as it is.

    Args:
        driving: The name.
        folder: Folder of the campaign file.

    Raises:
        DefinitionError: The file is no definition, or the program cannot run here.
    """
    if not driving.startswith(PREFIX) or is_id(driving):
        return driving
    definition = Definition.of(folder / driving.removeprefix(PREFIX))
    _read[system := definition.id()] = definition
    return system


def install_read(system: str) -> None:
    """Allow the workers of this machine to run a definition if this process has read its file."""
    if system in _read:
        install(_read[system])


def is_id(system: str) -> bool:
    """Return whether a text is the id of a definition."""
    return _ID.fullmatch(system) is not None


def install(definition: Definition) -> None:
    """Allow the workers of this machine to run a definition, by a link in their folder."""
    folder = own_folder() / FOLDER
    folder.mkdir(exist_ok=True)
    name = hashlib.sha256(os.fsencode(definition.path)).hexdigest()[:DIGITS]
    link = folder / f"{name}{definition.path.suffix}"
    partial = link.with_suffix(f".{os.getpid()}")
    partial.symlink_to(definition.path)
    partial.replace(link)


def installed(system: str) -> Definition:
    """Return a definition that may run here.

    Args:
        system: Its id.

    Raises:
        PluginMissing: There is none, which another worker may have.
    """
    folder = commands_folder()
    found: list[str] = []
    for path in sorted((folder / FOLDER).glob("*")) if folder is not None else ():
        if path.suffix in _SUFFIXES and path.resolve().stem == system.removeprefix(PREFIX).partition("@")[0]:
            try:
                definition = Definition.of(path)
                found.append(definition.id())
            except DefinitionError as error:
                found.append(str(error))
            else:
                if found[-1] == system:
                    return definition
    where = "no folder of programs (brink worker --commands FOLDER)" if folder is None else folder / FOLDER
    raise PluginMissing(
        f"{system} is not installed on this worker: looked in {where}, found "
        f"{'; '.join(dict.fromkeys(found)) or 'none of this name'}"
    )


class ProcessDrive:
    """A driving system in one drive. Implements `brink.sim.driving_systems.DrivingSystem`.

    Args:
        process: Its process, which has begun this drive.
        needs: Whether it gets boxes or objects.
    """

    def __init__(self, process: "DrivingProcess", needs: Needs) -> None:
        self.needs = needs
        self._process = process

    def step(self, observation: Observation) -> Decision:
        """Send an observation and return the decision.

        Raises:
            SimulationCrashed: The program ended, or gave no answer in time.
            DrivingSystemFailed: It answered with something else, or has begun another drive.
        """
        return self._process.step(self, observation)


class DrivingProcess:
    """The process of one definition, which is started when it is needed and kept from one drive to the next.

    Whatever goes wrong ends the program, and the next drive starts a new one.

    Args:
        system: Id of the definition.

    Attributes:
        hello: What the program says of itself; None before it was started.
    """

    def __init__(self, system: str) -> None:
        self._system = system
        self.hello: Hello | None = None
        self._supervisor: Supervisor | None = None
        self._program: Program | None = None
        self._step_timeout_s = 0.0
        self._received = bytearray()
        self._drive: ProcessDrive | None = None

    def start(self, start: Start) -> ProcessDrive:
        """Begin a drive.

        Raises:
            PluginMissing: The definition is not installed here, or the program cannot be executed.
            SimulationCrashed: The program ended, or gave no answer in time.
            InvalidEpisode: It speaks another protocol, or reports an error.
        """
        with self._ended_by_errors():
            if self._program is None:
                self.hello = self._started()
            assert self.hello is not None
            self._send(start_message(start))
            read_ready(self._line(self._step_timeout_s, "step_timeout_s"))
        self._drive = ProcessDrive(self, self.hello.needs)
        return self._drive

    def step(self, drive: ProcessDrive, observation: Observation) -> Decision:
        """Return the decision in a control step; see `ProcessDrive.step`."""
        if drive is not self._drive:
            raise DrivingSystemFailed("expected one drive at a time; another one has begun")
        with self._ended_by_errors():
            self._send(step_message(observation))
            return read_decision(self._line(self._step_timeout_s, "step_timeout_s"))

    def close(self) -> None:
        """End the program."""
        if self._program is not None:
            self._program.close()
        if self._supervisor is not None:
            self._supervisor.close()
        self._supervisor = self._program = self._drive = None
        self._received.clear()

    def _started(self) -> Hello:
        definition = installed(self._system)
        self._step_timeout_s = definition.step_timeout_s
        self._supervisor = Supervisor()
        try:
            self._program = self._supervisor.start(
                [definition.program(), *definition.command[1:]],
                folder=definition.path.parent,
                environment=definition.variables(),
                channel_variable=CHANNEL_VARIABLE,
            )
        except OSError as error:
            raise PluginMissing(f"{definition.command[0]} cannot be executed: {error.strerror}") from None
        return read_hello(self._line(definition.start_timeout_s, "start_timeout_s"))

    @contextmanager
    def _ended_by_errors(self) -> Iterator[None]:
        """End the program if anything is raised: an answer that is still to come must not reach the next drive."""
        try:
            yield
        except SimulatorError as error:
            lines = self._program.output().splitlines()[-_OUTPUT_LINES:] if self._program is not None else []
            self.close()
            raise type(error)("\n".join([str(error), *(["it printed:", *lines] if lines else [])])) from None
        except BaseException:
            self.close()
            raise

    def _send(self, message: bytes) -> None:
        assert self._program is not None
        assert self._program.channel is not None
        with suppress(BlockingIOError):
            self._received += self._program.channel.recv(_READ_BYTES, socket.MSG_DONTWAIT)
        if self._received:
            text = self._received.decode(errors="replace")
            raise DrivingSystemFailed(f"expected one answer to each message; got also {text!r:.120}")
        try:
            self._program.channel.sendall(message)
        except OSError:
            raise self._ended() from None

    def _line(self, timeout_s: float, limit: str) -> bytes:
        """Return the next line from the program.

        Args:
            timeout_s: Time limit.
            limit: Name of the time limit.
        """
        assert self._program is not None
        assert self._program.channel is not None
        deadline_s = time.monotonic() + timeout_s
        while not self._received.endswith(b"\n"):
            if len(self._received) > MAX_ANSWER_BYTES:
                raise DrivingSystemFailed(f"expected at most {MAX_ANSWER_BYTES:,} bytes in a line")
            if not self._program.await_channel(deadline_s):
                raise SimulationCrashed(f"no answer within {timeout_s:g} s ({limit}); killed")
            try:
                part = self._program.channel.recv(_READ_BYTES)
            except ConnectionError:
                part = b""
            if not part:
                raise self._ended()
            self._received += part
        line, _, more = bytes(self._received).partition(b"\n")
        self._received[:] = more
        return line

    def _ended(self) -> SimulationCrashed:
        assert self._program is not None
        ending = self._program.wait(time.monotonic() + _EXIT_S)
        return SimulationCrashed(
            "the program closed its socket; killed"
            if ending is None
            else f"the program {exit_words(ending.status)}"
        )


_processes: dict[str, DrivingProcess] = {}
"""The processes of this simulation process by id, the one used last at the end."""


def process_of(system: str) -> DrivingProcess:
    """Return the process of a definition, which is kept for the next drive; the least recently used ones end.

    Args:
        system: Id of the definition.
    """
    process = _processes.pop(system, None) or DrivingProcess(system)
    while len(_processes) >= KEPT:
        _processes.pop(next(iter(_processes))).close()
    _processes[system] = process
    return process


def end_processes() -> None:
    """End all programs that this process keeps."""
    while _processes:
        _processes.popitem()[1].close()
