"""The settings are described where operators look for them."""

from pathlib import Path

import pytest

from brink.server.settings import Settings

SETTINGS_PAGE = Path(__file__).parents[3] / "docs" / "reference" / "settings.md"


@pytest.mark.parametrize("name", Settings.model_fields)
def test_every_setting_is_described(name: str) -> None:
    assert f"`BRINK_{name.upper()}`" in SETTINGS_PAGE.read_text()
