"""The command `brink`. Exit codes: 0 success, 1 failure, 2 wrong usage, 130 after Ctrl-C."""

import sys
from importlib import import_module

INTERRUPTED = 130


def main() -> None:
    """Run the command line."""
    run("brink.cli.commands", "app")


def run(module: str, name: str) -> None:
    """Run a command line; print expected errors as one line each, without a traceback.

    Args:
        module: Module of the Typer app. It is imported here, so that Ctrl-C is handled while it loads.
        name: Its name in the module.
    """
    try:
        sys.exit(_run(module, name))
    except KeyboardInterrupt:
        print("brink: interrupted", file=sys.stderr)
        sys.exit(INTERRUPTED)


def _run(module: str, name: str) -> int:
    try:
        getattr(import_module(module), name)()
    except Exception as error:
        from brink.worker.printable import printable

        lines = _describe(error)
        if lines is None:
            raise
        for line in lines:
            print(f"brink: {printable(line)}", file=sys.stderr)
    return 1


def _describe(error: Exception) -> list[str] | None:
    """Return the lines that describe an expected error; None for a bug, whose traceback is shown."""
    from brink.search.errors import MissingExtra
    from brink.server.errors import InvalidInput, ServerError
    from brink.sim.errors import SimulatorError
    from brink.worker.errors import WorkerError

    if isinstance(error, InvalidInput):
        return [str(item) for item in error.errors]
    if isinstance(error, ServerError | WorkerError | SimulatorError | MissingExtra):
        return [str(error)]
    if isinstance(error, OSError):
        where = f"{error.filename}: " if error.filename else ""
        return [f"{where}{error.strerror or error}"]
    from sqlalchemy.exc import DBAPIError

    if isinstance(error, DBAPIError):
        reason = str(error.orig).strip().splitlines()
        return [f"database: {reason[0] if reason else type(error.orig).__name__}"]
    return None
