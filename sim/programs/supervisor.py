"""Runs programs of users, one at a time, and ends all that they started, however far it forked away.

A script of its own, started by `brink.sim.programs.program` with a socket: requests in and replies out, each a
length (four bytes, big-endian) and JSON. It is the subreaper of the programs (`prctl(2)`), so whatever they start
stays among its descendants. All of it is killed when the program ends, when that is asked for, and when the process
that started this one has ended. If this process is killed, so is the program.

Standard library alone, so that it starts fast and stays small.
"""

import contextlib
import ctypes
import errno
import json
import os
import resource
import select
import signal
import socket
import struct
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, Final

_PR_SET_PDEATHSIG: Final = 1
_PR_SET_CHILD_SUBREAPER: Final = 36
_LENGTH: Final = struct.Struct(">I")
_MAX_DESCRIPTORS: Final = 2
_PARENT_CHECK_MS: Final = 1000
_REAP_PAUSE_S: Final = 0.0005
_prctl: Final = ctypes.CDLL(None).prctl


class _Supervised:
    """The program that runs now.

    Args:
        popen: Its process.
    """

    def __init__(self, popen: "subprocess.Popen[bytes]") -> None:
        self.pid = popen.pid
        popen.returncode = 0  # `reap` collects its status, not `subprocess`
        self._status: int | None = None
        self._cpu_s = 0.0

    def reap(self) -> bool:
        """Collect dead children, adopted ones too; return whether the program has ended."""
        with contextlib.suppress(ChildProcessError):
            while True:
                pid, status, usage = os.wait4(-1, os.WNOHANG)
                if pid == 0:
                    break
                if pid == self.pid:
                    self._status = os.waitstatus_to_exitcode(status)
                    self._cpu_s = usage.ru_utime + usage.ru_stime
        return self._status is not None

    def end(self) -> dict[str, Any]:
        """Kill the program and all of its descendants; return how the program ended."""
        was_killed = not self.reap()
        left: set[int] = set()
        # Descendants of those that are killed become children.
        while children := _children():
            left.update(children)
            for pid in children:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)
            time.sleep(_REAP_PAUSE_S)
            self.reap()
        return {
            "status": self._status,
            "cpu_s": self._cpu_s,
            "was_killed": was_killed,
            "left": len(left - {self.pid}),
        }


def main(control_fd: int, parent: int, limits: dict[str, int], setpriv: str) -> None:
    """Run programs until the socket, or the process that started this one, ends.

    Args:
        control_fd: The socket.
        parent: Process id of that process.
        limits: Resource limits by name, of this process and thus of its programs.
        setpriv: Path of util-linux's setpriv; empty if there is none.
    """
    os.set_inheritable(control_fd, False)
    control = socket.socket(fileno=control_fd)
    _prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
    _set_limits(limits)
    # A handler does not reach programs, whereas they would ignore signals that are ignored here.
    ignored = {n for n in signal.valid_signals() if signal.getsignal(n) is signal.SIG_IGN}
    for number in (ignored - {signal.SIGPIPE, signal.SIGXFSZ}) | {
        signal.SIGINT,
        signal.SIGTERM,
        signal.SIGHUP,
    }:
        signal.signal(number, lambda *_: None)
    signal.pthread_sigmask(signal.SIG_SETMASK, ())
    wakeup, woken = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
    signal.set_wakeup_fd(woken, warn_on_full_buffer=False)
    signal.signal(signal.SIGCHLD, lambda *_: None)
    poll = select.poll()
    poll.register(control, select.POLLIN)
    poll.register(wakeup, select.POLLIN)
    program: _Supervised | None = None
    try:
        # A fork of that process may keep the socket open.
        while os.getppid() == parent:
            ready = {fd for fd, _ in poll.poll(_PARENT_CHECK_MS)}
            if wakeup in ready:
                os.read(wakeup, 512)
            if program is not None and program.reap():
                _send(control, program.end())
                program = None
            if control_fd in ready:
                received = _receive(control)
                if received is None:
                    break
                request, descriptors = received
                if "command" in request:
                    program = _started(control, request, descriptors, setpriv)
                elif program is not None:  # otherwise it ended before it was to be killed
                    _send(control, program.end())
                    program = None
    finally:
        if program is not None:
            program.end()


def _started(
    control: socket.socket, request: dict[str, Any], descriptors: list[int], setpriv: str
) -> _Supervised | None:
    """Start a program and say so, or why not."""
    output, *channel = descriptors
    environment = request["environment"]
    if channel:
        environment = {**environment, request["channel_variable"]: str(channel[0])}

    # A function to call before the program starts means a fork of Python, which takes twice the time.
    prepare = None if setpriv else lambda: _prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    dies_with_this = [setpriv, "--pdeathsig", "KILL", "--"] if setpriv else []
    try:
        popen = subprocess.Popen(
            [*dies_with_this, _path_of(request), *request["command"][1:]],
            cwd=request["folder"],
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=output,
            pass_fds=channel,
            start_new_session=True,
            preexec_fn=prepare,
        )
    except OSError as error:
        _send(control, {"errno": error.errno, "strerror": error.strerror, "filename": str(error.filename)})
        return None
    finally:
        for descriptor in descriptors:
            os.close(descriptor)
    _send(control, {"pid": popen.pid})
    return _Supervised(popen)


def _path_of(request: dict[str, Any]) -> str:
    """Return the path of a program.

    Raises:
        OSError: There is no such program.
    """
    name = request["command"][0]
    folders = ("",) if "/" in name else request["environment"].get("PATH", os.defpath).split(":")
    paths = [os.path.join(request["folder"], folder, name) for folder in folders]
    for path in paths:
        if os.access(path, os.X_OK) and os.path.isfile(path):
            return path
    wrong = errno.EACCES if any(map(os.path.exists, paths)) else errno.ENOENT
    raise OSError(wrong, os.strerror(wrong), name)


def _set_limits(limits: dict[str, int]) -> None:
    for name, most in limits.items():
        kind = getattr(resource, name)
        _, hard = resource.getrlimit(kind)
        most = most if hard == resource.RLIM_INFINITY else min(most, hard)
        resource.setrlimit(kind, (most, most))


def _children() -> list[int]:
    text = Path(f"/proc/self/task/{os.getpid()}/children").read_text()
    return [int(pid) for pid in text.split()]


def _receive(control: socket.socket) -> tuple[dict[str, Any], list[int]] | None:
    """Return a request with its descriptors; None at the end."""
    head, descriptors, *_ = socket.recv_fds(control, _LENGTH.size, _MAX_DESCRIPTORS)
    if not head:
        return None
    (length,) = _LENGTH.unpack(head)
    body = bytearray()
    while len(body) < length:
        part = control.recv(length - len(body))
        if not part:
            return None
        body += part
    return json.loads(body), descriptors


def _send(control: socket.socket, reply: dict[str, Any]) -> None:
    body = json.dumps(reply).encode()
    with contextlib.suppress(BrokenPipeError):
        control.sendall(_LENGTH.pack(len(body)) + body)


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), json.loads(sys.argv[3]), sys.argv[4])
