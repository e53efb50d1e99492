"""A Redis of one's own, for measurements beside Celery: an installed server in a temporary folder."""

import shutil
import socket
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager

PROGRAMS = ("redis-server", "valkey-server")
DURABLE = {"appendonly": "yes", "appendfsync": "always"}
"""Every write reaches the disk before it is acknowledged."""
START_S = 15.0


class NoRedis(Exception):
    """No Redis can be had."""


def find_redis() -> str:
    """Return the path of an installed server.

    Raises:
        NoRedis: There is none.
    """
    found = next(filter(None, map(shutil.which, PROGRAMS)), None)
    if found is None:
        raise NoRedis(f"no Redis: expected one of {', '.join(PROGRAMS)} on PATH; install redis-server")
    return found


@contextmanager
def temporary_redis() -> Iterator[str]:
    """Give the URL of a durable server on a Unix socket that runs until the end of the block.

    Raises:
        NoRedis: None can be had.
    """
    program = find_redis()
    with tempfile.TemporaryDirectory(prefix="brink-redis-") as folder:
        path = f"{folder}/socket"
        settings = {**DURABLE, "port": "0", "unixsocket": path, "dir": folder, "save": ""}
        command = [program, *(part for name, value in settings.items() for part in (f"--{name}", value))]
        with open(f"{folder}/log", "wb") as log:
            server = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=log, stderr=log)
        try:
            _await_start(program, path, server)
            yield f"redis+socket://{path}"
        finally:
            server.kill()
            server.wait()


def _await_start(program: str, path: str, server: subprocess.Popen[bytes]) -> None:
    deadline = time.monotonic() + START_S
    while True:
        try:
            with socket.socket(socket.AF_UNIX) as client:
                client.connect(path)
                client.sendall(b"PING\r\n")
                if client.recv(64).startswith(b"+PONG"):
                    return
        except OSError as error:
            if server.poll() is not None or time.monotonic() > deadline:
                raise NoRedis(f"{program} did not come up: {error}") from error
        time.sleep(0.02)  # polls for the socket: a server tells nobody that it is up
