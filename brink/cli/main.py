"""The command `brink`. Exits 0, 1 if something failed, 2 if it was called wrongly, 130 after Ctrl-C."""

import sys

INTERRUPTED = 130


def main() -> None:
    """Run the command line; what goes wrong is said in a line, not in a traceback."""
    try:
        sys.exit(_run())
    except KeyboardInterrupt:
        print("brink: interrupted", file=sys.stderr)
        sys.exit(INTERRUPTED)


def _run() -> int:
    # Imported here: Ctrl-C may come while the command loads.
    from brink.cli.commands import app

    try:
        app()
    except Exception as error:
        lines = _explained(error)
        if lines is None:
            raise
        for line in lines:
            print(f"brink: {line}", file=sys.stderr)
    return 1


def _explained(error: Exception) -> list[str] | None:
    """Return an expected error in lines for people; None for a fault of ours, which deserves its traceback."""
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
        words = str(error.orig).strip().splitlines()
        return [f"database: {words[0] if words else type(error.orig).__name__}"]
    return None
