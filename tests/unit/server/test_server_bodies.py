"""The bodies of campaigns and experiments."""

from pathlib import Path
from typing import Any

import pytest
import yaml

from brink.server.campaigns.body import parse_body, read_campaign_file
from brink.server.campaigns.plan import make_checked_plan
from brink.server.errors import InvalidInput
from brink.server.experiments.body import MAX_CAMPAIGNS, parse_experiment, read_experiment_file
from brink.server.experiments.checks import check_follow_ups

EXAMPLES = Path(__file__).parents[3] / "examples"


PLAIN: dict[str, Any] = {
    "name": "night-rain",
    "problem": {"id": "mtq@1"},
    "algorithm": {"id": "random@1"},
    "budget": {"simulations": 100},
}


def test_newer_fields_change_the_hash_only_if_they_are_set() -> None:
    first = "d0fa27c9315a72b53172e656131079cb4ecccc805459d11ce25db46699fdf7ad"
    assert parse_body(PLAIN).document_hash() == first
    assert parse_body({**PLAIN, "repeats": 0}).document_hash() == first
    assert parse_body({**PLAIN, "repeats": 5}).document_hash() != first
    assert parse_body({**PLAIN, "execution": {"max_losses": 10}}).document_hash() == first
    assert parse_body({**PLAIN, "execution": {"max_losses": 9}}).document_hash() != first


def test_a_newer_setting_of_a_language_model_changes_the_hash_only_if_it_is_set() -> None:
    seeded = {
        "name": "n",
        "problem": {"id": "npc-actions@1", "params": {}},
        "budget": {"simulations": 24},
        "algorithm": {"id": "mumoea@1", "params": {"seeder": "llm"}},
    }
    llm = {"endpoint": "http://127.0.0.1:8000/v1", "model": "m"}
    first = "a89e8b6a69b9fe695c8b8d13e11eaf973600c149cbd8ad715a9ae31ec7799ff7"
    assert parse_body({**seeded, "llm": llm}).document_hash() == first
    assert parse_body({**seeded, "llm": {**llm, "max_delay_s": 30}}).document_hash() != first


def document(**changes: Any) -> dict[str, Any]:
    return {
        "name": "rq1",
        "problems": [{"id": "mtq@1"}],
        "algorithms": [{"name": "GA", "id": "ga@1"}, {"id": "random@1", "params": {"radius": 0.1}}],
        "seeds": [4, 7],
        "budget": {"simulations": 100},
        **changes,
    }


def pointers(document: object) -> dict[str, str]:
    with pytest.raises(InvalidInput) as raised:
        parse_experiment(document)
    return {error.pointer: error.message for error in raised.value.errors}


def test_an_experiment_has_one_campaign_per_combination() -> None:
    two = [{"id": "mtq@1"}, {"name": "bits", "id": "onemax@1"}]
    cells = parse_experiment(document(problems=two, priority=3)).cells()
    assert [(cell.body.seed, cell.problem, cell.method) for cell in cells] == [
        (seed, problem, method)
        for seed in (4, 7)
        for problem in ("mtq@1", "bits")
        for method in ("GA", "random@1")
    ]
    assert [cell.place for cell in cells] == list(range(8))
    assert cells[5].body.name == "rq1: random@1, mtq@1, seed 7"
    assert cells[5].body.algorithm.params == {"radius": 0.1}
    assert {cell.body.priority for cell in cells} == {3}
    assert len({cell.body.document_hash() for cell in cells}) == 8


def test_seeds_may_be_a_range() -> None:
    ranged = parse_experiment(document(seeds={"first": 4, "count": 2}))
    assert ranged.seeds == [4, 5]
    assert ranged.document_hash() == parse_experiment(document(seeds=[4, 5])).document_hash()
    assert parse_experiment(document(seeds={"count": 3})).seeds == [1, 2, 3]


@pytest.mark.parametrize(
    ("changes", "pointer", "message"),
    [
        ({"seeds": []}, "/seeds", "at least 1"),
        ({"seeds": {"frist": 1}}, "/seeds", "first (0 or more) and count"),
        ({"seeds": {"count": MAX_CAMPAIGNS + 1}}, "/seeds", f"count (1 to {MAX_CAMPAIGNS})"),
        ({"seeds": [1, -1]}, "/seeds/1", "greater than or equal to 0"),
        ({"seeds": [1, 1]}, "", "'1' more than once"),
        ({"algorithms": []}, "/algorithms", "at least 1"),
        (
            {"algorithms": [{"id": "ga@1"}, {"id": "ga@1"}]},
            "",
            "'ga@1' more than once; give each a different name",
        ),
        (
            {"algorithms": [{"id": "ga@1", "parms": {}}]},
            "/algorithms/0/parms",
            "one of id, llm, name, params",
        ),
        ({"seeds": {"count": 300}}, "", f"at most {MAX_CAMPAIGNS} campaigns, got 600"),
        ({"budget": {"simulations": 0}}, "/budget/simulations", "greater than or equal to 1"),
        ({"pairs": {"eps": 2}}, "/pairs/eps", "less than or equal to 1"),
        ({"pairs": {"confirm": -1}}, "/pairs/confirm", "greater than or equal to 0"),
        ({"pairs": {"minimise": True}}, "/pairs/minimise", "one of component, confirm, d_th, eps"),
        ({"thresholds": {"eps": 0.1}}, "/thresholds/eps", "one of component, confirm, d_th"),
    ],
)
def test_each_invalid_field_has_a_pointer(changes: dict[str, Any], pointer: str, message: str) -> None:
    found = pointers(document(**changes))
    assert pointer in found
    assert message in found[pointer]


@pytest.mark.parametrize(
    ("section", "defaults"),
    [
        ("pairs", {"confirm": 0, "component": False, "eps": 0.02, "d_th": 0.2}),
        ("thresholds", {"confirm": 0, "component": False, "d_th": 0.2}),
    ],
)
def test_experiments_without_optional_sections_are_stored_as_they_always_were(
    section: str, defaults: dict[str, Any]
) -> None:
    plain = parse_experiment(document())
    assert plain.document_hash() == "d1a1a45abcb12d7bc05dd534343c17a1a472549144d802da2fab39aa3a962c1f"
    assert section not in plain.document()
    asked = parse_experiment(document(**{section: {}}))
    assert asked.document()[section] == defaults
    assert asked.document_hash() != plain.document_hash()
    assert parse_experiment(asked.document()) == asked
    assert [cell.body.document_hash() for cell in asked.cells()] == [
        cell.body.document_hash() for cell in plain.cells()
    ]


@pytest.mark.parametrize("section", ["pairs", "thresholds"])
@pytest.mark.parametrize(
    ("problem", "wanted", "message"),
    [
        ("urban-injected@1", {"confirm": 4}, "expected 0, or at least 15"),
        ("mtq@1", {"confirm": 30}, "computed, not simulated"),
        ("mtq@1", {"component": True}, "no component that ground truth can replace"),
    ],
)
def test_follow_ups_that_tell_nothing_are_refused(
    section: str, problem: str, wanted: dict[str, Any], message: str
) -> None:
    check_follow_ups(parse_experiment(document(problems=[{"id": problem}], **{section: {}})))
    with pytest.raises(InvalidInput) as raised:
        check_follow_ups(parse_experiment(document(problems=[{"id": problem}], **{section: wanted})))
    [error] = raised.value.errors
    assert error.pointer == f"/{section}/{next(iter(wanted))}"
    assert message in error.message


def test_follow_ups_leave_out_problems_with_computed_verdicts() -> None:
    problems = [{"id": "urban-injected@1"}, {"name": "two", "id": "mtq@1"}]
    wanted = {"confirm": 30, "component": True}
    check_follow_ups(parse_experiment(document(problems=problems, pairs=wanted, thresholds=wanted)))


def test_a_list_is_rejected_as_an_experiment() -> None:
    assert "expected an experiment with name, problems" in pointers([1])[""]


def test_the_examples_can_be_read() -> None:
    body = read_experiment_file(EXAMPLES / "paper-rq1.yaml")
    assert (body.campaigns, body.budget.simulations) == (30, 1300)
    edge = read_experiment_file(EXAMPLES / "edge-experiment.yaml")
    assert (edge.campaigns, edge.budget.simulations, edge.problems) == (40, 1300, body.problems)
    assert edge.algorithms[1:] == body.algorithms
    check_follow_ups(edge)


def test_an_experiment_takes_along_the_files_of_its_problems(tmp_path: Path) -> None:
    campaign = yaml.safe_load((EXAMPLES / "command" / "cut-in.yaml").read_text())
    problems = [{"name": "bits", "id": "onemax@1"}, {**campaign["problem"], "name": "cut-in"}]
    file = tmp_path / "study.yaml"
    file.write_text(yaml.safe_dump(document(problems=problems)))
    with pytest.raises(InvalidInput, match=r"settings\.json cannot be read") as raised:
        read_experiment_file(file)
    assert [error.pointer for error in raised.value.errors] == ["/problems/1/params/files"]

    for name in ("cut_in.py", "settings.json"):
        (tmp_path / name).write_bytes((EXAMPLES / "command" / name).read_bytes())
    body = read_experiment_file(file).sized(seeds=1, simulations=10)
    assert [problem.label for problem in body.problems] == ["bits", "cut-in"]
    alone = read_campaign_file(EXAMPLES / "command" / "cut-in.yaml")
    assert body.cells()[2].body.problem.params == alone.problem.params


def test_the_example_of_all_searches_can_run() -> None:
    body = read_experiment_file(EXAMPLES / "thresholds-experiment.yaml")
    assert (body.campaigns, body.budget.simulations) == (4 * 9 * 10, 1300)
    check_follow_ups(body)
    for cell in body.cells()[: 4 * 9]:
        assert make_checked_plan(cell.body).body.budget.simulations == 1300
