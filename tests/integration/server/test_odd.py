"""An ODD all the way: what is simulated, what a warm start takes over, and limits that a command adds."""

import io
import json
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from support.api import FakeWorker, coordinator, expect, progress, submit
from support.drives import simulate
from typer.testing import CliRunner

from brink.cli.commands import app
from brink.search import surrogate
from brink.server.campaigns.body import parse_body
from brink.server.campaigns.plan import make_plan
from brink.server.problems.catalogue import make_problem
from brink.server.problems.urban_injected import SIMULATOR

pytestmark = pytest.mark.long("simulates drives; domains have unit tests")

API = "/api/v1/campaigns"
ODD: dict[str, Any] = {
    "scenario.weather": ["clear", "hard_rain"],
    "scenario.driving_task": "follow_road",
    "behaviour.trajectory_*.label": ["null", "vehicle"],
    "behaviour.trajectory_*.t0_step": {"max": 20},
    "behaviour.trajectory_*.x_min_0_px": {"min": 200, "max": 500},
}
PROBLEM = {
    "id": "urban-injected@1",
    "params": {"requirement": "front-gap@1", "duration_s": 6.0, "trajectories": 3, "odd": ODD},
}
SEARCH: dict[str, Any] = {
    "name": "within",
    "problem": PROBLEM,
    "seed": 5,
    "budget": {"simulations": 70},
    "algorithm": {"id": "edge@1", "params": {"d_th": 0.02, "eps": 0.05}},
}


def drive(client: httpx.Client, body: dict[str, Any]) -> str:
    """Run a campaign of real drives to its end; return its id."""
    campaign = submit(client, body)
    assert (
        FakeWorker(client, capabilities=(SIMULATOR,), judge=simulate).work(campaign)["status"] == "finished"
    )
    return campaign


def rows_of(client: httpx.Client, campaign: str) -> Any:
    answer = client.get(f"{API}/{campaign}/archive.npz")
    assert answer.status_code == 200, answer.text
    return np.load(io.BytesIO(answer.content))["vectors"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Searched:
    """A search within an ODD that has ended, and a random one without an ODD.

    Attributes:
        database: Where they are stored.
        campaign: Id of the search.
        digest: Digest of its archive.
        pairs: Its pairs, from the API.
        finding: Its finding, from the API.
        random: Id of the random search.
    """

    database: str
    campaign: str
    digest: str
    pairs: dict[str, Any]
    finding: dict[str, Any]
    random: str


@pytest.fixture(scope="module")
def searched(sqlite_file: Path, tmp_path_factory: pytest.TempPathFactory) -> Searched:
    url = f"sqlite:///{shutil.copyfile(sqlite_file, tmp_path_factory.mktemp('odd') / 'drives.db')}"
    with pytest.MonkeyPatch.context() as patched, coordinator(url) as client:
        patched.setattr(surrogate, "TREES", 15)
        campaign = drive(client, SEARCH)
        own = {name: one for name, one in PROBLEM["params"].items() if name != "odd"}  # type: ignore[attr-defined]
        anywhere = {
            **SEARCH,
            "name": "anywhere",
            "algorithm": {"id": "random@1"},
            "budget": {"simulations": 60},
        }
        random = drive(client, {**anywhere, "problem": {"id": "urban-injected@1", "params": own}})
        return Searched(
            database=url,
            campaign=campaign,
            digest=progress(client, campaign)["digest"],
            pairs=expect(client.get(f"{API}/{campaign}/pairs")),
            finding=expect(client.get(f"{API}/{campaign}/findings")),
            random=random,
        )


def test_everything_that_was_simulated_is_within_the_odd(searched: Searched) -> None:
    space = make_problem("urban-injected@1", PROBLEM["params"]).space  # type: ignore[arg-type]
    assert space.dimension == 7 + 3 * 11
    with coordinator(searched.database) as client:
        rows = rows_of(client, searched.campaign)
        drawn = rows_of(client, searched.random)
    assert len(rows) == 70
    for row in rows:
        space.check(space.split(row))
    assert not all(space.contains(space.split(row)) for row in drawn)


def test_a_warm_start_leaves_out_what_is_outside_the_odd_and_counts_it(searched: Searched) -> None:
    body = {**SEARCH, "name": "warm", "algorithm": {"id": "random@1"}, "budget": {"simulations": 4}}
    wide = {"scenario.weather": ODD["scenario.weather"]}
    problem = {**PROBLEM, "params": {**PROBLEM["params"], "odd": wide}}  # type: ignore[dict-item]
    space = make_plan(parse_body({**body, "problem": problem})).problem.space
    with coordinator(searched.database) as client:
        drawn = rows_of(client, searched.random)
        inside = sum(space.contains(space.split(row)) for row in drawn)
        assert 0 < inside < len(drawn)
        warm = drive(client, {**body, "problem": problem, "start_from": {"campaign": searched.random}})
        known = progress(client, warm)["known"]
        assert (known["results"], known["outside_odd"]) == (inside, len(drawn) - inside)
        everything = drive(client, {**body, "start_from": {"campaign": searched.campaign}})
        assert progress(client, everything)["known"]["outside_odd"] == 0
        nowhere = {**ODD, "behaviour.trajectory_*.t1_step": {"min": 59}}
        refused = client.post(
            API,
            json={
                **body,
                "start_from": {"campaign": searched.random},
                "problem": {**PROBLEM, "params": {**PROBLEM["params"], "odd": nowhere}},  # type: ignore[dict-item]
            },
        )
    assert refused.status_code == 422
    assert "has no solutions within the ODD" in refused.json()["errors"][0]["message"]


def test_a_command_adds_limits_to_those_of_the_file(sqlite_file: Path, tmp_path: Path) -> None:
    file = tmp_path / "hills.json"
    file.write_text(
        json.dumps(
            {
                "name": "hills",
                "problem": {"id": "mtq@1"},
                "algorithm": {"id": "random@1"},
                "budget": {"simulations": 30},
                "seed": 1,
            }
        )
    )
    url = f"sqlite:///{shutil.copyfile(sqlite_file, tmp_path / 'hills.db')}"
    command = ["run", str(file), "--odd", "x.x={min: 0.2, max: 0.4}", "--no-pictures", "--json"]
    told = CliRunner().invoke(
        app, [*command, "--database", url, "--out", str(tmp_path)], catch_exceptions=False
    )
    assert told.exit_code == 0, told.output
    summary = json.loads(told.stdout)
    assert summary["outcomes"]["odd"].startswith("All of this is within the ODD: x: x is 0.2 to 0.4.")
    with coordinator(url) as client:
        rows = rows_of(client, summary["campaign"])
    assert rows[:, 0].min() >= 0.2
    assert rows[:, 0].max() <= 0.4


def test_the_same_campaign_gives_the_same_archive(
    searched: Searched, sqlite_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(surrogate, "TREES", 15)
    url = f"sqlite:///{shutil.copyfile(sqlite_file, tmp_path / 'again.db')}"
    with coordinator(url) as client:
        assert progress(client, drive(client, SEARCH))["digest"] == searched.digest


def test_a_wrong_odd_is_refused_at_submission(searched: Searched) -> None:
    problem = {"id": "urban-injected@1", "params": {"odd": {"scenario.weather": "hail"}}}
    with coordinator(searched.database) as client:
        answer = client.post(API, json={**SEARCH, "problem": problem})
    (error,) = answer.json()["errors"]
    assert answer.status_code == 422
    assert error["pointer"] == "/problem/params/odd/scenario.weather"
    assert "expected one of" in error["message"]
