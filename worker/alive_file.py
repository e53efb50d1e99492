"""A file that a worker touches while its threads make progress, for liveness probes, which check its age.

A worker that waits for an absent coordinator is alive, and so is one whose episode takes long: other time limits deal
with those.
"""

import logging
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

TOUCH_S: Final = 5.0
"""How often the file is touched."""
STUCK_S: Final = 120.0
"""A thread that has made no progress for this long is stuck; its requests have much shorter time limits."""

log = logging.getLogger(__name__)


class AliveFile:
    """Touches a file every few seconds.

    Args:
        path: The file, which is created; None to touch nothing.
        clock: Monotonic clock, in seconds.
    """

    def __init__(self, path: Path | None, clock: Callable[[], float] = time.monotonic) -> None:
        self._path = path
        self._clock = clock
        self._due_s = -math.inf

    def update(self, progress_s: float | None = None) -> None:
        """Touch the file, unless that was done a moment ago or a thread is stuck.

        Args:
            progress_s: When the thread last made progress, by the monotonic clock; None if it has not begun.
        """
        now_s = self._clock()
        if self._path is None or now_s < self._due_s:
            return
        self._due_s = now_s + TOUCH_S
        if progress_s is not None and now_s - progress_s > STUCK_S:
            log.error("the heartbeat thread is stuck", extra={"for_s": round(now_s - progress_s)})
            return
        try:
            self._path.touch()
        except OSError as error:
            log.warning("cannot touch %s: %s", self._path, error.strerror)
