"""SUMO in this process: loads libsumo at the first episode, and starts and closes one simulation at a time.

libsumo is one simulation a process. Every simulation here starts from nothing and is closed at its end, whatever
happens, so that it does not depend on those before it.
"""

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import cache
from importlib.util import find_spec
from tempfile import TemporaryFile
from typing import Any, Final, TypeAlias

from brink.sim.errors import ExtraMissing, SimulationCrashed

Library: TypeAlias = Any
"""The module `libsumo`, which has no types."""

SUMO_STEP_S: Final = 0.1
_QUIET: Final = "LIBSUMO_AS_TRACI"
_OPTIONS: Final = (
    "--step-length",
    str(SUMO_STEP_S),
    "--no-step-log",
    "true",
    "--no-warnings",
    "true",
    "--xml-validation",
    "never",
    "--xml-validation.net",
    "never",
    "--time-to-teleport",
    "-1",
    "--collision.action",
    "warn",
    "--collision.mingap-factor",
    "0",
    "--collision.check-junctions",
    "true",
    "--collision.check-junctions.mingap",
    "0",
    "--lanechange.duration",
    "3",
    "--max-depart-delay",
    "30",
    "--precision",
    "6",
)

if find_spec("libsumo") is None:
    raise ExtraMissing("sumo@1 needs libsumo: install the extra sumo")


@cache
def load() -> Library:
    """Return libsumo; the first call loads it."""
    known = os.environ.get(_QUIET)
    os.environ[_QUIET] = "quiet"  # or it prints which version of pyarrow it would like
    try:
        import libsumo

        return libsumo
    finally:
        if known is None:
            del os.environ[_QUIET]
        else:
            os.environ[_QUIET] = known


class CannotStart(SimulationCrashed):
    """SUMO refuses to start with these files and options; the message is SUMO's."""


@contextmanager
def simulation(options: Sequence[str]) -> Iterator[Library]:
    """Yield libsumo with a simulation that is closed at the end of the block.

    Args:
        options: Options of SUMO, besides those that hold for every episode.

    Raises:
        CannotStart: SUMO does not start.
        SimulationCrashed: SUMO failed later.
    """
    sumo = load()
    _close(sumo)
    try:
        _start(sumo, options)
        yield sumo
    except (sumo.TraCIException, sumo.FatalTraCIError) as error:
        raise SimulationCrashed(f"SUMO failed: {error}") from error
    finally:
        _close(sumo)


def _start(sumo: Library, options: Sequence[str]) -> None:
    with TemporaryFile() as printed:
        try:
            with _stderr_to(printed.fileno()):
                sumo.start(["sumo", *_OPTIONS, *options])
        except (sumo.TraCIException, sumo.FatalTraCIError) as error:
            # The exception says that there was an error, and what is printed says which.
            printed.seek(0)
            words = " ".join(printed.read().decode(errors="replace").split())
            raise CannotStart(f"SUMO does not start: {words or error}") from error


def _close(sumo: Library) -> None:
    with suppress(sumo.TraCIException, sumo.FatalTraCIError), open(os.devnull, "wb") as nowhere:
        if sumo.simulation.isLoaded():
            with _stderr_to(nowhere.fileno()):
                sumo.close()


@contextmanager
def _stderr_to(file: int) -> Iterator[None]:
    """Redirect SUMO's standard error, which bypasses Python's `sys.stderr`."""
    kept = os.dup(2)
    os.dup2(file, 2)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
