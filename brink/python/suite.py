"""Suites from Python: drives that were found once, simulated again with a version of a system."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from brink.api.suites import run_suite, suite_results
from brink.python.client import settings_of
from brink.python.connection import Connection, with_workers
from brink.python.display import display_of
from brink.python.synchronous import synchronous
from brink.server.suites.campaigns import cases_of, prepare_runs
from brink.server.suites.file import SuiteFile, read_suite
from brink.server.suites.results import SuiteResults

if TYPE_CHECKING:
    import pandas as pd


class Suite:
    """A suite file, such as `brink suite create` writes.

    Args:
        path: The file.

    Raises:
        InvalidInput: It cannot be read, or is not a suite.

    Example:
        >>> import brink
        >>> results = brink.Suite("hazards.yaml").run({"detector": "brink-det@1"})  # doctest: +SKIP
        >>> results.passed  # doctest: +SKIP
        True
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.file: SuiteFile = read_suite(self.path)

    def __repr__(self) -> str:
        return f"<suite {self.path}, {len(self.file.entries)} entries>"

    def to_pandas(self) -> "pd.DataFrame":
        """Return its drives, one a row: name, system, what it was found to be, what is expected, evidence."""
        import pandas as pd

        return pd.DataFrame(
            [
                {
                    "name": case.name,
                    "system": case.entry.system,
                    "found": case.side,
                    "expect": case.drive.expect,
                    "unsafe": case.drive.unsafe,
                    "of": case.drive.of,
                }
                for case in cases_of(self.file)
            ]
        )

    async def run_async(
        self,
        changes: Mapping[str, Any] | None = None,
        *,
        label: str = "",
        workers: int = 2,
        database: str | None = None,
        server: str | None = None,
        token: str | None = None,
        progress: bool = True,
    ) -> SuiteResults:
        """Simulate the suite, and return the verdict on each drive.

        An earlier run of the same version is continued, or returned if it has finished.

        Args:
            changes: New values of parameters of the problems.
            label: What is tested, such as a release; empty to say what is changed.
            workers: Number of worker processes on this machine.
            database: Its database; None for the default one.
            server: URL of a coordinator, whose workers simulate instead; None for this machine.
            token: The token that it requires.
            progress: Whether to show the progress.

        Returns:
            Its ``cases`` have the verdicts; ``passed`` says whether all are as expected.

        Raises:
            InvalidInput: No problem of the suite has a parameter that is to be changed.
            CoordinatorError: Nobody answers.
        """
        connection = (
            Connection.local(settings_of(database)) if server is None else Connection(server, token=token)
        )
        runs = prepare_runs(
            self.file, changes or {}, name=self.path.stem, path=self.path, here=server is None
        )
        async with with_workers(connection, workers) as session:

            async def follow(campaign: str) -> object:
                with display_of(progress) as display:
                    return await session.follow(campaign, display, [f"/campaigns/{campaign}"])

            cases, complete = await run_suite(session.api, runs, follow, label=label)
        return suite_results(
            self.path.stem,
            runs,
            cases,
            [case.name for case in cases_of(self.file)],
            changes=dict(changes or {}),
            label=label,
            complete=complete,
        )

    run = synchronous(run_async)
