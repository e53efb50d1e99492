"""Episodes with a guard: determinism, unchanged hashes without one, what is recorded, and what is refused."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.guards import stump_guard

from brink.guard.choices import Sensor
from brink.guard.model import feature_names
from brink.sim.driving.interface import LATENCY_S, PERCEPTION_STEP_S
from brink.sim.episode import EpisodeResult, EpisodeSpec, Json
from brink.sim.errors import InvalidEpisode
from brink.sim.guard.option import GuardOption, guard_digest
from brink.sim.trace import Trace
from brink.sim.urban.camera import BrinkDriveCamera
from brink.sim.urban.simulator import BrinkDrive

GHOST: dict[str, Json] = {
    "label": "vehicle",
    "t0_step": 30.0,
    "t1_step": 60.0,
    "x_min_0_px": 370.0,
    "x_max_0_px": 430.0,
    "y_min_0_px": 290.0,
    "y_max_0_px": 340.0,
    "x_min_1_px": 200.0,
    "x_max_1_px": 600.0,
    "y_min_1_px": 200.0,
    "y_max_1_px": 560.0,
}


def spec(*, options: dict[str, Json] | None = None, seed: int = 5, duration_s: float = 15.0) -> EpisodeSpec:
    return EpisodeSpec(
        simulator="brink-drive@3",
        scenario={
            "time_of_day": "noon",
            "weather": "clear",
            "pedestrians": 0,
            "road_curve": "straight",
            "road_id": 0,
            "road_length": 1,
            "driving_task": "follow_road",
        },
        behaviour={"mode": "injected", "trajectories": [GHOST]},
        requirements=("front-gap@1", "no-collision@1"),
        seed=seed,
        duration_s=duration_s,
        options={"fidelity": "bicycle"} if options is None else options,
    )


def guarded(base: EpisodeSpec, guard: str = "ttc@1", **given: object) -> EpisodeSpec:
    option = GuardOption.of(guard, **given)  # type: ignore[arg-type]
    return replace(base, options={**base.options, "guard": option.to_json()})


def drive(one: EpisodeSpec, *, record: bool = False) -> EpisodeResult:
    return BrinkDrive().run(one, record=record)


def test_an_episode_without_a_guard_keeps_its_hash() -> None:
    # Computed before episodes could have a guard, of the simulator of that time.
    digest = "965eed51e8b1cc099c2310aca8d22c4358976419bc5ed963c549e0cd7e4c2ac7"
    assert replace(spec(), simulator="brink-drive@2").digest() == digest
    assert spec().digest() != digest


def test_the_hash_covers_guard_threshold_fallback_and_every_setting() -> None:
    base = guarded(spec())
    others = [
        spec(),
        guarded(spec(), threshold=0.4),
        guarded(spec(), fallback="slow-down@1"),
        guarded(spec(), settings={"decel_mps2": 3.0}),
    ]

    assert len({one.digest() for one in (base, *others)}) == 5
    assert EpisodeSpec.from_json(base.to_json()).digest() == base.digest()
    assert guarded(spec(), settings={"decel_mps2": 4.0}).digest() == base.digest()


def test_a_guard_whose_fallback_does_nothing_leaves_the_drive_as_it_was() -> None:
    without, with_guard = drive(spec(), record=True), drive(guarded(spec(), fallback="none@1"), record=True)

    assert with_guard.verdicts == without.verdicts
    own = {name for name in with_guard.features if name.startswith("guard:")}
    assert {name: with_guard.features[name] for name in without.features} == dict(without.features)
    assert set(with_guard.features) - set(without.features) == own
    plain, watched = (Trace.from_bytes(one.trace or b"") for one in (without, with_guard))
    assert np.array_equal(plain.ego, watched.ego)
    assert plain.guard is None
    assert watched.guard is not None
    assert not watched.guard.intervenes.any()


def test_the_fallback_changes_the_drive_and_the_trace_says_when() -> None:
    result = drive(guarded(spec()), record=True)
    trace = Trace.from_bytes(result.trace or b"")
    guard = trace.guard

    assert guard is not None
    assert guard.fallback == "safe-stop@1"
    assert guard.probabilities.shape == (len(trace.time_s), 3)
    assert (np.diff(guard.probabilities, axis=1) >= 0).all()
    assert guard.alarm.any()
    began_s = result.features["guard:interventions_s"]
    assert isinstance(began_s, list)
    assert began_s
    first = int(np.flatnonzero(guard.intervenes)[0])
    assert float(trace.time_s[first]) == pytest.approx(float(str(began_s[0])), abs=0.051)
    assert trace.ego[first:, 3].min() < trace.ego[first, 3] - 1.0
    assert trace.to_bytes() == result.trace


def test_a_guarded_episode_is_the_same_bit_for_bit() -> None:
    one = guarded(spec(), fallback="slow-down@1")

    first = drive(one, record=True)
    drive(guarded(spec(seed=9)))
    second = drive(one, record=True)

    assert first.trace == second.trace
    assert first.features == second.features


@pytest.mark.parametrize("sensor", list(Sensor))
def test_a_fitted_guard_drives_with_the_sensor_that_it_needs(tmp_path: Path, sensor: Sensor) -> None:
    file = tmp_path / "guard.json"
    file.write_text(
        stump_guard(sensor=sensor, feature=feature_names(sensor)[-1], above=-1e4).to_json(), encoding="utf-8"
    )
    settings = {"speed_mps": 4.0}

    slow = drive(guarded(spec(), f"file:{file}", fallback="slow-down@1", settings=settings))
    deaf = drive(guarded(spec(), f"file:{file}", threshold=0.99, fallback="slow-down@1", settings=settings))

    # The stump takes a violation within three seconds for 98% likely, whatever the feature is, and confirms it in the
    # second step.
    assert slow.features["guard:alarms_s"] == [LATENCY_S + PERCEPTION_STEP_S]
    assert deaf.features["guard:alarms_s"] == []
    assert 0.97 < float(str(deaf.features["guard:peak"])) < 0.99
    assert float(str(slow.features["way_m"])) < 0.7 * float(str(deaf.features["way_m"]))
    assert deaf.verdicts == drive(spec()).verdicts


def test_a_drive_with_a_camera_may_have_a_guard() -> None:
    camera = replace(
        spec(),
        simulator="brink-drive-camera@3",
        duration_s=1.5,
        behaviour={"mode": "detector", "detector": "brink-det@2", "threshold": 0.5},
    )
    without, watched = (
        BrinkDriveCamera().run(one) for one in (camera, guarded(camera, "range-ttc@1", fallback="none@1"))
    )
    assert watched.verdicts == without.verdicts
    assert "guard:alarms_s" in watched.features


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ("ttc@1", r"options\.guard: expected an object"),
        ({"guard": "ttc@1"}, r"options\.guard\.fallback: expected an id"),
        ({"guard": "ttc@9", "fallback": "none@1"}, r"guard: expected one of .*ttc@1, file:FILE; got 'ttc@9'"),
        ({"guard": "ttc@1", "fallback": "none@1", "treshold": 1}, "did you mean 'threshold'"),
        (
            {"guard": "ttc@1", "fallback": "none@1", "threshold": 1.5},
            r"threshold: expected a number in \[0, 1\]",
        ),
        (
            {"guard": "ttc@1", "fallback": "none@1", "threshold": 0},
            r"threshold: expected a number in \(0, 1\]",
        ),
        ({"guard": "file:/dev/zero", "fallback": "none@1", "digest": "0"}, "/dev/zero: expected a file"),
        (
            {"guard": "ttc@1", "fallback": "slow-down@1", "settings": {"speed_mps": 99}},
            r"settings\.speed_mps",
        ),
        ({"guard": "file:/nowhere/guard.json", "fallback": "none@1", "digest": "0"}, "No such file"),
    ],
)
def test_a_malformed_guard_is_refused(option: Json, message: str) -> None:
    with pytest.raises(InvalidEpisode, match=message):
        drive(spec(options={"guard": option}))


def test_a_guard_file_that_has_changed_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "guard.json"
    file.write_text("{}", encoding="utf-8")
    option = {"guard": f"file:{file}", "fallback": "none@1", "digest": guard_digest(file)}
    file.write_text("{ }", encoding="utf-8")

    with pytest.raises(InvalidEpisode, match=r"options\.guard\.digest: expected that of the file"):
        drive(spec(options={"guard": dict(option)}))
