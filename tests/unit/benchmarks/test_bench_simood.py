"""The SiMOOD criteria: what is counted, the unit of the test, the times, and whole campaigns on made-up outcomes."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks.measurement import Progress, silent
from benchmarks.simood_places import CONFIRMATION_PLACES
from benchmarks.simood_searches import (
    PAPER,
    Contest,
    Search,
    Searches,
    Shares,
    evaluations_of,
    hazard_p_value,
    hazard_rows,
    unique_genes,
)
from benchmarks.trials import Record, Records
from brink.search.algorithms.simood import SimoodConfig, explained_of
from brink.search.slots import ChainGenome
from brink.server.problems.aeb_crossing import AebCrossingParams
from brink.sim.episode import EpisodeSpec
from brink.sim.perturbations import CATALOGUE

PARAMS = AebCrossingParams(techniques="brightness, contrast, smoke, dirty")


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

    def run(self, specs: Sequence[EpisodeSpec], part: str = "", progress: Progress = silent) -> list[Record]:
        self.asked += specs
        return [outcome_of(spec) for spec in specs]


def searches(folder: Path, repeats: int = 2, seeds: int = 2) -> Searches:
    return Searches(MadeUp(folder), folder, lambda *_: None, PARAMS, repeats=repeats, seeds=seeds)


def test_unique_genes_are_techniques_at_a_level() -> None:
    chains = [(("snow", 1), ("rain", 2)), (("snow", 2), ("rain", 2)), (("rain", 2), ("snow", 0))]
    assert unique_genes(chains) == 3, "snow 1, snow 2 and rain 2, but only two techniques"


def test_the_unit_of_the_test_is_the_chain() -> None:
    assert hazard_p_value([1.0, 1.0, 0.8], [0.0, 2 / 3, 0.2]) == pytest.approx(1 / 20), "1 / (6 choose 3)"
    assert hazard_p_value([1.0], [0.0]) == pytest.approx(1 / 2), "whatever the number of streets"
    assert hazard_p_value([2 / 3], [2 / 3]) == 1.0


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
