"""The problem of perturbed pictures: what it asks, what it refuses before anything runs."""

from pathlib import Path
from typing import Any

import pytest

from server.campaigns.body import parse_body
from server.campaigns.service import check_submission
from server.errors import InvalidInput

BODY: dict[str, Any] = {
    "name": "p", "problem": {"id": "aeb-crossing@1"}, "algorithm": {"id": "simood-ga@1"},
    "budget": {"simulations": 200},
}  # fmt: skip


def refused(**params: Any) -> dict[str, str]:
    with pytest.raises(InvalidInput) as caught:
        check_submission(parse_body({**BODY, "problem": {"id": "aeb-crossing@1", "params": params}}))
    return {error.pointer: error.message for error in caught.value.errors}


def test_the_first_generation_is_measured_on_data() -> None:
    _, solutions = check_submission(parse_body(BODY))
    assert len(solutions) == 20
    specs = [solution.job.spec for solution in solutions if solution.job is not None]
    assert len(set(specs)) == 20
    assert all('"simulator":"brink-dataset@1"' in spec.replace(" ", "") for spec in map(str, specs))


def test_what_is_missing_or_broken_is_told_at_submission(tmp_path: Path) -> None:
    broken = tmp_path / "labels.json"
    broken.write_text('{"images": []}')
    weights = tmp_path / "weights.onnx"
    weights.write_text("nothing")
    assert refused(dataset=str(broken)) == {
        "/problem/params/dataset": f"{broken}: expected a list of images that is not empty, as COCO has it"
    }
    assert "No such file" in refused(dataset="nowhere.json")["/problem/params/dataset"]
    assert "no such file" in refused(detector="onnx:nowhere.onnx")["/problem/params/detector"]
    assert "brink-det@1" in refused(detector="brnk-det@1")["/problem/params/detector"]
    assert "cannot be loaded" in refused(detector=f"onnx:{weights}")["/problem/params/detector"]
    assert set(refused(detector="onnx:no.onnx", dataset="no.json")) == {
        "/problem/params/detector", "/problem/params/dataset",
    }  # fmt: skip
