"""Which tests run in which process, where there are several.

Files stay whole, since the tests of a file share fixtures. So do two folders: tests in a browser share it, and
a coordinator with its worker; acceptance tests start so many processes that no two should run at once. What takes
longest comes first, so that no process is left over with it.
"""

from xdist.scheduler import LoadFileScheduling
from xdist.workermanage import WorkerController

FIRST = ("tests/acceptance/", "tests/integration/server/test_queue_machine.py", "tests/browser/")


class ByFolder(LoadFileScheduling):  # type: ignore[misc]
    """Distributes files, and these folders, the longest first."""

    def _split_scope(self, nodeid: str) -> str:
        return next((one for one in FIRST if nodeid.startswith(one)), super()._split_scope(nodeid))

    def _assign_work_unit(self, node: WorkerController) -> None:
        for scope in reversed(FIRST):
            if scope in self.workqueue:
                self.workqueue.move_to_end(scope, last=False)
        super()._assign_work_unit(node)
