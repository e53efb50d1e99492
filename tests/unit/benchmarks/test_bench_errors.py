"""The benchmark of fitted errors keeps what it recorded with a camera."""

from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks.errors import is_unsafe, meter_of, random_specs, record_drive
from brink.search.streams import episode_seed
from brink.server.problems.urban_camera import UrbanCamera, UrbanCameraParams
from brink.server.problems.urban_fitted import UrbanFitted, UrbanFittedParams
from brink.sim.urban.camera import BrinkDriveCamera, InTheLoop
from brink.sim.urban.error_meter import ErrorMeter, measures_to_json


def test_a_recorded_drive_is_read_as_it_was_and_not_driven_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (spec,) = random_specs(UrbanCamera(UrbanCameraParams(duration_s=5.0)), 1, 3)
    spec = replace(spec, duration_s=2.0)
    meters: list[ErrorMeter] = []
    features = InTheLoop.features

    def kept(self: InTheLoop, outcome: object) -> object:
        assert self.meter is not None
        meters.append(self.meter)
        return features(self, outcome)  # type: ignore[arg-type]

    monkeypatch.setattr(InTheLoop, "features", kept)
    file = tmp_path / "drive.json.gz"
    document = record_drive((spec, file))
    read = meter_of(document)
    (meter,) = meters
    assert len(read.ghosts) == 20
    assert read.ghosts == meter.ghosts
    assert measures_to_json(read) == measures_to_json(meter)
    assert [str(sample) for sample in read.samples] == [str(sample) for sample in meter.samples]  # NaN too
    monkeypatch.setattr(BrinkDriveCamera, "run", None)
    assert str(record_drive((spec, file))) == str(document)


def test_drives_of_a_seed_have_the_same_scenarios_whatever_drives_them() -> None:
    camera = random_specs(UrbanCamera(UrbanCameraParams(duration_s=5.0)), 3, 6)
    problem = UrbanFitted(UrbanFittedParams(duration_s=5.0))
    fitted = random_specs(problem, 3, 6)
    assert [spec.scenario for spec in camera] == [spec.scenario for spec in fitted]
    assert [spec.seed for spec in fitted] == [episode_seed(6, number) for number in range(3)]
    assert is_unsafe((fitted[0], problem.requirements)) is False
