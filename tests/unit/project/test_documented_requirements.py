"""What the documentation says of requirements: one list, which agrees with the registry, and ids that exist."""

import re
import tomllib
from pathlib import Path

import pytest

from brink.server.problems.catalogue import make_problem
from brink.server.problems.commonroad import NOT_RECORDED as COMMONROAD_LACKS
from brink.server.problems.highway import NOT_RECORDED as HIGHWAY_LACKS
from brink.server.problems.sumo import NOT_RECORDED as SUMO_LACKS
from brink.sim.formula_requirement import SIGNALS

ROOT = Path(__file__).resolve().parents[3]
GROUP = "brink.requirements"
SHIPPED = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["entry-points"][
    GROUP
]
PLUGINS = ROOT / "examples" / "plugins"
CHOOSING = ROOT / "docs" / "how-to" / "choose-what-counts-as-unsafe.md"
ANY = {
    "urban-injected@1": "requirement",
    "urban-errors@1": "requirement",
    "urban-camera@1": "requirement",
    "urban-fitted@1": "requirement",
    "commonroad@1": "requirement",
    "highway-perception@1": "requirement",
    "sumo-drivers@1": "requirement",
    "npc-actions@1": "violation",
    "aeb-crossing@1": "hazard",
}
"""The parameter of each problem that chooses requirements."""


def listed() -> dict[str, set[str]]:
    """Return the problems of each requirement in the list of the reference."""
    page = (ROOT / "docs" / "reference" / "problems.md").read_text(encoding="utf-8")
    section = page.partition("\n## Requirements\n")[2]
    rows = [line.split("|") for line in section.splitlines() if line.startswith("| `")]
    return {row[1].strip(" `"): set(re.findall(r"`([^`]+)`", row[4])) for row in rows}


def test_the_list_of_requirements_is_that_of_the_registry() -> None:
    assert set(listed()) == set(SHIPPED)


@pytest.mark.parametrize("problem", ANY)
def test_the_list_says_what_any_means(problem: str) -> None:
    made = make_problem(problem, {ANY[problem]: "any"})
    assert {name for name, problems in listed().items() if problem in problems} == set(made.requirements)


def test_the_list_names_no_other_problem() -> None:
    assert set().union(*listed().values()) == set(ANY)


def test_every_requirement_that_a_page_chooses_exists() -> None:
    known = {
        *SHIPPED,
        *re.findall(r'register\(REQUIREMENTS, "([^"]+)"', "".join(map(_text, PLUGINS.glob("*.py")))),
    }
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md"), *(ROOT / "examples").rglob("*.yaml")]
    chosen = re.findall(r"requirement: *\[?([a-z0-9@, -]+)", "".join(map(_text, pages)))
    ids = {one for some in chosen for one in re.findall(r"[a-z0-9-]+@\d+", some)}
    assert len(ids) >= 3
    assert ids <= known


def test_the_requirement_with_another_threshold_is_the_one_that_is_tested() -> None:
    block = re.search(r"```python\n(.*?)```", _text(CHOOSING), re.DOTALL)
    assert block is not None
    assert block[1].rstrip() in _text(PLUGINS / "wide_gap.py")
    campaign = re.search(r"```yaml\n# wide_gap\.yaml\n(.*?)```", _text(CHOOSING), re.DOTALL)
    assert campaign is not None
    assert campaign[1].rstrip() in _text(PLUGINS / "wide_gap.yaml")


def _text(file: Path) -> str:
    return file.read_text(encoding="utf-8")


def test_the_page_on_formulas_lists_every_signal_and_those_that_simulators_lack() -> None:
    page = (ROOT / "docs" / "reference" / "formulas.md").read_text(encoding="utf-8")
    table, lacking = page.partition("\n## Signals\n")[2].split("\nDistances count")
    lacking = lacking.partition("Signals of [`command@1`]")[0]
    rows = [line.split("|")[1] for line in table.splitlines() if line.startswith("| `")]
    assert re.findall(r"`(\w+)`", "".join(rows)) == sorted(SIGNALS, key=table.index)
    sumo, _, others = lacking.partition("highway-env")
    highway, _, recorded = others.partition("`commonroad@1`")
    assert [re.findall(r"`(\w+)`", part) for part in (sumo, highway, recorded)] == [
        list(SUMO_LACKS),
        list(HIGHWAY_LACKS),
        list(COMMONROAD_LACKS),
    ]
