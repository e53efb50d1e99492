"""Apps end with whoever made them."""

import gc
import weakref
from pathlib import Path

from brink.server.app import create_app
from brink.server.settings import Settings


def test_nothing_keeps_an_app_that_nobody_needs(tmp_path: Path) -> None:
    """The framework remembers the functions of thousands of routes; one that knows its app would keep it."""
    app = create_app(Settings(database=f"sqlite:///{tmp_path}/unused.db"))
    app.openapi()
    left = weakref.ref(app)
    del app
    gc.collect()
    assert left() is None
