"""OpenSCENARIO parameters and distributions as search spaces, and values written back."""

import json
import math
import re
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.stats
from support.logical_scenarios import (
    CASES,
    Case,
    N,
    V,
    declared,
    deterministic,
    likely,
    limits,
    single,
    steps,
    stochastic,
    together,
    value_set,
)
from support.standards import schema_errors

from brink.scenarios.exportable import NotExportable
from brink.scenarios.logical.campaign import Draft
from brink.scenarios.logical.declarations import declarations_of
from brink.scenarios.logical.distributions import Variation, distributions_of, scenario_of
from brink.scenarios.logical.document import Document, Element, parse_document, read_document
from brink.scenarios.logical.folder import Exported, write_solutions
from brink.scenarios.logical.laws import declared_law, share_inside, usual_range
from brink.scenarios.logical.space import LogicalScenario, MissingRanges, Wishes, logical_scenario
from brink.scenarios.logical.template import template_of, varied_parameters
from brink.scenarios.logical.value_sets import value_sets
from brink.server.campaigns.body import parse_body
from brink.server.documents import parse_yaml
from brink.server.errors import InvalidInput
from brink.server.problems.catalogue import make_problem
from brink.server.problems.command import Command
from brink.server.views import SolutionView

SCHEMA = "OpenSCENARIO_1_3_1.xsd"
OLDER = "OpenSCENARIO_1_1.xsd"
NOW = datetime(2026, 1, 1, tzinfo=UTC)
TEXT = Element(tag="", attributes={}, line=1, start=0)


def parsed(text: str, name: str = "scenario.xosc") -> Document:
    return parse_document(Path(name), text.encode())


def read(case: Case) -> LogicalScenario:
    distribution = None if case.distribution is None else parsed(case.distribution, "variation.xosc")
    return logical_scenario(parsed(case.scenario), distribution, Wishes(ranges=case.ranges))


@pytest.mark.parametrize("name", CASES)
def test_a_scenario_becomes_a_search_space_and_its_solutions_are_scenarios_again(
    name: str, tmp_path: Path
) -> None:
    case = CASES[name]
    logical = read(case)
    assert {axis.name: axis.declared for axis in logical.axes} == case.space
    assert logical.constraints == case.constraints
    assert {axis.name: axis.law for axis in logical.axes if axis.law} == case.laws
    assert logical.fixed == case.fixed
    draft = Draft(
        name=name,
        origin=name,
        command=["true"],
        files={"scenario.xosc": "template.xosc"},
        axes=logical.axes,
        constraints=logical.constraints,
        signals={"file": "log.csv"},
        requirements={"safe": {"signal": "x", "above": 0.0}},
        budget=10,
        notes=logical.notes,
    )
    params = dict(parse_body(parse_yaml(draft.text())).problem.params)
    assert params == draft.params()
    template = template_of(logical).content
    params["files"] = {"scenario.xosc": {"content": template.decode()}}
    problem = make_problem("command@1", params)
    assert isinstance(problem, Command)
    declared_before = declarations_of(parsed(case.scenario))
    rng = np.random.default_rng(1)
    sets = []
    for _ in range(3):
        values = problem.space.decode(tuple(one.sample(rng) for one in problem.space.components))["scenario"]
        ((_, content),) = problem.definition.files(problem.definition.texts(values) | {"seed": "1"})
        (tmp_path / "scenario.xosc").write_bytes(content)
        assert schema_errors(tmp_path / "scenario.xosc", SCHEMA) == []
        written = declarations_of(read_document(tmp_path / "scenario.xosc"))
        changed = varied_parameters(parsed(template.decode()))
        assert {one for one in written if written[one].value != declared_before[one].value} <= {
            *changed,
            *case.fixed,
        }
        assert b'name="{{ braces } ${name}"' in content
        sets.append({one: written[one].value for one in changed})
    (tmp_path / "sets.xosc").write_bytes(value_sets("scenario.xosc", sets, description=name, created_at=NOW))
    assert schema_errors(tmp_path / "sets.xosc", SCHEMA) == schema_errors(tmp_path / "sets.xosc", OLDER) == []
    again = distributions_of(read_document(tmp_path / "sets.xosc"), declared_before)
    assert list(again.sets[0].rows) == sets


def test_the_files_of_the_table_are_valid(tmp_path: Path) -> None:
    for case in CASES.values():
        for text in filter(None, [case.scenario, case.distribution]):
            (tmp_path / "file.xosc").write_text(text)
            assert schema_errors(tmp_path / "file.xosc", SCHEMA) == []


BOUNDED = declared("v", "double", "20", "greaterOrEqual 10; lessOrEqual 35")
BOMB = '<!DOCTYPE a [<!ENTITY b "c"><!ENTITY d "&b;&b;">]><OpenSCENARIO/>'
REFUSED: dict[str, tuple[str, str | None, str]] = {
    "entities": (BOMB, None, "line 1: DOCTYPE: expected no document type"),
    "broken": ("<OpenSCENARIO>", None, "line 1: XML: not well-formed"),
    "deep": ("<a>" * 300, None, "at most 200 levels"),
    "other": ("<OpenDRIVE/>", None, "expected the root OpenSCENARIO"),
    "no range": (V, None, "line 5: ParameterDeclaration v: no range: give --range v=LOW:HIGH, or --keep v"),
    "half a range": (declared("n", "int", "2", "greaterThan 0"), None, "only from 1: give --range n=1:HIGH"),
    "no number": (declared("n", "int", "2.5"), None, "expected a whole number of the type int, got '2.5'"),
    "no type": (declared("n", "float", "2.5"), None, "expected a parameterType of"),
    "twice": (V + V, None, "line 5 declares it as well"),
    "no value": (declared("v", "double", "9", "equalTo 3; greaterThan 4"), None, "no value in its range"),
    "a rule": (declared("v", "double", "9", "about 3"), None, "expected a rule of equalTo"),
    "a function": (
        declared("v", "double", "9", "greaterOrEqual ${sign($v)}; lessOrEqual 9; greaterOrEqual 0"),
        None,
        "ValueConstraint: expected numbers, parameters",
    ),
    "code": (
        declared("v", "double", "9", "greaterOrEqual ${__import__('os')}; lessOrEqual 9; greaterOrEqual 0"),
        None,
        "ValueConstraint: expected",
    ),
    "a circle": (
        declared("v", "double", "${$w}", "lessOrEqual 9")
        + declared("w", "double", "${$v}")
        + BOUNDED.replace("v", "x", 1),
        None,
        "depend on themselves",
    ),
    "unknown": (V, deterministic(value_set("w", "1")), "no ParameterDeclaration of that name"),
    "varied twice": (V, deterministic(value_set("v", "1"), together({"v": "3"})), "line 6 varies it as well"),
    "user-defined": (
        V,
        deterministic(single("v", '<UserDefinedDistribution type="sobol">x</UserDefinedDistribution>')),
        "UserDefinedDistribution of the type 'sobol' in line 6",
    ),
    "no range of a normal": (
        V,
        stochastic(likely("v", '<NormalDistribution expectedValue="20" variance="9"/>')),
        "NormalDistribution, line 6 has no Range: give --range v=8:32",
    ),
    "a variance": (
        V,
        stochastic(likely("v", '<NormalDistribution expectedValue="20" variance="0"/>')),
        "variance above 0",
    ),
    "a step": (
        V,
        deterministic(steps("v", 1, 5, 0)),
        "line 6: DistributionRange: expected a stepWidth above 0",
    ),
    "bins": (
        V,
        stochastic(
            likely(
                "v",
                f'<Histogram><Bin weight="1">{limits(0, 2)}</Bin><Bin weight="1">{limits(1, 3)}</Bin></Histogram>',
            )
        ),
        "bins that are not empty and do not overlap",
    ),
    "a text": (
        declared("s", "string", "a"),
        stochastic(likely("s", f"<UniformDistribution>{limits(0, 2)}</UniformDistribution>")),
        "s is a string",
    ),
    "nothing varies": (V, deterministic(value_set("v", "1")), "each has a single value"),
    "out of reach": (
        BOUNDED,
        deterministic(steps("v", 40, 50, 5)),
        "no value in its range meets its constraint in line 5",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_expressed_is_refused_by_element_and_line(name: str) -> None:
    scenario, distribution, words = REFUSED[name]
    if "ParameterDeclaration" in scenario:
        scenario = Case(declarations=(scenario,), space={}).scenario
    with pytest.raises(InvalidInput, match=re.escape(words)):
        logical_scenario(
            parsed(scenario), None if distribution is None else parsed(distribution, "variation.xosc")
        )


def test_missing_ranges_are_listed_together_or_kept() -> None:
    scenario = parsed(Case(declarations=(V, N, BOUNDED.replace('"v"', '"w"')), space={}).scenario)
    with pytest.raises(MissingRanges) as error:
        logical_scenario(scenario)
    assert [declaration.name for declaration, _ in error.value.missing] == ["v", "n"]
    for wishes in (Wishes(keep_others=True), Wishes(keep=frozenset({"v", "n"}))):
        assert [axis.name for axis in logical_scenario(scenario, None, wishes).axes] == ["w"]


def test_laws_are_declared_as_the_operational_distribution_of_a_campaign() -> None:
    def declared_of(name: str) -> Any:
        return {axis.name: declared_law(axis.law) for axis in read(CASES[name]).axes if axis.law}

    assert declared_of("normal") == {"v": {"normal": {"mean": 20.0, "deviation": 3.0}}}
    assert declared_of("uniform") == {"v": None}
    assert declared_of("probability-set") == {"car": {"weights": {"bus": 0.25, "van": 0.75}}}
    histogram = declared_of("poisson")["v"]["histogram"]
    assert histogram["edges"] == [0.5, 1.5, 2.5, 3.5, 4.5, 5.5, 6.5, 7.5, 8.5]
    assert histogram["weights"] == pytest.approx(scipy.stats.poisson(2.0).pmf(range(1, 9)))
    numbers = declared_of("log-normal")["v"]["lognormal"]
    value = scipy.stats.lognorm(numbers["sigma"], scale=numbers["median"])
    assert (value.mean(), value.std()) == pytest.approx((2.0, 1.0))


@pytest.mark.parametrize(
    ("kind", "numbers", "reference"),
    [
        ("normal", {"mean": 20.0, "sd": 3.0}, scipy.stats.norm(20.0, 3.0)),
        ("lognormal", {"mean": 2.0, "sd": 1.0}, None),
        ("poisson", {"mean": 3.5}, scipy.stats.poisson(3.5)),
    ],
)
def test_the_share_of_a_range_is_its_probability(
    kind: str, numbers: dict[str, float], reference: Any
) -> None:
    variation = Variation(kind=kind, element=TEXT, numbers=numbers)
    if reference is None:
        sigma = math.sqrt(math.log(1.25))
        reference = scipy.stats.lognorm(sigma, scale=2.0 / math.sqrt(1.25))
        assert reference.mean() == pytest.approx(2.0)
        assert reference.std() == pytest.approx(1.0)
    expected = reference.cdf(4.0) - reference.cdf(1.0) + (reference.pmf(1) if kind == "poisson" else 0.0)
    assert share_inside(variation, 1.0, 4.0) == pytest.approx(expected)
    assert 0.9999 < share_inside(variation, *usual_range(variation)) <= 1.0 + 1e-9


def solution(**given: Any) -> SolutionView:
    return SolutionView.model_construct(**given)


def test_solutions_are_written_with_their_verdicts_and_listed_together(tmp_path: Path) -> None:
    logical = read(CASES["value-sets"])
    draft = Draft(
        name="sets",
        origin="sets",
        command=["./sim", "{seed}", "{out}"],
        axes=logical.axes,
        signals={"file": "log.csv"},
        requirements={"safe": {"signal": "x", "above": 0.0}},
        budget=10,
    )
    template = {"scenario.xosc": {"content": template_of(logical).content.decode()}}
    params = draft.params() | {"files": template, "copies": {"a/b": {"base64": "YWI="}}}
    chosen = [{"values": "2", "gap": 7.5}, {"values": "1", "gap": 60.0}]
    exported = [
        Exported(
            solution=solution(
                number=number,
                verdict=verdict,
                words="",
                verdicts={},
                spec={"scenario": {"scenario": values}, "seed": 9},
            ),
            folder=verdict,
        )
        for number, (verdict, values) in enumerate(zip(("safe", "unsafe"), chosen, strict=True), start=4)
    ]
    files = write_solutions(params, exported, tmp_path, campaign="3f2a", name="sets", created_at=NOW)
    names = ("a/b", "scenario.xosc", "verdicts.json")
    expected = {f"{verdict}/{name}" for verdict in ("safe", "unsafe") for name in names} | {"value-sets.xosc"}
    assert {str(file.relative_to(tmp_path)) for file in files} == expected
    verdicts = json.loads((tmp_path / "unsafe" / "verdicts.json").read_text())
    assert (verdicts["solution"], verdicts["verdict"]) == (5, "unsafe")
    assert verdicts["command"] == ["./sim", "9", str(tmp_path / "unsafe")]
    document = read_document(tmp_path / "value-sets.xosc")
    assert schema_errors(document.path, SCHEMA) == []
    name, _ = scenario_of(document)
    base = declarations_of(read_document(tmp_path / name))
    (sets,) = distributions_of(document, base).sets
    assert list(sets.rows) == [
        {"v": "15.5", "car": "<bus>", "gap": "7.5"},
        {"v": "10", "car": "bus", "gap": "60.0"},
    ]
    assert {base[one].value for one in sets.rows[0]} == set(sets.rows[0].values())
    unsimulated = Exported(solution=solution(number=6, spec=None))
    with pytest.raises(NotExportable, match="solution 6 was not simulated"):
        write_solutions(params, [unsimulated], tmp_path / "new", campaign="3f2a", name="sets", created_at=NOW)
    assert not (tmp_path / "new").exists()
