"""Tests of what depends on the SQL dialect run on SQLite and on Postgres, unless they say otherwise."""

from pathlib import Path

import pytest
from support.databases import BACKENDS, Databases, databases_for


@pytest.fixture(params=BACKENDS)
def databases(request: pytest.FixtureRequest, tmp_path: Path) -> Databases:
    """Databases of one backend."""
    return databases_for(request, tmp_path)
