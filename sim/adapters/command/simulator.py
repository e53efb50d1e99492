"""Runs a command for each episode, in a working folder of its own, and reads the signals that it logs."""

import contextlib
import json
import logging
import math
import os
import shutil
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import yaml

from brink.sim.adapters.command.attempt import Attempt
from brink.sim.adapters.command.definition import FIELDS, SEED, Definition, with_contents
from brink.sim.adapters.command.recording import trace_of
from brink.sim.adapters.command.requirement import Requirement, RequirementError, requirement_of
from brink.sim.adapters.command.signals import SignalError, SignalSource
from brink.sim.catalogue import SIMULATORS, register
from brink.sim.episode import EpisodeResult, EpisodeSpec, Json
from brink.sim.errors import DefinitionError, InvalidEpisode, SimulationCrashed
from brink.sim.programs import Ending, Supervisor, exit_words
from brink.sim.programs.installed import commands_folder, own_folder
from brink.sim.programs.working_folder import working_folder
from brink.sim.provenance import provenance, versions_with
from brink.user_file import read_text

MAX_DEFINITION_BYTES: Final = 4 * 1024**2
MAX_FOLDER_BYTES: Final = 256 * 1024**2
"""Maximum size of an episode's working folder, and of each file in it."""
SEEDS: Final = 2**31
"""Number of different seeds that a program gets: many programs read one as a signed integer of 32 bits."""
KEPT_FAILURES: Final = 5
"""Number of working folders of failed episodes that are kept."""
_LOOK_S: Final = 0.5
_LIMITS: Final = {"RLIMIT_FSIZE": MAX_FOLDER_BYTES, "RLIMIT_CORE": 0}

log = logging.getLogger(__name__)


def install(definition: Definition, program: str) -> None:
    """Allow this machine's own workers to run a definition.

    Args:
        definition: The definition.
        program: Digest of its program.
    """
    folder = own_folder()
    path = folder / f"{definition.simulator_id(program).removesuffix('@1')}.json"
    partial = path.with_suffix(f".{os.getpid()}")
    partial.write_text(json.dumps({"problem": {"params": definition.document()}}, indent=1))
    partial.replace(path)


def register_commands() -> dict[str, str]:
    """Register a simulator for each definition that may run on this machine.

    Returns:
        Why definitions cannot run, by file.
    """
    left_out = {}
    folder = commands_folder()
    for path in sorted(folder.iterdir()) if folder is not None else ():
        if path.suffix not in (".json", ".yaml", ".yml"):
            continue
        try:
            definition = read_definition(path)
            with tempfile.TemporaryDirectory(prefix="brink-") as here:
                program = definition.program(Path(here))
        except DefinitionError as error:
            left_out[str(path)] = f"{error.field}: {error}"
            continue
        _register(definition, program)
    return left_out


def _register(definition: Definition, program: str) -> None:
    simulator_id = definition.simulator_id(program)
    register(SIMULATORS, simulator_id, lambda: CommandSimulator(definition, program))
    log.info("may run %s", definition.command[0], extra={"simulator": simulator_id, "program": program})


def read_definition(path: Path) -> Definition:
    """Read a definition from a file: a campaign with `command@1`, or its ``problem`` alone.

    Raises:
        DefinitionError: It cannot be read, or is none.
    """
    try:
        document = yaml.safe_load(read_text(path, MAX_DEFINITION_BYTES))
        params = document["problem"]["params"]
    except (OSError, UnicodeDecodeError, yaml.YAMLError, LookupError, TypeError, RecursionError) as error:
        raise DefinitionError("problem", f"expected problem: {{params: …}} in {path.name}: {error}") from None
    if not isinstance(params, Mapping):
        raise DefinitionError("problem", f"expected parameters in {path.name}, got {params!r:.80}")
    given = {name: params[name] for name in FIELDS if name in params}
    return Definition.of(with_contents(given, path.parent))


class CommandSimulator:
    """Runs the episodes of one definition.

    Args:
        definition: The definition.
        program: Digest of its program on this machine.
    """

    def __init__(self, definition: Definition, program: str) -> None:
        self.id = definition.simulator_id(program)
        self._definition = definition
        self._program = program
        self._supervisor = Supervisor(_LIMITS)

    def run(self, spec: EpisodeSpec, *, record: bool = False) -> EpisodeResult:
        """Run one episode in a working folder of its own.

        Args:
            spec: The episode.
            record: Whether the result includes a trace, with all signals that the campaign names.

        Raises:
            InvalidEpisode: A value, the signals or a requirement is wrong.
            SimulationCrashed: The program failed, or logged no usable signals. Its folder is kept.
        """
        began_s = time.process_time()
        with working_folder() as (folder, number):
            try:
                done = self.attempt(spec, folder, number, everything=record)
            except SimulationCrashed as error:
                raise SimulationCrashed(f"{error}\nits folder is kept: {_kept(folder)}") from None
        return EpisodeResult(
            verdicts=done.verdicts,
            objectives={f"{name}:robustness": verdict.robustness for name, verdict in done.verdicts.items()},
            features={},
            provenance=provenance(
                self.id,
                began_s,
                versions_with(),
                program=self._program,
                program_cpu_s=done.ending.cpu_s,
                simulated_s=float(done.time_s[-1] - done.time_s[0]),
            ),
            trace=trace_of(spec, done).to_bytes() if record else None,
        )

    def attempt(
        self, spec: EpisodeSpec, folder: Path, number: int = 0, *, everything: bool = True
    ) -> Attempt:
        """Run one episode in a given folder, which stays as the program leaves it.

        Args:
            spec: The episode.
            folder: An empty folder.
            number: Number that no other episode running on this machine has.
            everything: Whether to read all signals that the campaign names, not only those that verdicts need.

        Raises:
            InvalidEpisode: As for `run`.
            SimulationCrashed: As for `run`.
        """
        spec.check_for(self.id, math.inf)
        source, requirements = signals_of(spec.options, spec.requirements)
        always = {SEED: str(spec.seed % SEEDS), "out": str(folder), "number": str(number)}
        texts = self._texts(spec) | always
        for name, content in self._definition.files(texts):
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(content)
        command = self._definition.arguments(texts)
        ending, output = self._execute(command, folder, spec.duration_s)
        if ending.status not in self._definition.success:
            raise _crashed(command, exit_words(ending.status), output)
        names = dict.fromkeys(name for one in requirements.values() for name in one.signals)
        try:
            time_s, signals = source.read(folder, [*names, *(source.named if everything else ())])
            verdicts = {name: one.verdict(time_s, signals) for name, one in requirements.items()}
        except ValueError as error:
            raise _crashed(command, f"ended, but {error}", output) from None
        return Attempt(
            command=command,
            ending=ending,
            output=output,
            source=source,
            time_s=time_s,
            signals=signals,
            requirements=requirements,
            verdicts=verdicts,
        )

    def _texts(self, spec: EpisodeSpec) -> dict[str, str]:
        values: dict[str, Any] = {}
        for part in spec.scenario.values():
            values |= part if isinstance(part, dict) else {}
        try:
            return self._definition.texts(values)
        except DefinitionError as error:
            raise InvalidEpisode(f"scenario: {error}") from None

    def _execute(self, command: tuple[str, ...], folder: Path, timeout_s: float) -> tuple[Ending, str]:
        """Run a command to its end; return how it ended, and the end of its output."""
        environment = self._definition.variables(folder)
        deadline_s = time.monotonic() + timeout_s
        try:
            program = self._supervisor.start(command, folder=folder, environment=environment)
        except OSError as error:
            raise InvalidEpisode(f"{command[0]} cannot be run: {error.strerror}") from None
        with program:
            while (ending := program.wait(min(deadline_s, time.monotonic() + _LOOK_S))) is None:
                how = ""
                if time.monotonic() >= deadline_s:
                    how = f"did not end in {timeout_s:g} s and was killed"
                elif _size(folder) > MAX_FOLDER_BYTES:
                    how = f"wrote more than {MAX_FOLDER_BYTES:,} bytes and was killed"
                if how:
                    program.kill()
                    raise _crashed(command, how, program.output())
            return ending, program.output()


def signals_of(
    options: Mapping[str, Json], names: tuple[str, ...]
) -> tuple[SignalSource, dict[str, Requirement]]:
    """Return where the signals of an episode stand, and its requirements.

    Args:
        options: Options of the episode.
        names: Names of the requirements to evaluate.

    Raises:
        InvalidEpisode: They are malformed.
    """
    stated = options.get("requirements")
    try:
        source = SignalSource.of(options.get("signals"))
        return source, {
            name: requirement_of(stated.get(name) if isinstance(stated, dict) else None) for name in names
        }
    except (SignalError, RequirementError) as error:
        raise InvalidEpisode(f"options: {error}") from None


def _crashed(command: tuple[str, ...], how: str, output: str) -> SimulationCrashed:
    printed = output.strip()
    return SimulationCrashed(f"{Path(command[0]).name} {how}\n{printed[-2000:] or 'it printed nothing'}")


def _size(folder: Path) -> int:
    size = 0
    for parent, _, names in os.walk(folder):
        for name in names:
            with contextlib.suppress(OSError):
                size += os.lstat(os.path.join(parent, name)).st_size
    return size


def _kept(folder: Path) -> Path:
    """Keep the working folder of a failed episode, and remove older ones."""
    kept = folder.with_name(f"failed-{time.time_ns()}")
    folder.rename(kept)
    for old in sorted(folder.parent.glob("failed-*"))[:-KEPT_FAILURES]:
        shutil.rmtree(old, ignore_errors=True)
    return kept
