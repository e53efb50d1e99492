"""The page at `/`: served to whoever comes, from this coordinator alone; what it may show is the token's affair."""

import re
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from support.api import coordinator, expect

from brink.server.access.tokens import create_token
from brink.server.dashboard.page import STATIC
from brink.server.db.engine import Engines
from brink.server.states import Scope

SECRET = "correct-horse"
IMPORTS = re.compile(r"""(?:from|import\()\s*["'](\.[^"']+)["']""")


@pytest.fixture
def guarded(database_url: str) -> Iterator[httpx.Client]:
    with coordinator(database_url, token=SECRET) as client:
        yield client


def test_the_page_and_all_that_it_names_need_neither_token_nor_internet(guarded: httpx.Client) -> None:
    with httpx.Client(base_url=guarded.base_url) as stranger:
        page = stranger.get("/")
        assert page.status_code == 200
        assert "default-src 'self'" in page.headers["content-security-policy"]
        named = re.findall(r'(?:src|href)="([^"#]+)"', page.text)
        assert len(named) >= 10
        for file in named:
            assert file.startswith("dashboard/"), "nothing from elsewhere"
            answer = stranger.get(f"/{file}")
            assert answer.status_code == 200, file
            assert answer.headers["cache-control"] == "no-cache"
            again = stranger.get(f"/{file}", headers={"If-None-Match": answer.headers["etag"]})
            assert again.status_code == 304


def test_every_module_that_is_imported_is_there() -> None:
    modules = sorted((STATIC / "js").rglob("*.js"))
    assert len(modules) >= 10
    for module in modules:
        for named in IMPORTS.findall(module.read_text()):
            assert (module.parent / named).resolve().is_file(), f"{module.relative_to(STATIC)}: {named}"


def test_files_beside_the_pages_are_not_served(guarded: httpx.Client) -> None:
    with httpx.Client(base_url=guarded.base_url) as stranger:
        for path in ("/dashboard/../page.py", "/dashboard/%2e%2e/page.py", "/dashboard/js", "/dashboard"):
            assert stranger.get(path).status_code in (401, 404), path


@pytest.mark.parametrize(("scope", "status"), [("read", 200), ("user", 200), ("admin", 200), ("worker", 403)])
def test_a_token_learns_what_it_may_do(
    guarded: httpx.Client, engines: Engines, scope: str, status: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("brink.server.access.authentication.TOKEN_CACHE_S", 0.0)
    with engines.writer.begin() as connection:
        token = create_token(connection, Scope(scope), "somebody")
    told = expect(guarded.get("/api/v1/access", headers={"Authorization": f"Bearer {token}"}), status)
    if status == 200:
        assert told == {"tokens": True, "scope": scope}


def test_where_no_token_is_asked_for_everybody_may_do_everything(client: httpx.Client) -> None:
    assert expect(client.get("/api/v1/access")) == {"tokens": False, "scope": "admin"}


def test_what_is_vendored_is_named_with_its_licence() -> None:
    table = (STATIC / "vendor" / "README.md").read_text()
    for folder in sorted(path for path in (STATIC / "vendor").iterdir() if path.is_dir()):
        assert f"| {folder.name} |" in table
        assert (Path(folder) / "LICENSE").is_file()
