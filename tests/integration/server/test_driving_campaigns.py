"""Campaigns with a driving system of a user."""

import asyncio
import random
from collections.abc import Callable, Iterator
from typing import Any, ClassVar

import httpx
import pytest
from support.api import FakeWorker, coordinator, expect, listening_coordinator, submit
from support.drives import simulate
from typer.testing import CliRunner

from brink.api.changed_pairs import changed_campaign, changed_shares, changed_table, changed_words
from brink.api.client import Api
from brink.api.results import FetchedArchive, fetch_archive
from brink.cli.commands import app
from brink.server.errors import InvalidInput
from brink.server.findings.pairs.views import PairView, SideView
from brink.sim import catalogue
from brink.sim.driving_systems import Decision, Observation, Start
from brink.sim.driving_systems.option import DRIVING_SYSTEMS
from brink.sim.errors import DrivingSystemFailed
from brink.worker.wire import Completed, JobFailed, LeasedJob

CAMPAIGN = {
    "name": "driven",
    "problem": {"id": "urban-injected@1", "params": {"duration_s": 5.0, "driving": "tested@1"}},
    "algorithm": {"id": "random@1", "params": {"generation_size": 5}},
    "budget": {"simulations": 10},
    "execution": {"keep_traces": 0},
    "seed": 1,
}


class Rolls:
    needs: ClassVar = "boxes"

    def __init__(self, start: Start) -> None:
        pass

    def step(self, observation: Observation) -> Decision:
        return Decision(accel_mps2=0.5)


class Gambles(Rolls):
    def step(self, observation: Observation) -> Decision:
        return Decision(accel_mps2=random.random())


@pytest.fixture(name="driver")
def _driver() -> Iterator[Callable[[type[Rolls]], None]]:
    yield lambda system: catalogue.register(DRIVING_SYSTEMS, "tested@1", system)
    catalogue._registered.pop(DRIVING_SYSTEMS, None)


@pytest.mark.parametrize(
    ("system", "words"),
    [
        (Rolls, ""),
        (
            Gambles,
            "4 of 4 drives that were driven again had another result: tested@1 is not deterministic, so nothing "
            "found here can be relied on",
        ),
    ],
)
def test_campaign_says_that_its_driving_system_is_not_deterministic(
    database_url: str, driver: Callable[[type[Rolls]], None], system: type[Rolls], words: str
) -> None:
    driver(system)
    with coordinator(database_url) as client:
        campaign = submit(client, CAMPAIGN)
        worker = FakeWorker(client, capabilities=("brink-drive@3",), judge=simulate)
        assert worker.work(campaign)["status"] == "finished"
        worker.report_all()
        assert len(worker.statuses) == 14
        said = expect(client.get(f"/api/v1/campaigns/{campaign}/findings"))["words"]
        assert said.endswith(f"; {words}.") if words else "deterministic" not in said


class Swerves(Rolls):
    """Leaves the lane with every second seed."""

    def __init__(self, start: Start) -> None:
        self.steer_rad = 0.4 if start.seed % 2 else None

    def step(self, observation: Observation) -> Decision:
        return Decision(steer_rad=self.steer_rad)


class Brakes(Rolls):
    def step(self, observation: Observation) -> Decision:
        return Decision(accel_mps2=-5.0)


class Fails(Rolls):
    def step(self, observation: Observation) -> Decision:
        raise ValueError("no plan")


def fetched(client: httpx.Client, campaign: str) -> FetchedArchive:
    async def fetch() -> FetchedArchive:
        url = str(client.base_url)
        async with httpx.AsyncClient(base_url=url) as connection:
            return await fetch_archive(Api(connection, url), campaign)

    return asyncio.run(fetch())


def work(client: httpx.Client, body: dict[str, Any]) -> str:
    """Run a campaign in which drives may fail, and return its id."""

    def drive(job: LeasedJob) -> Completed | JobFailed:
        try:
            return simulate(job)
        except DrivingSystemFailed as error:
            return JobFailed(reason="invalid", message=str(error))

    campaign = submit(client, body)
    worker = FakeWorker(client, capabilities=("brink-drive@3",), judge=drive)
    assert worker.work(campaign)["status"] in ("finished", "failed")
    worker.report_all()
    return campaign


def test_pairs_are_simulated_with_another_driving_system(
    database_url: str, driver: Callable[[type[Rolls]], None]
) -> None:
    for name, system in (("brakes@1", Brakes), ("fails@1", Fails)):
        catalogue.register(DRIVING_SYSTEMS, name, system)
    driver(Swerves)
    with listening_coordinator(database_url) as client:
        params = {"duration_s": 5.0, "driving": "tested@1", "requirement": "lane-keeping@1"}
        problem = {"id": "urban-injected@1", "params": params}
        first = fetched(client, work(client, CAMPAIGN | {"problem": problem}))
        archive = first.archive
        safe, unsafe = (int(archive.numbers[archive.unsafe == one][0]) for one in (False, True))
        pair_view: Any = PairView
        side_view: Any = SideView
        pair = pair_view.model_construct(
            place=1,
            change="faster",
            safe=side_view.model_construct(number=safe),
            unsafe=side_view.model_construct(number=unsafe),
        )
        for name, words in (
            ("brakes@1", "0 of 1 unsafe drive are unsafe with at least 80% of seeds, 1 not"),
            ("fails@1", "0 of 1 unsafe drive are unsafe with at least 80% of seeds, 0 not, 1 cannot run"),
        ):
            body, numbers = changed_campaign(first, [pair], {"driving": name}, 6)
            assert sorted(numbers) == sorted([safe, unsafe])
            again = fetched(client, work(client, body.model_dump(mode="json")))
            ended: dict[int, bool | None] = dict.fromkeys(range(12))
            ended |= dict(zip(again.archive.numbers.tolist(), again.archive.unsafe.tolist(), strict=True))
            shares = changed_shares(body, numbers, ended)
            assert changed_words([pair], shares).startswith(words)
            assert changed_table([pair], shares).rows[0][:2] == [1, "faster"]
        with pytest.raises(InvalidInput, match="leaves the search space of urban-injected@1 as it is"):
            changed_campaign(first, [pair], {"trajectories": 1}, 6)
        with pytest.raises(InvalidInput, match="drivin"):
            changed_campaign(first, [pair], {"drivin": "brakes@1"}, 6)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ([], "--set: requires --confirm"),
        (["--confirm", "9", "--sharpen"], "--set: cannot be combined with --sharpen"),
    ],
)
def test_change_without_confirmation_is_refused(options: list[str], words: str) -> None:
    done = CliRunner().invoke(app, ["pairs", "3f2a", "--set", "driving=idm:Idm", *options])
    assert str(done.exception) == words
