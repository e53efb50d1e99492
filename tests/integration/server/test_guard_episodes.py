"""A guard learns from the very episodes that a campaign simulated, seeds included. Verdicts are made up here."""

import json
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sqlalchemy import create_engine, text
from support.api import FakeWorker, coordinator, submit
from support.guards import REQUIREMENT, drive_with
from typer.testing import CliRunner, Result

from brink.cli.commands import app
from brink.guard import drives as guard_drives
from brink.guard.drives import Drive
from brink.search.analysis import guard_training
from brink.search.streams import episode_seed
from brink.server.errors import Conflict, InvalidInput
from brink.sim.episode import EpisodeSpec
from brink.worker.wire import Completed, LeasedJob, WireVerdict

pytestmark = pytest.mark.long("runs campaigns; guards have unit tests")

BUDGET = 200
EDGE: dict[str, Any] = {
    "name": "edge",
    "problem": {"id": "urban-injected@1", "params": {"requirement": [REQUIREMENT]}},
    "algorithm": {"id": "edge@1", "params": {"radius": 0.3, "p_th": 0.1, "eps": 0.05, "d_th": 0.2}},
    "budget": {"simulations": BUDGET},
    "seed": 1,
}


def robustness(spec: EpisodeSpec) -> float:
    """Return a robustness that depends on where boxes are, and on chance."""
    trajectories: Any = spec.behaviour["trajectories"]
    left_px = sum(float(one["x_min_0_px"]) for one in trajectories if one is not None)
    return float(0.4 - left_px / 1000 + 0.3 * np.random.default_rng(spec.seed).normal())


def simulate(job: LeasedJob) -> Completed:
    spec = EpisodeSpec.from_json(job.spec)
    value = robustness(spec)
    verdicts = {
        name: WireVerdict(
            robustness=value if name == REQUIREMENT else 1.0,
            unit="m",
            violated_at_s=3.0 if value < 0 and name == REQUIREMENT else None,
        )
        for name in spec.requirements
    }
    return Completed(verdicts=verdicts, objectives={}, features={"way_m": 1.0, "ended_at_s": 6.0})


def record_one(spec: EpisodeSpec) -> Drive:
    unsafe = robustness(spec) < 0
    values = [8.0 if unsafe and step > 15 else 2.0 + step % 3 for step in range(60)]
    return drive_with(values, violated_at_s=3.0 if unsafe else None, spec=spec)


@dataclass(frozen=True, slots=True, kw_only=True)
class Searched:
    database: str
    file: Path
    campaign: str
    repeated: str


@pytest.fixture(scope="module")
def searched(sqlite_file: Path, tmp_path_factory: pytest.TempPathFactory) -> Searched:
    file = shutil.copyfile(sqlite_file, tmp_path_factory.mktemp("searched") / "edge.db")
    with coordinator(f"sqlite:///{file}") as client:
        campaign = submit(client, EDGE)
        worker = FakeWorker(client, capabilities=("brink-drive@3",), judge=simulate)
        assert worker.work(campaign)["status"] == "finished"
        repeated = submit(client, {**EDGE, "name": "the same again"})
        assert worker.work(repeated)["status"] == "finished"
    return Searched(database=f"sqlite:///{file}", file=Path(file), campaign=campaign, repeated=repeated)


@pytest.fixture(autouse=True)
def made_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(guard_drives, "record_one", record_one)
    monkeypatch.setattr(guard_training, "TREES", 3)
    monkeypatch.setattr(guard_training, "LEAST_STEPS_OF_A_LEAF", 10)


def brink(*arguments: object) -> Result:
    return CliRunner().invoke(app, ["guard", *map(str, arguments), "--processes", "1"])


def execute(database: str, statement: str) -> list[Any]:
    engine = create_engine(database)
    with engine.begin() as connection:
        found = connection.execute(text(statement))
        rows = list(found) if found.returns_rows else []
    engine.dispose()
    return rows


def test_a_guard_is_fitted_to_a_campaign_of_edge_whose_partners_share_a_seed(
    searched: Searched, tmp_path: Path
) -> None:
    seeds = execute(
        searched.database, f"SELECT number, seed FROM solutions WHERE campaign_id = '{searched.campaign}'"
    )
    assert any(seed != episode_seed(1, number) for number, seed in seeds), (
        "partners share the seed of a solution"
    )

    result = brink(
        "fit", searched.campaign, "--database", searched.database, "--out", tmp_path / "guard.json", "--json"
    )

    assert result.exit_code == 0, (result.output, result.exception)
    assert json.loads(result.stdout)["drives"] == len(seeds)


def test_episodes_that_differ_from_those_that_were_simulated_are_named(
    searched: Searched, tmp_path: Path
) -> None:
    altered = shutil.copyfile(searched.file, tmp_path / "altered.db")
    execute(f"sqlite:///{altered}", "UPDATE solutions SET seed = seed + 1 WHERE number IN (3, 17)")

    result = brink(
        "fit", searched.campaign, "--database", f"sqlite:///{altered}", "--out", tmp_path / "g.json"
    )

    assert isinstance(result.exception, Conflict)
    assert f"2 of {BUDGET} episodes of campaign {searched.campaign}" in str(result.exception)
    assert "solutions 3, 17" in str(result.exception)


def test_a_guard_is_not_judged_on_a_campaign_that_repeats_the_one_it_was_fitted_to(
    searched: Searched, tmp_path: Path
) -> None:
    file, place = tmp_path / "guard.json", ("--database", searched.database)
    assert brink("fit", searched.campaign, "--out", file, *place).exit_code == 0

    result = brink("judge", file, searched.repeated, *place)

    assert isinstance(result.exception, Conflict)
    expected = f"was fitted to {BUDGET} of the {BUDGET} solutions of campaign {searched.repeated}"
    assert expected in str(result.exception)


def test_a_drive_that_two_campaigns_share_counts_once(searched: Searched, tmp_path: Path) -> None:
    result = brink(
        "fit",
        searched.campaign,
        searched.repeated,
        "--database",
        searched.database,
        "--out",
        tmp_path / "g.json",
        "--json",
    )
    assert result.exit_code == 0, (result.output, result.exception)
    assert json.loads(result.stdout)["drives"] == BUDGET


def test_what_cannot_be_fitted_is_refused_before_any_drive_runs(
    searched: Searched, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(guard_drives, "record_one", lambda _: pytest.fail("a drive ran"))
    place = ("--database", searched.database)

    other = brink(
        "fit", searched.campaign, "--requirement", "front-gap@2", "--out", tmp_path / "guard.json", *place
    )
    assert isinstance(other.exception, Conflict)
    assert "front-gap@2 was not evaluated in these drives, only front-gap@1" in str(other.exception)

    folder = brink("fit", searched.campaign, "--out", tmp_path, *place)
    assert isinstance(folder.exception, InvalidInput)
    assert "is a folder" in str(folder.exception.errors[0])
