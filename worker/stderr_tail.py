"""The end of what a simulation process printed, for the message of a job that failed."""

import logging
import os

log = logging.getLogger(__name__)

KEPT_BYTES = 4096
_READ_BYTES = 1 << 16
_READS_AT_ONCE = 16


class StderrTail:
    """Drains a non-blocking pipe and keeps the last few lines.

    Attributes:
        fd: Read end of the pipe.
    """

    __slots__ = ("_kept", "fd")

    def __init__(self, fd: int) -> None:
        self.fd = fd
        self._kept = b""

    def drain(self) -> bool:
        """Take what has arrived; False once the pipe has ended."""
        try:
            # Bounded, since a simulator may print faster than this reads.
            for _ in range(_READS_AT_ONCE):
                data = os.read(self.fd, _READ_BYTES)
                if not data:
                    return False
                if log.isEnabledFor(logging.DEBUG):
                    log.debug("simulator: %s", data.decode(errors="replace").rstrip())
                self._kept = (self._kept + data)[-KEPT_BYTES:]
        except BlockingIOError:
            return True
        return True

    def forget(self) -> None:
        """Drop what has arrived so far: it belongs to an episode that ended well."""
        self.drain()
        self._kept = b""

    def text(self) -> str:
        """Return what was kept."""
        return self._kept.decode(errors="replace")
