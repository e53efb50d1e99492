"""`brink errors fit` on a CSV file, up to the campaign file that drives what was fitted."""

from pathlib import Path

import pytest
import yaml
from typer.testing import CliRunner

from brink.cli.errors import errors
from brink.server.campaigns.body import CampaignBody
from brink.server.errors import InvalidInput
from brink.server.problems.urban_fitted import UrbanFitted, UrbanFittedParams
from brink.sim.urban.error_process import LOST, SEEN


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Return a recording of five drives with a lead that is lost for half a second in every three."""
    rows = ["drive,time_s,source,id,label,x_min_px,x_max_px,y_min_px,y_max_px"]
    for drive in range(5):
        for step in range(90):
            rows.append(f"d{drive},{step / 10:.1f},truth,7,car,382,418,304,334")
            if step % 30 >= 5:
                rows.append(f"d{drive},{step / 10:.1f},detection,,car,382,418,304,334")
    file = tmp_path / "mine.csv"
    file.write_text("\n".join(rows) + "\n")
    return file


def test_a_recording_becomes_a_campaign(recording: Path, tmp_path: Path) -> None:
    out = tmp_path / "errors.yaml"
    result = CliRunner().invoke(errors, ["fit", str(recording), "--out", str(out), "--simulations", "50"])
    assert result.exit_code == 0, result.output
    assert "Read 5 drives, 450 images" in result.output
    assert "No pedestrian in the recording" in result.output
    body = CampaignBody.model_validate(yaml.safe_load((tmp_path / "campaign.yaml").read_text()))
    assert (body.problem.id, body.budget.simulations, body.name) == ("urban-fitted@1", 50, "fitted-mine")
    assert body.problem.params["errors"] == yaml.safe_load(out.read_text())
    fitted = UrbanFitted(UrbanFittedParams(**body.problem.params)).params.fitted()
    assert fitted is not None
    row = fitted.process.shares[0, 2]
    assert fitted.rests_on[0, 2, SEEN] == 450
    assert row[SEEN] == pytest.approx(75 / 90, abs=0.01)
    assert row[LOST + 2] == pytest.approx(10 / (5 * 45), abs=0.01)


def test_an_unknown_type_is_refused(recording: Path) -> None:
    result = CliRunner().invoke(errors, ["fit", str(recording), "--without", "weather"])
    assert isinstance(result.exception, InvalidInput)
    assert "expected some of misses, delays, places, labels, ghosts, got 'weather'" in str(
        result.exception.errors[0]
    )
