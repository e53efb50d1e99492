"""The SiMOOD criteria: what is counted, the unit of the test, the times, and whole campaigns on made-up outcomes."""

import csv
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks import simood_searches
from benchmarks.measurement import Row
from benchmarks.simood import harmful_genes_row, prediction_rows
from benchmarks.simood_places import CONFIRMATION_PLACES, NamedChain
from benchmarks.simood_searches import (
    PAPER,
    Contest,
    Search,
    Searches,
    Shares,
    evaluations_of,
    hazard_p_value,
    hazard_rows,
    random_pairs_row,
    share_words,
    unique_genes,
)
from benchmarks.trials import Record, Records
from brink.search.algorithms.simood import SimoodConfig, explained_of
from brink.search.slots import ChainGenome
from brink.server.problems.aeb_crossing import AebCrossingParams
from brink.sim.episode import EpisodeSpec
from brink.sim.perturbations import CATALOGUE

PARAMS = AebCrossingParams(techniques="brightness, contrast, smoke, dirty")
KINDS = ("default fitness", "paper's fitness", "random search with the default fitness")


def steps_of(spec: EpisodeSpec) -> list[tuple[str, float]]:
    """Return the genes of an episode that have an effect, with their intensities."""
    steps = spec.behaviour["perturbations"]
    assert isinstance(steps, list)
    found = [(str(one["gene"]), int(str(one["level"]))) for one in steps if isinstance(one, dict)]
    return [(gene, level / (CATALOGUE[gene].levels - 1)) for gene, level in found if level]


def outcome_of(spec: EpisodeSpec) -> Record:
    """Return an outcome where smoke is hazardous at once, and brightness is if contrast follows, however weak."""
    steps = steps_of(spec)
    names = [name for name, _ in steps]
    strengths = {"smoke": 0.7, "dirty": 0.3, "brightness": 0.2, "contrast": 0.1}
    alpha = 0.8 * min([1 - strengths[name] * level for name, level in steps], default=1.0)
    together = names == ["brightness", "contrast"]
    robustness = -1.0 if together or "smoke" in names else 1.0
    return Record(
        robustness={"no-collision@1": 1.0, "no-dangerous-stop@1": robustness} if spec.requirements else {},
        objectives={"alpha": alpha - 0.2 * together},
        features={},
        cpu_s=1.0,
        wall_s=1.0,
    )


class MadeUp(Records):
    """Records whose outcomes are computed by a function; it counts what it was asked for."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder / "records.jsonl", processes=1)
        self.asked: list[EpisodeSpec] = []

    def run(
        self, specs: Sequence[EpisodeSpec], on_progress: Callable[[int, int], None] | None = None
    ) -> list[Record]:
        self.asked += specs
        return [outcome_of(spec) for spec in specs]


def searches(folder: Path, repeats: int = 2, seeds: int = 2) -> Searches:
    return Searches(MadeUp(folder), folder, lambda *_: None, PARAMS, repeats=repeats, seeds=seeds)


def rows_of(file: Path) -> list[dict[str, str]]:
    with file.open(encoding="utf-8", newline="") as text:
        return list(csv.DictReader(text))


def by_name(rows: Sequence[Row]) -> dict[str, Row]:
    return {row.what: row for row in rows}


def test_unique_genes_are_techniques_at_a_level() -> None:
    chains = [(("snow", 1), ("rain", 2)), (("snow", 2), ("rain", 2)), (("rain", 2), ("snow", 0))]
    assert unique_genes(chains) == 3, "snow 1, snow 2 and rain 2, but only two techniques"


def test_the_unit_of_the_test_is_the_chain() -> None:
    assert hazard_p_value([1.0, 1.0, 0.8], [0.0, 2 / 3, 0.2]) == pytest.approx(1 / 20), "1 / (6 choose 3)"
    assert hazard_p_value([1.0], [0.0]) == pytest.approx(1 / 2), "whatever the number of streets"
    assert hazard_p_value([2 / 3], [2 / 3]) == 1.0


def test_share_of_explained_finalists_that_are_hazardous_by_interaction(tmp_path: Path) -> None:
    rows = by_name(searches(tmp_path).interactions())
    explained = rows_of(tmp_path / "explained.csv")
    for which in KINDS:
        mine = [row for row in explained if row["search"] == which]
        both = [row for row in mine if row["only_together"] == "True"]
        assert mine, "smoke is hazardous, with or without company"
        assert all("smoke" not in row["chain"] and row["parts"] == "0 of 5, 0 of 5, 0 of 5" for row in both)
        assert all("smoke" in row["chain"] for row in mine if row not in both)
        row = rows[f"A9 share of explained finalists hazardous only together or in one order, {which}"]
        assert row.value == pytest.approx(len(both) / len(mine))
        assert f"{share_words(len(both), len(mine))} explained" in row.note
        assert row.target == ("at least 0.333333" if which == "default fitness" else "")
        assert (
            rows[f"A9 share of hazardous ones that are so only together or in one order, {which}"].value > 0
        )
    found = [row for row in explained if row["search"] != KINDS[1] and row["only_together"] == "True"]
    assert found
    assert all(float(row["added_harm"]) >= 0.05 and row["other_order"] == "0 of 5" for row in found)


def test_campaigns_of_the_benchmark_explain_what_the_algorithm_explains(tmp_path: Path) -> None:
    found = searches(tmp_path)
    for campaign in found._campaigns("test", replace(SimoodConfig(), repeats=5, explained=3), range(2)):
        genome = ChainGenome.of(campaign.state.ledger.space)
        rows = explained_of(campaign.state)
        assert {one.chain for one in campaign.explained} == {genome.chain(row) for row in rows}
        assert len(rows) == 3
        assert all(len(one.parts) == 3 and one.tally.trials == 5 for one in campaign.explained)
        assert {spec.seed for spec in found._records.asked if spec.requirements} == set(CONFIRMATION_PLACES)  # type: ignore[attr-defined]


def test_searches_that_are_compared_stop_at_the_same_number_of_evaluations(tmp_path: Path) -> None:
    found = searches(tmp_path)
    for config in (PAPER, SimoodConfig(), replace(SimoodConfig(), propose="random")):
        (state,) = found._search("test", [Search(config=config, seed=1, evaluations=70)])
        assert 68 <= evaluations_of(state) <= 70


def test_hazards_are_compared_by_chain_and_by_search() -> None:
    a, b, c, d = ((("snow", level), ("rain", 1)) for level in (1, 2, 3, 4))
    finalists: Shares = [{a: 1.0, b: 0.8}, {a: 1.0, c: 0.6}, {b: 0.8, c: 0.6}]
    others: Shares = [{d: 0.0, c: 0.6}, {d: 0.0}, {c: 0.6}]
    fisher, shares = hazard_rows([Contest("finalists against random pairs", finalists, others)])
    assert fisher.value == pytest.approx(3 / 10), (
        "2 of 3 distinct chains, 0 of 2: (3 choose 2) / (5 choose 2)"
    )
    assert fisher.note.endswith("2 of 3 and 0 of 2")
    assert fisher.met is False
    assert shares.value == pytest.approx((1 + 1 / 2 + 1 / 2) / 3), "each search counts once"
    assert shares.met is False, "three searches are too few"
    clear = Contest("clear", [{a: 1.0, b: 0.6}] * 8, [{d: 0.0}] * 8)
    fisher, shares = hazard_rows([clear])
    assert shares.met is True
    corrected, also, *_ = hazard_rows([clear, clear])
    assert corrected.value == pytest.approx(min(1.0, 2 * fisher.value)), "Holm's correction for two tests"
    assert also.met is True


def test_random_pairs_count_once() -> None:
    a, b, c = ((("snow", level), ("rain", 1)) for level in (1, 2, 3))
    row = random_pairs_row([{a: 1.0, b: 0.6}, {a: 1.0, c: 0.8}])
    assert row.value == pytest.approx(2 / 3)
    assert row.met is False
    assert row.note.startswith("2 of 3 (")
    assert random_pairs_row([{a: 1.0, b: 0.6}]).met is True


def test_a_gene_is_harmful_if_its_first_level_is_unsafe_in_any_street() -> None:
    shares: dict[NamedChain, float] = {
        ((name, level),): 0.0 for name, gene in CATALOGUE.items() for level in range(1, gene.levels)
    }
    shares |= {(("snow", 1),): 1 / 3, (("smoke", 1),): 1.0, (("rain", 2),): 1.0}
    row = harmful_genes_row(shares)
    assert (row.value, row.target, row.met) == (2, "at most 3", True)
    assert {"snow", "smoke"} == set(row.note.rsplit(": ", 1)[1].split(", "))


def test_a_measure_predicts_hazards_if_unsafe_chains_measure_worse() -> None:
    shares: dict[NamedChain, float] = {
        (("snow", level),): unsafe for level, unsafe in enumerate((0, 0, 1, 1), 1)
    }
    measured = {
        chain: Record(
            robustness={},
            objectives={"alpha": alpha, "decision_accuracy": accuracy},
            features={},
            cpu_s=0,
            wall_s=0,
        )
        for chain, alpha, accuracy in zip(shares, (0.8, 0.5, 0.6, 0.3), (0.9, 0.9, 0.7, 0.6), strict=True)
    }
    by_alpha, by_decision = prediction_rows(shares, measured)
    assert (by_alpha.value, by_decision.value) == (0.75, 1.0)
    assert not prediction_rows(dict.fromkeys(shares, 0.0), measured), "nothing is unsafe"


def test_tables_have_the_spread_of_their_searches(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(simood_searches, "GENERATIONS", (10, 20))
    monkeypatch.setattr(simood_searches, "POPULATIONS", (20,))
    monkeypatch.setattr(simood_searches, "OMEGAS", (0.01, 0.99))
    rows = by_name(searches(tmp_path, repeats=3).tables())
    runs, cells = (rows_of(tmp_path / f"generations-population{end}.csv") for end in ("-runs", ""))
    assert len(runs) == 6
    assert [row["searches"] for row in cells] == ["3", "3"]
    for cell in cells:
        values = [int(run["unique_genes"]) for run in runs if run["generations"] == cell["generations"]]
        assert float(cell["unique_genes_mean"]) == pytest.approx(sum(values) / 3, abs=1e-4)
        assert (float(cell["unique_genes_min"]), float(cell["unique_genes_max"])) == (
            min(values),
            max(values),
        )
    assert all(int(run["simulated"]) == 20 for run in runs), "the whole last population"
    assert rows["A6 unique genes, 20 generations, population 20"].met is None
    assert (tmp_path / "omega.png").stat().st_size > 0
    assert rows["A6 hazards, 20 generations, population 20"].target == ""
    weak, strong = rows_of(tmp_path / "omega.csv")[::-1]
    assert float(weak["mean_intensity"]) < float(strong["mean_intensity"])
    assert all(1 <= float(row["unique_orders"]) <= 12 for row in (weak, strong)), "4 x 3 orders"
