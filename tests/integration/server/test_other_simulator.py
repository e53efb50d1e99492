"""Campaigns that were simulated with an earlier version of their problem's simulator: shown, but not continued."""

import httpx
from sqlalchemy import update
from support.api import (
    FakeWorker,
    ball,
    coordinator,
    eventually,
    expect,
    finish,
    listening_coordinator,
    progress,
    submit,
)
from support.problems import SIMULATOR
from typer.testing import CliRunner

from brink.cli.commands import app
from brink.server.db.engine import Engines
from brink.server.db.models import JobRow

EARLIER = "faulty@0"
API = "/api/v1/campaigns"


def simulate_earlier(engines: Engines) -> None:
    """Pretend that all campaigns were simulated with the simulator's earlier version."""
    with engines.writer.begin() as connection:
        connection.execute(update(JobRow).where(JobRow.needs == SIMULATOR).values(needs=EARLIER))


def is_paused(client: httpx.Client, campaign: str) -> bool:
    return bool(progress(client, campaign)["status"] == "paused")


def test_an_unfinished_campaign_is_paused_and_says_why(
    engines: Engines, database_url: str, small_problems: None
) -> None:
    with coordinator(database_url) as client:
        campaign = submit(client, ball())
        for outcome in FakeWorker(client).lease(max_jobs=3):
            assert outcome.spec["simulator"] == SIMULATOR
    simulate_earlier(engines)
    with coordinator(database_url) as client:
        eventually(lambda: is_paused(client, campaign), "the first sweep pauses it")
        reason = progress(client, campaign)["status_reason"]
        assert f"simulated with {EARLIER}, but ball@1 now uses {SIMULATOR}" in reason
        assert "submit it again" in reason
        expect(client.post(f"{API}/{campaign}/resume"))
        eventually(lambda: is_paused(client, campaign), "it is paused again")
        assert progress(client, campaign)["status_reason"] == reason


def test_a_finished_campaign_is_shown_but_neither_repeated_nor_traced(
    client: httpx.Client, engines: Engines
) -> None:
    campaign = submit(client, ball())
    assert FakeWorker(client).work(campaign)["status"] == "finished"
    wide = {"t_b": 1.0, "d_th": 0.05}
    before = expect(client.get(f"{API}/{campaign}/boundary", params=wide))
    simulate_earlier(engines)
    assert expect(client.get(f"{API}/{campaign}/boundary", params=wide)) == before
    answer = expect(client.post(f"{API}/{campaign}/repeats", json={"repeats": 3, **wide}), 409)
    assert f"simulated with {EARLIER}, but ball@1 now uses {SIMULATOR}" in answer["detail"]
    answer = expect(client.post(f"{API}/{campaign}/solutions/3/trace"), 503)
    assert f"no live worker can run {EARLIER}" in answer["detail"]
    assert f"simulated with {EARLIER}, but ball@1 now uses {SIMULATOR}" in answer["detail"]


def test_campaigns_of_two_simulators_are_compared_with_a_warning(
    engines: Engines, database_url: str, small_problems: None
) -> None:
    with listening_coordinator(database_url) as client:

        def compared(*campaigns: str) -> str:
            words = ["compare", *campaigns, "--no-control", "--server", str(client.base_url)]
            shown = CliRunner().invoke(app, words)
            assert shown.exit_code == 0, shown.output
            return " ".join(shown.output.split())

        before = finish(client, ball(name="before"))
        simulate_earlier(engines)
        after, again = (finish(client, ball(name=name, seed=7)) for name in ("after", "again"))
        simulators = [expect(client.get(f"{API}/{one}"))["simulator"] for one in (before, after)]
        assert simulators == [EARLIER, SIMULATOR]
        told = (
            f"different simulators, which may explain differences between the campaigns: {EARLIER}: before; "
        )
        assert told in compared(before, after)
        assert "different simulators" not in compared(after, again)
