"""The API shows the parameters that had a part in an episode, and only these."""

import io
from typing import Any

import httpx
import numpy as np
import pytest
from support.api import FakeWorker, expect, solutions, submit

from brink.server.problems.base import NO_PART
from brink.server.problems.urban_injected import REQUIREMENTS, SIMULATOR
from brink.worker.wire import Completed, JobFailed, LeasedJob, WireVerdict

pytestmark = pytest.mark.long("what a page shows of a campaign")

API = "/api/v1/campaigns"
END_STEP = 100
URBAN = {
    "name": "short drives",
    "problem": {"id": "urban-injected@1"},
    "seed": 4,
    "budget": {"simulations": 60},
    "algorithm": {"id": "random@1", "params": {"generation_size": 60}},
}


def older(job: LeasedJob) -> Completed | JobFailed:
    """Return an outcome without a record of the injected trajectories."""
    verdict = WireVerdict(robustness=-1.0 if job.spec["seed"] % 2 else 1.0, unit="m", violated_at_s=None)
    return Completed(verdicts=dict.fromkeys(REQUIREMENTS, verdict), features={"ended_at_s": 0.1 * END_STEP})


def ends_early(job: LeasedJob) -> Completed | JobFailed:
    """Return the outcome of an episode that ends at `END_STEP`."""
    result = older(job)
    assert isinstance(result, Completed)
    delivered = [
        None if t["t0_step"] > END_STEP else [int(t["t0_step"]), int(min(t["t1_step"], END_STEP))]
        for t in job.spec["behaviour"]["trajectories"]
    ]
    return result.model_copy(update={"features": {**result.features, "delivered_steps": delivered}})


def finished(client: httpx.Client, judge: Any, **changes: Any) -> str:
    campaign = submit(client, {**URBAN, **changes})
    worker = FakeWorker(client, capabilities=(SIMULATOR,), judge=judge)
    assert worker.work(campaign)["status"] == "finished"
    return campaign


def test_only_active_parameters_are_shown(client: httpx.Client) -> None:
    campaign = finished(client, ends_early)
    found = solutions(client, campaign)
    late = "behaviour.trajectory_1.t0_step"
    values = [one["parameters"]["behaviour"] for one in found]
    never = [v["trajectory_1.label"] != "null" and v["trajectory_1.t0_step"] > END_STEP for v in values]
    asleep = [v["trajectory_1.label"] == "null" for v in values]
    assert 0 < sum(never) < len(found)
    for one, value, gone, null in zip(found, values, never, asleep, strict=True):
        activity = one["activity"]
        assert (late in activity["inactive"]) is (gone or null)
        shown = activity["effective"]["behaviour"]
        assert shown["trajectory_1.label"] == ("null" if gone else value["trajectory_1.label"])
        assert shown["trajectory_1.t1_step"] == (
            0 if gone or null else min(END_STEP, value["trajectory_1.t1_step"])
        )
        assert (NO_PART in one["words"]) is (activity["idle"] == ["behaviour"])
        assert one["words"] == expect(client.get(f"{API}/{campaign}/solutions/{one['number']}"))["words"]
    assert any(one["activity"]["idle"] for one in found)

    inactive = sum(map(any, zip(never, asleep, strict=True)))
    coloured = expect(client.get(f"{API}/{campaign}/map", params={"parameter": late}))["by"]
    assert sum(value is None for value in coloured["values"]) == inactive
    shares = expect(client.get(f"{API}/{campaign}/dependence"))["parameters"]
    (share,) = [one for one in shares if f"{one['component']}.{one['parameter']}" == late]
    assert sum(share["counts"]) == len(found) - inactive

    answer = client.get(f"{API}/{campaign}/archive.npz")
    with np.load(io.BytesIO(answer.content), allow_pickle=False) as npz:
        column = npz["columns"].tolist().index(late)
        assert npz["recorded"].all()
        assert (~npz["active"][:, column]).sum() == inactive
        assert npz["vectors"][:, column].tolist() == [v["trajectory_1.t0_step"] for v in values]

    table: dict[str, int | str] = {"t_b": 1, "d_th": 0, "format": "jsonl"}
    rows = client.get(f"{API}/{campaign}/boundary", params=table).text.splitlines()
    assert sum(f'"{late}": null' in row for row in rows) == inactive


def test_results_without_a_record_claim_nothing(client: httpx.Client) -> None:
    campaign = finished(client, older)
    found = solutions(client, campaign)
    assert {one["activity"] for one in found} == {None}
    assert not any(NO_PART in one["words"] for one in found)
    answer = client.get(f"{API}/{campaign}/archive.npz")
    with np.load(io.BytesIO(answer.content), allow_pickle=False) as npz:
        assert not npz["recorded"].any()
        assert npz["active"].all()
        assert npz["effective"].tolist() == npz["vectors"].tolist()
