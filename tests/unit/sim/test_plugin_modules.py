"""What is said of plug-in modules that cannot be imported: which, from where, and what to do."""

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from brink.sim.catalogue import PLUGINS_VARIABLE, import_plugin_modules, plugin_modules
from brink.sim.errors import PluginMissing


@pytest.fixture(autouse=True)
def plugin(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """A name of a module that is nowhere so far; the current folder is not on Python's path."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [entry for entry in sys.path if entry not in ("", str(tmp_path))])
    monkeypatch.setenv(PLUGINS_VARIABLE, "nowhere_plugin")
    import_plugin_modules.cache_clear()
    yield "nowhere_plugin"
    sys.modules.pop("nowhere_plugin", None)
    import_plugin_modules.cache_clear()


def refusal() -> str:
    with pytest.raises(PluginMissing) as caught:
        import_plugin_modules()
    return str(caught.value)


def test_a_module_that_is_nowhere_is_named_with_where_it_was_looked_for(plugin: str, tmp_path: Path) -> None:
    said = refusal()
    assert said.startswith(
        f"plug-in module {plugin!r}, which --plugin or {PLUGINS_VARIABLE} names, is neither"
    )
    assert sys.executable in said
    assert str(tmp_path) in said
    assert "--plugin, or correct the name" in said


def test_a_module_in_the_current_folder_needs_the_option(plugin: str, tmp_path: Path) -> None:
    (tmp_path / f"{plugin}.py").write_text("")
    assert f"not on Python's path, but in {tmp_path}: name it with --plugin" in refusal()


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("import nowhere_else", "No module named 'nowhere_else'; install 'nowhere_else' here"),
        ("1 / 0", "ZeroDivisionError: division by zero; correct the module"),
    ],
)
def test_a_module_that_fails_says_why(
    plugin: str, content: str, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / f"{plugin}.py").write_text(content)
    said = refusal()
    assert "fails when it is imported" in said
    assert words in said


def test_a_module_that_can_be_imported_is_no_error(
    plugin: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / f"{plugin}.py").write_text("")
    import_plugin_modules()
    assert plugin_modules() == [plugin]
