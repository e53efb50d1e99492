"""What one campaign reached beside its control, over the API."""

from typing import Any

import httpx
import pytest
from support.api import FakeWorker, ball, expect, progress, submit
from support.problems import REQUIREMENT

from brink.search.analysis.paper import PAPER_D_THS, PAPER_FRACTIONS, PAPER_T_BS
from brink.worker.wire import Completed, LeasedJob, WireVerdict

SLOTS: dict[str, Any] = {
    "name": "slots", "problem": {"id": "slotted-blind@1"},
    "algorithm": {"id": "random@1", "params": {"generation_size": 50}}, "budget": {"simulations": 100}, "seed": 3,
}  # fmt: skip


def strong(job: LeasedJob) -> Completed:
    """Judge a chain: a strong perturbation that comes first is unsafe."""
    robustness = 0.5 - float(job.spec["behaviour"]["strong"])
    verdict = WireVerdict(robustness=robustness, unit="m", violated_at_s=None)
    return Completed(verdicts={REQUIREMENT: verdict}, objectives={"distance": robustness})


def scores(client: httpx.Client, campaign: str) -> dict[str, Any]:
    found: dict[str, Any] = expect(
        client.get(f"/api/v1/campaigns/{campaign}/scores", params={"wait_s": 60}), 200
    )
    return found


def test_what_a_campaign_reached_is_known_when_it_has_ended(client: httpx.Client) -> None:
    campaign = submit(client, ball(simulations=60))
    assert "when it has ended" in expect(client.get(f"/api/v1/campaigns/{campaign}/scores"), 409)["detail"]
    assert FakeWorker(client).work(campaign)["status"] == "finished"
    found = scores(client, campaign)
    assert (found["id"], found["name"], found["status"]) == (campaign, "ball", "finished")
    assert (found["fractions"], found["t_bs"], found["d_ths"]) == (
        list(PAPER_FRACTIONS), list(PAPER_T_BS), list(PAPER_D_THS),
    )  # fmt: skip
    assert found["evaluated"] == 60
    assert found["unsafe_share"] == pytest.approx(found["unsafe"] / 60)
    assert (found["control"], found["says"]) == (None, []), "the ball has no component called scenario"
    if progress(client, campaign)["simulations"] == 60:
        grid = expect(client.get(f"/api/v1/campaigns/{campaign}/boundary"))["grid"]
        assert [cell["dbs"] for cell in grid] == [figure for row in found["dbs"][-1] for figure in row]
        assert [cell["strict_dbs"] for cell in grid] == [f for row in found["strict"][-1] for f in row]
    expect(client.get("/api/v1/campaigns/nosuch/scores"), 404)


def test_a_control_stands_beside_it_with_what_the_two_say_together(client: httpx.Client) -> None:
    campaign = submit(client, SLOTS)
    worker = FakeWorker(client, judge=strong)
    assert worker.work(campaign)["status"] == "finished"
    answer = client.get(f"/api/v1/campaigns/{campaign}/scores", params={"wait_s": 0})
    if answer.status_code == 202:
        assert answer.headers["Retry-After"]
    found = scores(client, campaign)
    assert found["control"]["reads_low"], "random search gives each scenario one behaviour"
    assert (len(found["says"]), {len(row) for row in found["says"]}) == (len(PAPER_T_BS), {len(PAPER_D_THS)})
    assert all("proves nothing" in words for row in found["says"] for words in row)

    experiment = {
        "name": "one", "problems": [SLOTS["problem"]], "algorithms": [SLOTS["algorithm"]], "seeds": [3],
        "budget": SLOTS["budget"],
    }  # fmt: skip
    stored = expect(client.post("/api/v1/experiments", json=experiment), 201)
    assert worker.work(stored["members"][0]["campaign"])["status"] == "finished"
    path = f"/api/v1/experiments/{stored['id']}/results"
    (repeat,) = expect(client.get(path, params={"wait_s": 60}))["repeats"]
    for key in ("dbs", "strict", "control", "evaluated", "unsafe"):
        assert repeat[key] == found[key], f"{key}: the same campaign with the same seed"


def test_a_campaign_that_was_cancelled_before_anything_was_simulated_reached_nothing(
    client: httpx.Client,
) -> None:
    campaign = submit(client, ball())
    expect(client.post(f"/api/v1/campaigns/{campaign}/cancel"))
    found = scores(client, campaign)
    assert (found["evaluated"], found["unsafe_share"]) == (0, 0.0)
    assert {figure for at in found["strict"] for row in at for figure in row} == {0.0}
