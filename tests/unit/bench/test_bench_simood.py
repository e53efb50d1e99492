"""The SiMOOD criteria: what is counted, the unit of the test, the times, and whole campaigns on made-up outcomes."""

import csv
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import pytest
from typer.testing import CliRunner

from brink.bench import simood_searches
from brink.bench.measurement import Row
from brink.bench.simood import measure_simood
from brink.bench.simood_costs import Times, time_rows
from brink.bench.simood_searches import PAPER, Searches, hazard_p_value, spread_of, unique_genes
from brink.bench.trials import Record, Records
from brink.cli.commands import app
from brink.search.algorithms.simood import SimoodConfig
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
        objectives={"alpha": alpha - 0.2 * together}, features={}, cpu_s=1.0, wall_s=1.0,
    )  # fmt: skip


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


def searches(folder: Path, repeats: int = 2) -> Searches:
    return Searches(MadeUp(folder), folder, lambda *_: None, PARAMS, repeats=repeats)


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


def test_spread_of_repeated_searches() -> None:
    assert spread_of([3.0, 5.0, 7.0]) == (5.0, 2.0, 3.0, 7.0)
    assert spread_of([4.0]) == (4.0, 0.0, 4.0, 4.0)


def test_ratios_with_the_papers_times_say_what_they_include() -> None:
    times = Times(making_s=0.0, evaluation_s=12.0, episode_s=120.0)
    rows = by_name(time_rows(60, times, measured=110, episodes=75))
    ratios = {name.removeprefix("A7 ").split(",")[0]: row.value for name, row in rows.items()}
    assert ratios == {
        "search alone": pytest.approx(10.0),
        "whole last population of 120 simulated": pytest.approx(160 * 120 / (160 * 12 + 120 * 120)),
        "whole last population of 20 simulated": pytest.approx(7_200 / 3_120),
        "all 5 finalists in 3 streets": pytest.approx(7_200 / (720 + 15 * 120)),
        "best 2 in one street": pytest.approx(7_200 / 960),
        "default campaign with its explanation": pytest.approx((110 * 12 + 75 * 120) / 7_200),
    }
    assert [row.target for row in rows.values()].count("at least 10") == 2


def test_share_of_explained_finalists_that_are_hazardous_by_interaction(tmp_path: Path) -> None:
    rows = by_name(searches(tmp_path).interactions())
    explained = rows_of(tmp_path / "explained.csv")
    for which, interaction in (("default", "fitness"), ("paper's fitness", "none")):
        mine = [row for row in explained if row["interaction"] == interaction]
        both = [row for row in mine if row["only_together"] == "True"]
        assert mine, "smoke is hazardous, with or without company"
        assert all("smoke" not in row["chain"] and row["parts"] == "0 of 3, 0 of 3, 0 of 3" for row in both)
        assert all("smoke" in row["chain"] for row in mine if row not in both)
        row = rows[f"A9 share hazardous only together or in one order, {which}"]
        assert row.value == pytest.approx(len(both) / len(mine))
        assert f"{len(both)} of {len(mine)} explained" in row.note
    found = [row for row in explained if row["interaction"] == "fitness" and row["only_together"] == "True"]
    assert found
    assert all(float(row["added_harm"]) >= 0.05 and row["other_order"] == "0 of 3" for row in found)
    assert rows["A9 share hazardous only together or in one order, paper's fitness"].met is None


def test_a_default_campaign_counts_all_its_evaluations_and_episodes(tmp_path: Path) -> None:
    found = searches(tmp_path)
    campaign = found.default_campaign()
    asked = found._records.asked  # type: ignore[attr-defined]
    assert campaign.measured == len({spec.digest() for spec in asked if not spec.requirements})
    assert campaign.episodes == len({spec.digest() for spec in asked if spec.requirements})
    assert len(campaign.finalists) == 5


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


def test_searches_with_the_papers_fitness_measure_no_parts(tmp_path: Path) -> None:
    found = searches(tmp_path)
    for config, parts in ((PAPER, False), (SimoodConfig(), True)):
        (campaign,) = found._campaigns("test", replace(config, generations=1), range(1))
        assert bool(len(campaign.state.parts)) is parts


def test_an_unknown_detector_is_refused(tmp_path: Path) -> None:
    command = ["bench", "simood", "A1", "--out", str(tmp_path), "--detector", "brnk-det@1"]
    refused = CliRunner().invoke(app, command)
    assert refused.exit_code != 0
    assert "expected one of brink-det@1" in str(refused.exception)


def test_tables_of_a_detector_are_in_a_folder_of_its_name(tmp_path: Path) -> None:
    measure_simood(["A1"], tmp_path, processes=1, progress=lambda *_: None, detector="brink-det@1")
    assert (tmp_path / "brink-det@1").is_dir()
