"""How a test session uses the machine: files in memory, tests spread over processes, one Postgres for all of them."""

import os
import shutil
import tempfile
from collections import defaultdict
from collections.abc import Iterable
from contextlib import ExitStack
from heapq import nlargest
from pathlib import Path

import pytest
from xdist.scheduler import LoadFileScheduling
from xdist.workermanage import WorkerController

from benchmarks.servers import NoPostgres
from support.databases import running_postgres

MEMORY = Path("/dev/shm")
LISTED = 30
LISTED_FROM_S = 300.0
ENOUGH_BYTES = 4 * 2**30
"""A run leaves a few hundred MB behind it, and Postgres as much."""


def use_memory() -> None:
    """Put the temporary files of this process and its children into memory, if there is room and TMPDIR is not set.

    SQLite waits for the disk at every commit, and nothing of a test has to survive a power cut.
    """
    if "TMPDIR" in os.environ or not _roomy(MEMORY):
        return
    os.environ["TMPDIR"] = tempfile.tempdir = str(MEMORY)


def _roomy(folder: Path) -> bool:
    """Return whether a folder has enough room, and programs may be run from there."""
    if not folder.is_dir() or not os.access(folder, os.W_OK | os.X_OK):
        return False
    memory_bytes = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    return (
        min(shutil.disk_usage(folder).free, memory_bytes // 3) > ENOUGH_BYTES
        and not os.statvfs(folder).f_flag & os.ST_NOEXEC
    )


class LongestFirst(LoadFileScheduling):  # type: ignore[misc]
    """Distributes whole files, whose tests share fixtures; what takes longest comes first.

    The tests of the dashboard in a browser share one site, so they go to one process, unless they do without it.
    """

    TOGETHER = "tests/browser"
    ALONE = (
        "tests/browser/test_browser_labels.py",
        "tests/browser/test_browser_opening.py",
        "tests/browser/test_browser_tokens.py",
    )
    """Files whose tests have coordinators of their own."""
    FIRST = (
        TOGETHER,
        "tests/integration/database/test_queue_machine.py",
        "tests/acceptance",
        "tests/integration/server/test_chaos.py",
        "tests/unit/sim/perception",
        "tests/integration",
        "tests/unit/sim",
        "tests/unit/plots",
        "tests/contract",
        "tests/unit/worker",
        "tests/unit/search",
    )

    def _split_scope(self, nodeid: str) -> str:
        shares_site = nodeid.startswith(self.TOGETHER) and not nodeid.startswith(self.ALONE)
        return self.TOGETHER if shares_site else str(super()._split_scope(nodeid))

    def _assign_work_unit(self, node: WorkerController) -> None:
        for folder in self.FIRST:
            if found := next((scope for scope in self.workqueue if scope.startswith(folder)), None):
                self.workqueue.move_to_end(found, last=False)
                break
        super()._assign_work_unit(node)


def slowest_files(reports: Iterable[pytest.TestReport]) -> list[str]:
    """Return a line for each of the files with the longest tests, and one for all; none after a short run."""
    by_file: dict[str, float] = defaultdict(float)
    for report in reports:
        by_file[report.nodeid.split("::")[0]] += report.duration
    total_s = sum(by_file.values())
    if total_s < LISTED_FROM_S:
        return []
    return [
        *(f"{by_file[file]:6.0f} s  {file}" for file in nlargest(LISTED, by_file, key=by_file.__getitem__)),
        f"{total_s:6.0f} s  all {len(by_file)} files, in all processes together",
    ]


class SharedPostgres:
    """Runs one Postgres server for all processes of a session."""

    def __init__(self) -> None:
        self._stack = ExitStack()
        self._found: dict[str, str] = {}

    def address(self) -> dict[str, str]:
        """Return the server's ``url``, or ``missing`` with the reason why there is none; the first call starts it."""
        if not self._found:
            try:
                self._found = {"url": self._stack.enter_context(running_postgres())}
            except NoPostgres as error:
                self._found = {"missing": str(error)}
        return self._found

    def stop(self) -> None:
        """Stop the server, if it was started."""
        self._stack.close()
