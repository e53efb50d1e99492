"""One simulation process with its pipes, from its start to its burial."""

import logging
import os
import select
import signal
import subprocess
import sys
import time
from typing import Final

from pydantic import ValidationError

from brink.worker.child_wire import Hello, RunEpisode
from brink.worker.errors import BrokenFrame
from brink.worker.frames import FrameBuffer, encode_frame
from brink.worker.settings import TOKEN_VARIABLE
from brink.worker.stderr_tail import StderrTail

log = logging.getLogger(__name__)

ONE_THREAD: Final = dict.fromkeys(
    (
        "OMP_NUM_THREADS",
        "OPENBLAS_NUM_THREADS",
        "MKL_NUM_THREADS",
        "NUMEXPR_NUM_THREADS",
        "VECLIB_MAXIMUM_THREADS",
        "BLIS_NUM_THREADS",
    ),
    "1",
)
"""One thread an episode: a machine runs one worker a core, and sums must not depend on the number of threads."""

_READ_BYTES = 1 << 16
_LIVENESS_S = 1.0
_LAST_WORDS_S = 0.3
_SILENCE_S = 0.02


class ChildHandle:
    """One process with its pipes, from its start to its burial."""

    def __init__(self, memory_mib: int, plugins: tuple[str, ...]) -> None:
        requests_in, self._requests = os.pipe()
        self._replies, replies_out = os.pipe()
        lifeline_in, self._lifeline = os.pipe()
        errors, errors_out = os.pipe()
        passed = (requests_in, replies_out, lifeline_in)
        command = [sys.executable, "-m", "brink.worker.child"]
        for name, fd in zip(("--requests", "--replies", "--lifeline"), passed, strict=True):
            command += [name, str(fd)]
        command += ["--memory-mib", str(memory_mib)]
        try:
            self.popen = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=errors_out,
                stderr=errors_out,
                pass_fds=passed,
                # A group of its own: what a simulator starts is killed with it, and Ctrl-C does not reach it.
                start_new_session=True,
                env=_environment(plugins),
            )
        finally:
            for fd in (*passed, errors_out):
                os.close(fd)
        for fd in (self._requests, self._replies, errors):
            os.set_blocking(fd, False)
        self.stderr = StderrTail(errors)
        self.gone = False
        self._frames = FrameBuffer()
        self._unsent = bytearray()
        self._writing = False
        self._poll = select.poll()
        self._poll.register(self._replies, select.POLLIN)
        self._poll.register(errors, select.POLLIN)

    def alive(self) -> bool:
        """Whether the process still runs."""
        return not self.gone and self.popen.poll() is None

    def send(self, request: RunEpisode) -> None:
        """Queue a request on its pipe and write what fits."""
        self._unsent += encode_frame(request.model_dump_json().encode())
        self._flush()

    def await_hello(self, timeout_s: float) -> Hello | None:
        """Return the first message, or None if the process died, kept silent or spoke nonsense."""
        try:
            frame = self.await_frame(time.monotonic() + timeout_s)
            return None if frame is None else Hello.model_validate_json(frame)
        except (TimeoutError, BrokenFrame, ValidationError):
            return None

    def await_frame(self, deadline_s: float) -> bytes | None:
        """Return the next frame, or None once the process has died.

        Raises:
            TimeoutError: The deadline on the monotonic clock has passed.
            BrokenFrame: The pipe carries something else than frames.
        """
        while (frame := self._frames.pop()) is None:
            left_s = deadline_s - time.monotonic()
            if left_s <= 0:
                raise TimeoutError
            # Descendants may hold the pipe open after the process has died, so its end alone does not tell.
            events = self._poll.poll(min(left_s, _LIVENESS_S) * 1000)
            if any(fd == self.stderr.fd for fd, _ in events) and not self.stderr.drain():
                self._poll.unregister(self.stderr.fd)
            if any(fd == self._requests for fd, _ in events):
                self._flush()
            if any(fd == self._replies for fd, _ in events):
                if not self._read_replies():
                    return None
            elif not events and self.popen.poll() is not None:
                return self._frames.pop()
        return frame

    def last_words(self) -> str:
        """Ask a hung process where it is, and return what it says."""
        self.stderr.drain()
        self.popen.send_signal(signal.SIGUSR1)
        watch = select.poll()
        watch.register(self.stderr.fd, select.POLLIN)
        wait_s, deadline_s = _LAST_WORDS_S, time.monotonic() + 2 * _LAST_WORDS_S
        while time.monotonic() < deadline_s and watch.poll(wait_s * 1000) and self.stderr.drain():
            wait_s = _SILENCE_S
        return self.stderr.text()

    def kill_group(self) -> None:
        """Kill the process and what it started, if it has not been buried."""
        if not self.gone:
            try:
                os.killpg(self.popen.pid, signal.SIGKILL)
            except ProcessLookupError:
                log.debug("the simulation process was gone already", extra={"pid": self.popen.pid})

    def bury(self) -> str:
        """Make sure that the process is dead and return how it ended, such as ``was killed by SIGSEGV``."""
        if not self.gone:
            # A process whose pipe has ended has its exit status already: this signal does not change it.
            self.kill_group()
            self.popen.wait()
            self.gone = True
            self.stderr.drain()
        return _how_it_ended(self.popen.returncode)

    def close(self) -> None:
        """Close the pipes of a buried process."""
        for fd in (self._requests, self._replies, self._lifeline, self.stderr.fd):
            os.close(fd)

    def _flush(self) -> None:
        try:
            while self._unsent:
                del self._unsent[: os.write(self._requests, self._unsent)]
        except BlockingIOError:
            if not self._writing:
                self._poll.register(self._requests, select.POLLOUT)
                self._writing = True
            return
        except BrokenPipeError:
            # The end of the reply pipe will tell the same, with the cause.
            self._unsent.clear()
        if self._writing:
            self._poll.unregister(self._requests)
            self._writing = False

    def _read_replies(self) -> bool:
        try:
            while data := os.read(self._replies, _READ_BYTES):
                self._frames.feed(data)
                if len(data) < _READ_BYTES:
                    return True
        except BlockingIOError:
            return True
        return False


def _environment(plugins: tuple[str, ...]) -> dict[str, str]:
    environment = {name: value for name, value in os.environ.items() if name != TOKEN_VARIABLE}
    named = [*filter(None, environment.get("BRINK_PLUGINS", "").split(",")), *plugins]
    return {
        **environment,
        **ONE_THREAD,
        "BRINK_PLUGINS": ",".join(dict.fromkeys(named)),
        # What a simulator printed before it died must be in the pipe by then.
        "PYTHONUNBUFFERED": "1",
    }


def _how_it_ended(returncode: int) -> str:
    if returncode >= 0:
        return f"exited with status {returncode}"
    try:
        name = signal.Signals(-returncode).name
    except ValueError:
        name = f"signal {-returncode}"
    hint = " (by the system when memory runs out, or by hand)" if name == "SIGKILL" else ""
    return f"was killed by {name}{hint}"
