"""The app and its settings."""

import gc
import weakref
from pathlib import Path

import pytest

from brink.server.app import create_app
from brink.server.errors import InvalidInput
from brink.server.settings import Settings

SETTINGS_PAGE = Path(__file__).parents[3] / "docs" / "reference" / "settings.md"


def test_an_app_is_garbage_collected(tmp_path: Path) -> None:
    """The framework caches the functions of routes; a function that refers to its app would keep the app alive."""
    app = create_app(Settings(database=f"sqlite:///{tmp_path}/unused.db"))
    app.openapi()
    left = weakref.ref(app)
    del app
    gc.collect()
    assert left() is None


@pytest.mark.parametrize("name", Settings.model_fields)
def test_every_setting_is_documented(name: str) -> None:
    assert f"`BRINK_{name.upper()}`" in SETTINGS_PAGE.read_text()


def test_a_malformed_list_of_language_models_is_refused_at_once(tmp_path: Path) -> None:
    settings = Settings(database=f"sqlite:///{tmp_path}/new.db", llm_endpoints="api.example.com")
    with pytest.raises(InvalidInput, match=r"^BRINK_LLM_ENDPOINTS: expected base URLs"):
        create_app(settings)
