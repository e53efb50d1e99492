"""`brink guard fit` and `judge` on a campaign of real drives, and what they refuse."""

import json
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from support.api import FakeWorker, coordinator, eventually, expect, progress, submit
from support.drives import simulate
from support.guards import stump_guard
from typer.testing import CliRunner, Result

from brink.cli.commands import app
from brink.guard.choices import Sensor
from brink.guard.model import GuardModel
from brink.search.analysis import guard_training
from brink.server.errors import Conflict, InvalidInput
from brink.sim.errors import GuardFileError

pytestmark = pytest.mark.long("simulates drives; guards have unit tests")

DRIVES = 60
CAMPAIGN: dict[str, Any] = {
    "name": "drives",
    "problem": {
        "id": "urban-injected@1",
        "params": {"requirement": ["front-gap@1", "no-collision@1", "progress@1"], "duration_s": 16.0},
    },
    "algorithm": {"id": "random@1"},
    "budget": {"simulations": DRIVES},
    "seed": 4,
}
OTHER: dict[str, Any] = {
    "name": "other",
    "problem": {"id": "mtq@1"},
    "algorithm": {"id": "random@1"},
    "budget": {"simulations": 20},
}
UNSAFE_SHARE = (0.2, 0.8)


@dataclass(frozen=True, slots=True, kw_only=True)
class Driven:
    """A campaign of real drives that has ended, and one on another problem.

    Attributes:
        database: Where they are stored.
        campaign: Its id.
        other: Id of the other one.
        unsafe: Number of its unsafe drives.
    """

    database: str
    campaign: str
    other: str
    unsafe: int


@pytest.fixture(scope="module")
def driven(sqlite_file: Path, tmp_path_factory: pytest.TempPathFactory) -> Driven:
    file = shutil.copyfile(sqlite_file, tmp_path_factory.mktemp("driven") / "drives.db")
    with coordinator(f"sqlite:///{file}") as client:
        campaign = submit(client, CAMPAIGN)
        worker = FakeWorker(client, capabilities=("brink-drive@3",), judge=simulate)
        assert worker.work(campaign)["status"] == "finished"
        counts = expect(client.get(f"/api/v1/campaigns/{campaign}/outcomes"))["counts"]
        other = submit(client, OTHER)
        eventually(lambda: progress(client, other)["status"] == "finished", "the other campaign has finished")
    return Driven(database=f"sqlite:///{file}", campaign=campaign, other=other, unsafe=counts["violated"])


@pytest.fixture(autouse=True)
def small_forests(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(guard_training, "TREES", 8)


def brink(*arguments: object) -> Result:
    return CliRunner().invoke(app, ["guard", *map(str, arguments), "--processes", "1"])


def output(result: Result) -> str:
    assert result.exit_code == 0, (result.output, result.exception)
    return result.stdout


def test_a_guard_is_fitted_to_a_campaign_and_judged_on_fresh_drives(driven: Driven, tmp_path: Path) -> None:
    file, place = tmp_path / "new" / "guard.json", ("--database", driven.database)
    told = json.loads(
        output(brink("fit", driven.campaign[:6], "--out", file, "--sensor", "range", *place, "--json"))
    )
    assert (told["file"], told["drives"], told["violations"]) == (str(file), DRIVES, driven.unsafe)
    assert UNSAFE_SHARE[0] < driven.unsafe / DRIVES < UNSAFE_SHARE[1]
    model = GuardModel.load(file)
    assert model.sensor is Sensor.RANGE
    assert model.requirements == ("front-gap@1", "no-collision@1", "progress@1")
    assert model.about["campaigns"] == [driven.campaign]
    assert model.about["problem"]["params"]["duration_s"] == 16.0
    assert model.alarm.threshold == told["threshold"]

    picture = tmp_path / "pictures" / "guard.png"
    judged = json.loads(output(brink("judge", file, "--drives", 40, "--picture", picture, "--json")))
    assert judged["drives"] == 40
    assert 4 <= judged["violations"] <= 36
    names = [one["name"] for one in judged["predictors"]]
    assert names == ["guard", "time to collision on boxes", "time to collision on ranges", "always", "never"]
    alarmed = {one["name"]: one["points"][-1]["false_alarms"] for one in judged["predictors"]}
    assert (alarmed["guard"], alarmed["always"], alarmed["never"]) == (1.0, 1.0, 0.0)
    own = judged["own"]["point"]
    assert own["threshold"] == model.alarm.threshold
    assert own["false_alarms"] < 0.5
    assert [one["horizon_s"] for one in judged["horizons"]] == [1.0, 2.0, 3.0]
    assert all(0.5 < one["auroc"] <= 1.0 for one in judged["horizons"])
    assert picture.stat().st_size > 10_000

    with pytest.raises(Conflict, match=f"was fitted to campaign {driven.campaign}"):
        raise_from(brink("judge", file, driven.campaign, *place))


def raise_from(result: Result) -> None:
    assert result.exception is not None, result.output
    raise result.exception


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("fit",), "--random"),
        (("fit", "--random", "10", "--requirement", "no-such@1"), "no-such@1"),
        (("judge", "{guard}"), "--drives"),
        (("judge", "{guard}", "--drives", "10", "--picture", "guard.gif"), "--picture"),
    ],
)
def test_wrong_arguments_are_refused_before_anything_runs(
    arguments: tuple[str, ...], words: str, tmp_path: Path
) -> None:
    file = tmp_path / "guard.json"
    file.write_text(stump_guard().to_json())
    with pytest.raises(InvalidInput) as refused:
        raise_from(brink(*(one.format(guard=file) for one in arguments)))
    assert words in str(refused.value.errors[0])


def test_campaigns_of_other_problems_are_refused(driven: Driven, tmp_path: Path) -> None:
    place = ("--database", driven.database, "--out", tmp_path / "guard.json")
    with pytest.raises(InvalidInput) as refused:
        raise_from(brink("fit", driven.other, *place))
    assert "urban-injected@1" in str(refused.value.errors[0])
    with pytest.raises(Conflict, match="different problems"):
        raise_from(brink("fit", driven.campaign, driven.other, *place))


def test_a_guard_is_not_judged_on_the_random_drives_that_it_was_fitted_to(tmp_path: Path) -> None:
    file, document = tmp_path / "guard.json", json.loads(stump_guard().to_json())
    document["about"]["random"] = {"drives": 100, "seed": 7}
    file.write_text(json.dumps(document))
    with pytest.raises(Conflict, match="choose another --seed"):
        raise_from(brink("judge", file, "--drives", "10", "--seed", "7"))


def test_a_file_that_is_no_guard_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "monitor.json"
    file.write_text("{}")
    with pytest.raises(GuardFileError, match=r"monitor\.json"):
        raise_from(brink("judge", file, "--drives", "10"))
