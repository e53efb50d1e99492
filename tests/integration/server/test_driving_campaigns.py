"""Campaigns with a driving system of a user."""

import random
from collections.abc import Callable, Iterator
from typing import ClassVar

import pytest
from support.api import FakeWorker, coordinator, expect, submit
from support.databases import on_sqlite
from support.drives import simulate

from brink.sim import catalogue
from brink.sim.driving_systems import Decision, Observation, Start
from brink.sim.driving_systems.option import DRIVING_SYSTEMS

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


@on_sqlite
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
