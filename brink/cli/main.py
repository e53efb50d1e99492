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
    # The commands load numpy, scipy and a web server, which takes a second: Ctrl-C may come meanwhile.
    from sqlalchemy.exc import DBAPIError

    from brink.cli.commands import app
    from brink.search.errors import MissingExtra
    from brink.server.errors import InvalidInput, ServerError
    from brink.sim.errors import SimulatorError
    from brink.worker.errors import WorkerError

    try:
        app()
    except InvalidInput as error:
        for item in error.errors:
            print(f"brink: {item}", file=sys.stderr)
    except (ServerError, WorkerError, SimulatorError, MissingExtra) as error:
        print(f"brink: {error}", file=sys.stderr)
    except DBAPIError as error:
        words = str(error.orig).strip().splitlines()
        print(f"brink: database: {words[0] if words else type(error.orig).__name__}", file=sys.stderr)
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        print(f"brink: {where}{error.strerror or error}", file=sys.stderr)
    return 1
