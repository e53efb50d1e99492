"""The identity of a plug-in includes its source."""

import importlib
import sys
from collections.abc import Callable, Iterator
from importlib.metadata import Distribution
from pathlib import Path

import pytest

from brink.sim import catalogue
from brink.sim.catalogue import (
    GROUPS,
    PLUGINS_VARIABLE,
    REQUIREMENTS,
    named_sources,
    other_source,
    plugin_ids,
    plugin_source,
    with_sources,
)
from brink.sim.episode import EpisodeSpec
from brink.sim.sources import distribution_digest, module_digest, source_files
from brink.worker.child import SimulatorHost

PLUGIN = "toy_plugin"
TEXT = """
from brink.sim.catalogue import REQUIREMENTS, register
from brink.sim.requirements import FrontGap
from toy_margins import GAP_M
class Toy(FrontGap):
    def __init__(self): super().__init__(required_gap_m=GAP_M)
register(REQUIREMENTS, "toy@1", Toy)
"""
SPEC = EpisodeSpec(
    simulator="brink-drive@3", scenario={}, behaviour={}, requirements=("toy@1",), seed=1, duration_s=1.0
)


@pytest.fixture
def load(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., Path]]:
    """Writes files, and loads the plug-in as a new process would."""
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(catalogue, "_registered", {})
    monkeypatch.setattr(catalogue, "_registered_by", {})
    monkeypatch.setenv(PLUGINS_VARIABLE, PLUGIN)

    def forget() -> None:
        for name in (PLUGIN, "toy_margins"):
            sys.modules.pop(name, None)
        importlib.invalidate_caches()
        module_digest.cache_clear()
        catalogue.import_plugin_modules.cache_clear()

    def load(**files: str) -> Path:
        for name, text in files.items():
            (tmp_path / f"{name}.py").write_text(text)
        forget()
        assert "toy@1" in plugin_ids(REQUIREMENTS)
        return tmp_path

    yield load
    monkeypatch.undo()
    forget()


def test_an_edit_anywhere_in_a_plugin_changes_its_episodes(load: Callable[..., Path]) -> None:
    load(toy_plugin=TEXT, toy_margins="GAP_M = 3.0\n")
    first = with_sources(SPEC)
    assert list(first.sources) == ["requirements/toy@1"]
    load()
    assert with_sources(SPEC) == first
    load(toy_margins="GAP_M = 5.0\n")
    second = with_sources(SPEC)
    assert second.digest() != first.digest()
    load(toy_plugin=TEXT + "# edited\n")
    assert with_sources(SPEC).digest() not in (first.digest(), second.digest())


def test_a_source_is_the_one_that_was_imported(load: Callable[..., Path]) -> None:
    folder = load(toy_plugin=TEXT, toy_margins="GAP_M = 3.0\n")
    before = plugin_source(REQUIREMENTS, "toy@1")
    (folder / "toy_margins.py").write_text("GAP_M = 5.0\n")
    assert plugin_source(REQUIREMENTS, "toy@1") == before


def test_a_worker_with_other_code_is_told(load: Callable[..., Path]) -> None:
    load(toy_plugin=TEXT, toy_margins="GAP_M = 3.0\n")
    sources = with_sources(SPEC).sources
    assert other_source(sources) is None
    load(toy_margins="GAP_M = 5.0\n")
    why = other_source(sources)
    assert why is not None
    assert "plug-in toy@1 has source" in why
    assert sources["requirements/toy@1"][:8] in why
    assert "is not here" in str(other_source({"requirements/gone@1": "0" * 64}))
    assert "is not here" in str(other_source({"modules/gone": "0" * 64}))


def test_an_episode_for_other_code_does_not_run(load: Callable[..., Path]) -> None:
    load(toy_plugin=TEXT, toy_margins="GAP_M = 3.0\n")
    document = with_sources(SPEC).to_json()
    load(toy_margins="GAP_M = 5.0\n")
    outcome = SimulatorHost().run(document, record=False)
    assert (outcome["kind"], outcome["reason"]) == ("failed", "error"), (
        "retried, on another worker if there is one"
    )
    assert "start this worker again with the code that the coordinator has" in str(outcome["message"])


def test_a_function_of_a_module_counts_with_the_module(load: Callable[..., Path]) -> None:
    load(toy_plugin=TEXT, toy_margins="GAP_M = 3.0\n")
    assert set(named_sources({"options": {"policy": f"{PLUGIN}:drive"}})) == {f"modules/{PLUGIN}"}
    assert not named_sources({"options": {"policy": "other:drive", "detector": "brink-det@2"}})


def test_plugins_of_brink_have_no_source(load: Callable[..., Path]) -> None:
    load(toy_plugin=TEXT, toy_margins="GAP_M = 3.0\n")
    own = {(group, name) for group in GROUPS for name in plugin_ids(group)} - {(REQUIREMENTS, "toy@1")}
    assert len(own) > 40
    assert not [one for one in own if plugin_source(*one) is not None]
    spec = EpisodeSpec.from_json({**SPEC.to_json(), "requirements": ["front-gap@1"]})
    assert with_sources(spec) is spec
    assert "sources" not in spec.canonical_json()


def test_a_spec_with_sources_survives_json(load: Callable[..., Path]) -> None:
    load(toy_plugin=TEXT, toy_margins="GAP_M = 3.0\n")
    spec = with_sources(SPEC)
    assert EpisodeSpec.from_json(spec.to_json()) == spec


def test_a_package_counts_as_a_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(tmp_path))
    package = tmp_path / "toy_package" / "inner"
    package.mkdir(parents=True)
    for folder in (package, package.parent):
        (folder / "__init__.py").write_text("")
    (package / "core.py").write_text("import toy_beside\nimport json\n")
    (tmp_path / "toy_beside.py").write_text("")
    (tmp_path / "unrelated.py").write_text("")
    assert sorted(source_files("toy_package.inner.core")) == [
        "toy_beside.py",
        "toy_package/__init__.py",
        "toy_package/inner/__init__.py",
        "toy_package/inner/core.py",
    ]


def test_an_installed_distribution_counts_with_its_recorded_files(tmp_path: Path) -> None:
    info = tmp_path / "toy_dist-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: toy-dist\nVersion: 1.0\n")

    def digest(weights: str, script: str = "a") -> str:
        lines = [
            "toy_dist/__init__.py,sha256=x,1",
            f"toy_dist/weights.onnx,sha256={weights},1",
            "toy_dist/__pycache__/a.pyc,,",
            f"../../bin/toy,sha256={script},1",
            "toy_dist-1.0.dist-info/INSTALLER,sha256=z,1",
        ]
        (info / "RECORD").write_text("\n".join(lines))
        return distribution_digest(Distribution.at(info), "toy_dist.detector")

    assert digest("a") == digest("a", script="b")
    assert digest("a") != digest("b")


def test_sources_are_read_while_another_thread_builds_a_syntax_tree(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def mismatch(*_: object, **__: object) -> None:
        raise SystemError("AST constructor recursion depth mismatch (before=75, after=68)")

    (tmp_path / "helping_plugin.py").write_text("FACTOR = 2\n")
    (tmp_path / "asking_plugin.py").write_text(
        "def ask():\n    import helping_plugin\n    helping_plugin.FACTOR\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    with monkeypatch.context() as patched:
        patched.setattr("ast.parse", mismatch)
        found = set(source_files("asking_plugin"))
    assert found == {"asking_plugin.py", "helping_plugin.py"}
