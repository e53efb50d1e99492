"""Runs a program of a user: in a session of its own, with limits, and with nothing left of it afterwards.

A `Supervisor` is a small process that starts programs and ends them; see `brink.sim.programs.supervisor` for what it
guarantees. Keep one as long as programs are run: starting it takes about as long as starting Python. The end of what
a program prints is kept for messages; a program that prints without end neither blocks nor fills the memory.
"""

import json
import logging
import os
import select
import signal
import socket
import struct
import subprocess
import sys
import time
import weakref
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Self

from brink.sim.errors import SimulationCrashed

log = logging.getLogger(__name__)

PRINTED_BYTES: Final = 4096
"""How much of a program's output is kept for messages."""
_READ_BYTES: Final = 1 << 16
_READS_PER_DRAIN: Final = 16
_SETPRIV: Final = "/usr/bin/setpriv"
_KILLED: Final = "the supervisor of programs was killed"
_LENGTH: Final = struct.Struct(">I")
_INHERITED: Final = (
    *("PATH", "HOME", "USER", "LANG", "LC_ALL", "TZ", "TMPDIR", "LD_LIBRARY_PATH"),
    *("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_CORETYPE"),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Ending:
    """How a program ended.

    Attributes:
        status: Exit status; negative: the signal that killed it.
        cpu_s: CPU time of the program and of the children that it waited for.
        was_killed: Whether it was still running when it was told to end.
        left: Number of processes that it had started, which were killed.
    """

    status: int
    cpu_s: float
    was_killed: bool
    left: int


class Supervisor:
    """A process that runs programs, one at a time. A context manager; ends with this process at the latest.

    Args:
        limits: Values of resource limits, such as ``{"RLIMIT_FSIZE": 10_000_000}``, for each process of the programs.
            They also have those of this process.

    Raises:
        OSError: This system is not Linux.
    """

    def __init__(self, limits: Mapping[str, int] | None = None) -> None:
        if sys.platform != "linux":
            raise OSError("programs of users run on Linux alone")
        control, theirs = socket.socketpair()
        with theirs:
            popen = subprocess.Popen(
                # By its path and without site-packages: a fifth of the time to start.
                [
                    *(sys.executable, "-I", "-S", str(Path(__file__).with_name("supervisor.py"))),
                    *(str(theirs.fileno()), str(os.getpid()), json.dumps(dict(limits or {})), _setpriv()),
                ],
                stdin=subprocess.DEVNULL,
                pass_fds=(theirs.fileno(),),
                start_new_session=True,  # it must outlive this process, to end what runs
            )
        self.control = control
        self._close = weakref.finalize(self, _close, control, popen)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self) -> None:
        """End the program that runs, if any, and the supervisor."""
        self._close()

    def start(
        self,
        command: Sequence[str],
        *,
        folder: Path,
        environment: Mapping[str, str],
        channel_variable: str | None = None,
    ) -> "Program":
        """Start a program. The one before must have ended.

        Args:
            command: Program and arguments; no shell reads them.
            folder: Working folder.
            environment: All environment variables; see `plain_environment`.
            channel_variable: Name of the environment variable that gets the number of a file descriptor: a stream
                socket, whose other end is `Program.channel`. None: no such socket.

        Raises:
            OSError: The program or the folder does not exist, or cannot be executed.
            SimulationCrashed: The supervisor was killed.
        """
        output, theirs = os.pipe()
        channel, their_channel = (None, None) if channel_variable is None else socket.socketpair()
        body = json.dumps(
            {
                "command": list(command),
                "folder": str(folder),
                "environment": dict(environment),
                "channel_variable": channel_variable,
            }
        ).encode()
        program = Program(self, output, channel)
        try:
            passed = [theirs] if their_channel is None else [theirs, their_channel.fileno()]
            socket.send_fds(self.control, [_LENGTH.pack(len(body))], passed)
            self.control.sendall(body)
        except OSError:
            program.close()
            raise SimulationCrashed(_KILLED) from None
        finally:
            os.close(theirs)
            if their_channel is not None:
                their_channel.close()
        reply = program.reply()
        if "pid" not in reply:
            program.close()
            raise OSError(reply["errno"], reply["strerror"], reply["filename"])
        program.pid = reply["pid"]
        return program


def _setpriv() -> str:
    """Return the path of util-linux's setpriv; empty without one. BusyBox's lacks the option that is needed."""
    return _SETPRIV if os.access(_SETPRIV, os.X_OK) and not os.path.islink(_SETPRIV) else ""


def _close(control: socket.socket, popen: "subprocess.Popen[bytes]") -> None:
    control.close()
    popen.wait()


class Program:
    """A running program of a user. A context manager, which ends it. Made by `Supervisor.start`.

    Attributes:
        pid: Its process id.
        channel: This end of its socket, if it has one.
        ending: How it ended; None while it runs.
    """

    def __init__(self, supervisor: Supervisor, output: int, channel: socket.socket | None) -> None:
        self.pid = 0
        self.channel = channel
        self.ending: Ending | None = None
        self._control = supervisor.control
        self._supervisor = supervisor  # which ends when nobody holds it
        os.set_blocking(output, False)
        self._output = OutputTail(output)
        self._channel_fd = -1 if channel is None else channel.fileno()
        self._poll = select.poll()
        for fd in (self._channel_fd, output, self._control.fileno()):
            if fd >= 0:
                self._poll.register(fd, select.POLLIN)
        self._closed = False

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def await_channel(self, deadline_s: float) -> bool:
        """Wait until there is something to read on the channel, or it has ended; return False at a deadline.

        Args:
            deadline_s: Time of `time.monotonic`.
        """
        return self._await(self._channel_fd, deadline_s)

    def wait(self, deadline_s: float) -> Ending | None:
        """Wait until the program has ended, and return how; None at a deadline.

        Args:
            deadline_s: Time of `time.monotonic`.

        Raises:
            SimulationCrashed: The supervisor was killed.
        """
        if self.ending is None and self._await(self._control.fileno(), deadline_s):
            self.ending = Ending(**self.reply())
            self._output.drain()
        return self.ending

    def kill(self) -> Ending:
        """End the program and whatever it started, if it still runs, and return how it ended.

        Raises:
            SimulationCrashed: The supervisor was killed.
        """
        if self.ending is None:
            try:
                self._control.sendall(_LENGTH.pack(2) + b"{}")
            except OSError:
                raise SimulationCrashed(_KILLED) from None
            self.ending = Ending(**self.reply())
            self._output.drain()
        return self.ending

    def output(self) -> str:
        """Return the end of what the program has printed."""
        self._output.drain()
        return self._output.text()

    def close(self) -> None:
        """End the program, and release its descriptors."""
        if self._closed:
            return
        self._closed = True
        try:
            if self.pid:
                self.kill()
        except SimulationCrashed:
            log.debug(_KILLED)
        finally:
            os.close(self._output.fd)
            if self.channel is not None:
                self.channel.close()

    def reply(self) -> dict[str, Any]:
        """Return the supervisor's next message.

        Raises:
            SimulationCrashed: The supervisor was killed.
        """
        head = self._control.recv(_LENGTH.size, socket.MSG_WAITALL)
        body = self._control.recv(_LENGTH.unpack(head)[0], socket.MSG_WAITALL) if head else b""
        if not body:
            raise SimulationCrashed(_KILLED)
        reply: dict[str, Any] = json.loads(body)
        return reply

    def _await(self, wanted_fd: int, deadline_s: float) -> bool:
        while (left_s := deadline_s - time.monotonic()) > 0:
            ready = [fd for fd, _ in self._poll.poll(left_s * 1000)]
            if wanted_fd in ready:
                return True
            if self._output.fd in ready and not self._output.drain():
                self._poll.unregister(self._output.fd)
        return False


class OutputTail:
    """Drains the non-blocking pipe of standard output and error, and keeps the end of the text.

    Attributes:
        fd: Read end of the pipe.
    """

    __slots__ = ("_tail", "fd")

    def __init__(self, fd: int) -> None:
        self.fd = fd
        self._tail = b""

    def drain(self) -> bool:
        """Read what is available; return False once the pipe has ended."""
        try:
            # Bounded, since a program may print faster than this reads.
            for _ in range(_READS_PER_DRAIN):
                data = os.read(self.fd, _READ_BYTES)
                if not data:
                    return False
                if log.isEnabledFor(logging.DEBUG):
                    log.debug("printed: %s", data.decode(errors="replace").rstrip())
                self._tail = (self._tail + data)[-PRINTED_BYTES:]
        except BlockingIOError:
            return True
        return True

    def clear(self) -> None:
        """Discard the output so far."""
        self.drain()
        self._tail = b""

    def text(self) -> str:
        """Return the end of the output."""
        return self._tail.decode(errors="replace")


def exit_words(status: int) -> str:
    """Describe how a process ended, such as ``was killed by SIGSEGV``.

    Args:
        status: Exit status; negative: the signal that killed it.
    """
    if status >= 0:
        return f"exited with status {status}"
    try:
        name = signal.Signals(-status).name
    except ValueError:
        name = f"signal {-status}"
    hint = " (by the system when memory runs out, or by hand)" if name == "SIGKILL" else ""
    return f"was killed by {name}{hint}"


def plain_environment() -> dict[str, str]:
    """Return the few environment variables that programs get from this process: paths, language, threads."""
    return {name: os.environ[name] for name in _INHERITED if name in os.environ}
