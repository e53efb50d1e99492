"""The simulator that calls a user's Python function.

The function travels as a file, `FunctionFile`, whose path is in the environment of the workers that may run it. The
simulator's id carries the digest of its code: results of an older version of the function are never taken for those
of this one, and no other worker is asked to run it.
"""

import hashlib
import inspect
import math
import os
import pickle
import sys
import time
import traceback
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

import cloudpickle

from brink.sim.catalogue import FUNCTION_PREFIX, SIMULATORS, register
from brink.sim.episode import EpisodeResult, EpisodeSpec, Json, Verdict
from brink.sim.errors import InvalidEpisode
from brink.sim.provenance import provenance, versions_with
from brink.sim.sources import source_digest, source_files

FUNCTION: Final = "function"
"""The requirement that a function decides: what it returns is the robustness."""
FILE_VARIABLE: Final = "BRINK_FUNCTION"
"""Environment variable with the path of the function's file."""
SEED: Final = "seed"
"""Argument that gets the episode's seed, if the function has it and the space does not."""
_DIGITS: Final = 16


def simulator_of(digest: str) -> str:
    """Return the id of the simulator that calls the function with this digest."""
    return f"{FUNCTION_PREFIX}{digest[:_DIGITS] or 'unknown'}@1"


def digest_of(function: Callable[..., Any]) -> str:
    """Return the SHA-256 of a function's code as far as it is accessible.

    A function of an importable module counts with the source of its module and of what belongs to it; see
    `brink.sim.sources`.
    """
    digest = hashlib.sha256(cloudpickle.dumps(function))
    module = inspect.getmodule(function)
    for source in (module, function):
        try:
            digest.update(inspect.getsource(source).encode())  # type: ignore[arg-type]
            if module is not None and len(source_files(module.__name__)) > 1:
                digest.update(source_digest(module.__name__).encode())
            break
        except (OSError, TypeError):  # typed in, built in, or an object that can be called
            continue
    return digest.hexdigest()


def write_function(function: Callable[..., Any], folder: Path) -> tuple[Path, str]:
    """Write a function to a file for workers of this machine.

    Args:
        function: The function; anything that can be called and pickled by cloudpickle.
        folder: Where to write.

    Returns:
        The file, and the digest of the function.

    Raises:
        TypeError: It cannot be pickled.
    """
    digest = digest_of(function)
    path = folder / f"{FUNCTION_PREFIX}{digest[:_DIGITS]}.pickle"
    folder.mkdir(parents=True, exist_ok=True)
    path.write_bytes(
        cloudpickle.dumps({"path": sys.path, "digest": digest, "call": cloudpickle.dumps(function)})
    )
    return path, digest


class FunctionSimulator:
    """Calls the function of a file, once for each episode.

    Args:
        path: The file. It is read at the first episode.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._id = simulator_of(path.stem.removeprefix(FUNCTION_PREFIX))
        self._function: Callable[..., Any] | None = None
        self._wants_seed = False

    def run(self, spec: EpisodeSpec, *, record: bool = False) -> EpisodeResult:
        """Call the function with the values of an episode.

        Args:
            spec: The episode; the values are in its scenario.
            record: Has no effect: a function has no trace.

        Raises:
            InvalidEpisode: The episode is not for this function; or the function raised an exception, or returned no
                finite number.
        """
        spec.check_for(self._id, math.inf)
        if spec.requirements != (FUNCTION,):
            raise InvalidEpisode(f"requirements: expected {FUNCTION}, got {', '.join(spec.requirements)}")
        cpu_s = time.process_time()
        function = self._loaded()
        values = dict(_values(spec.scenario))
        if self._wants_seed and SEED not in values:
            values[SEED] = spec.seed
        try:
            returned = function(**values)
        except Exception as error:
            raise InvalidEpisode(_words(error, function, values)) from error
        robustness, objectives = _outcome(returned)
        return EpisodeResult(
            verdicts={FUNCTION: Verdict(robustness=robustness, unit="1", violated_at_s=None)},
            objectives=objectives,
            features={},
            provenance=provenance(spec.simulator, cpu_s, versions_with("cloudpickle")),
        )

    def _loaded(self) -> Callable[..., Any]:
        if self._function is None:
            content = pickle.loads(self._path.read_bytes())
            sys.path.extend(entry for entry in content["path"] if entry not in sys.path)
            self._function = pickle.loads(content["call"])
            self._wants_seed = takes_seed(self._function)
        return self._function


def takes_seed(function: Callable[..., Any]) -> bool:
    """Return whether a function has an argument for the episode's seed."""
    try:
        return SEED in inspect.signature(function).parameters
    except ValueError:  # some built-in functions have no signature
        return False


def _values(scenario: Mapping[str, Json]) -> Mapping[str, Json]:
    """Return the values of all components by name; names are unique, which `brink.search` has checked."""
    return {
        name: value for part in scenario.values() if isinstance(part, Mapping) for name, value in part.items()
    }


def _outcome(returned: Any) -> tuple[float, dict[str, float]]:
    """Return robustness and objectives.

    Raises:
        InvalidEpisode: The function returned something else.
    """
    objectives: dict[str, float] = {}
    margin = returned
    if isinstance(returned, Mapping):
        rest = dict(returned)
        margin = rest.pop("robustness", None)
        objectives = {str(name): _number(value, str(name)) for name, value in rest.items()}
    return _number(margin, "robustness"), objectives


def _number(value: Any, name: str) -> float:
    is_number = (
        hasattr(value, "__float__") and not isinstance(value, bool) and "bool" not in type(value).__name__
    )
    if not is_number or not math.isfinite(float(value)):
        raise InvalidEpisode(
            f"the function returned {value!r} as {name}: expected a finite number, negative if the requirement is "
            "violated, or a mapping with such a number as 'robustness' and objectives to minimise"
        )
    return float(value)


def _words(error: Exception, function: Callable[..., Any], values: Mapping[str, Json]) -> str:
    """Return a one-line message: what went wrong, where in the function's file, and with which values."""
    frames = traceback.extract_tb(error.__traceback__)[1:]  # the first one is the call in this module
    code = getattr(function, "__code__", None)
    own = [frame for frame in frames if code is not None and frame.filename == code.co_filename]
    where = ""
    if shown := (own or frames)[-1:]:
        line = f": {shown[0].line}" if shown[0].line else ""
        where = f", at {Path(shown[0].filename).name}, line {shown[0].lineno}{line}"
    given = ", ".join(f"{name}={value!r}" for name, value in values.items())
    said = " ".join(str(error).split())
    return f"the function raised {type(error).__name__}: {said}{where}; called with {given}"


if FILE_VARIABLE in os.environ:  # in a worker that `brink.search` started
    _FILE = Path(os.environ[FILE_VARIABLE])
    register(
        SIMULATORS, simulator_of(_FILE.stem.removeprefix(FUNCTION_PREFIX)), lambda: FunctionSimulator(_FILE)
    )
