"""Errors of a recorded detector: fitted as a process, drawn, and driven in the simulator."""

import copy
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
import yaml

from brink.recordings.choices import TYPES
from brink.recordings.fit_errors import FEWEST_DRIVES, fit_errors
from brink.recordings.recording import RecordingError
from brink.report.errors import campaign_yaml, error_rows, error_sentences, errors_yaml
from brink.search.errors import ConfigError
from brink.search.streams import episode_seed
from brink.server.campaigns.body import CampaignBody
from brink.server.documents import parse_yaml
from brink.server.problems.urban_camera import UrbanCamera, UrbanCameraParams
from brink.server.problems.urban_fitted import UrbanFitted, UrbanFittedParams
from brink.sim.driving.camera import Camera
from brink.sim.driving.interface import Box, ObstacleLabel
from brink.sim.episode import EpisodeResult, EpisodeSpec
from brink.sim.urban.detection_errors import Target
from brink.sim.urban.error_draws import RoadUserErrors, bin_of, group_of
from brink.sim.urban.error_meter import ErrorMeter, ReportedBox, Sample, TrueBox
from brink.sim.urban.error_process import (
    AT_ONCE,
    EDGES_M,
    FOUND,
    FOUND_FIRST,
    GROUPS,
    LOST,
    SCORES,
    SEEN,
    WRONG_LABEL,
    ErrorProcess,
    FittedErrors,
)
from brink.sim.urban.fitted_detector import BrinkDriveFitted, with_errors
from brink.sim.urban.simulator import BrinkDriveErrors

LABELS = {"lead": ObstacleLabel.VEHICLE, "vehicle": ObstacleLabel.VEHICLE, "pedestrian": ObstacleLabel.PERSON}
STEPS = 300
NEAR, FAR = 15.0, 50.0


def known() -> ErrorProcess:
    """Return a process whose errors differ by group and distance."""
    process = ErrorProcess.perfect()
    for group in range(len(GROUPS)):
        for row in range(len(EDGES_M)):
            worse = 1.0 + 0.3 * group + 0.2 * row
            process.shares[group, row, SEEN] = 0.8
            process.shares[group, row, AT_ONCE] = 0.6 / worse
            process.shares[group, row, FOUND_FIRST] = 0.3 / worse
            process.shares[group, row, FOUND : FOUND + 3] = np.array([0.5, 0.3, 0.1]) / worse
            process.shares[group, row, LOST : LOST + 3] = np.array([0.2, 0.06, 0.03]) * worse
            process.shares[group, row, WRONG_LABEL] = 0.1
            process.errors[group, row] = worse * np.outer([0.1, 0.4, 0.05], SCORES) + 0.02 * row
        process.kept[group] = [0.8, 0.5, 0.2, 0.7, 0.0, 0.3, 0.6]
    return process


@cache
def sampled(seed: int, users: int) -> tuple[Sample, ...]:
    """Return what the known process reports in half a minute, in the order of time."""
    process, samples = known(), list[Sample]()
    for track in range(users):
        name = GROUPS[track % 3]
        label, depth_m = LABELS[name], NEAR if track % 2 else FAR
        draws = RoadUserErrors(process, seed=seed, index=track, steps=STEPS)
        for step in range(STEPS):
            if track >= 3 and step % 60 < 8:
                continue
            drawn = draws.at(step, group_of(label, is_target=name == "lead"), depth_m)
            sample = Sample(
                0.1 * step, track, Target.LEAD, name == "lead", True, label, depth_m, drawn is not None
            )
            samples.append(sample if drawn is None else sample._replace(**drawn._asdict()))
    return tuple(sorted(samples, key=lambda sample: sample.time_s))


def recorded(seed: int, users: int = 12) -> ErrorMeter:
    """Return a drive of half a minute in which the known process reports road users that come and go."""
    meter = ErrorMeter(Camera(), is_excerpt=True)
    meter.samples = [*sampled(seed, users)]
    ghosts = {
        step: frozenset({ObstacleLabel.PERSON}) for start in (40, 140) for step in range(start, start + 5)
    }
    meter.ghosts = [(0.1 * step, ghosts.get(step, frozenset())) for step in range(STEPS)]
    return meter


@cache
def fitted(drives: int = 8, **more: Any) -> FittedErrors:
    return fit_errors([recorded(seed) for seed in range(drives)], "mine", **more)


def test_a_fit_to_draws_of_a_known_process_gives_it_back() -> None:
    found, true = fitted(60, replicates=0).process, known()
    for group in range(len(GROUPS)):
        for row in (bin_of(NEAR), bin_of(FAR)):
            own, expected = found.shares[group, row], true.shares[group, row]
            for column in (AT_ONCE, FOUND_FIRST, FOUND, FOUND + 1, LOST, LOST + 1, LOST + 2, WRONG_LABEL):
                assert own[column] == pytest.approx(expected[column], rel=0.15, abs=0.03), (
                    group,
                    row,
                    column,
                )
            assert found.errors[group, row] == pytest.approx(true.errors[group, row], rel=0.12, abs=0.08)
        assert found.kept[group] == pytest.approx(true.kept[group], abs=0.1)
    assert found.ghosts[0].tolist() == [0.0] * 6
    assert found.ghosts[1] == pytest.approx([240.0, 0.5, 0.5, 0.5, 0.5, 0.5])


def test_images_at_half_the_rate_are_fitted_by_time_and_not_by_number() -> None:
    meters = [recorded(seed) for seed in range(60)]
    for meter in meters:
        times = [time_s for time_s, _ in meter.ghosts][::2]
        meter.ghosts = meter.ghosts[::2]
        kept = set(times)
        meter.samples = [sample for sample in meter.samples if sample.time_s in kept]
    found, true = fit_errors(meters, "mine", replicates=0).process, known()
    for group in range(len(GROUPS)):
        for row in (bin_of(NEAR), bin_of(FAR)):
            # A miss that begins and ends between two images is not seen, so that rates are lower, but not by age.
            ratio = found.shares[group, row, LOST + 1] / found.shares[group, row, LOST + 2]
            assert ratio == pytest.approx(
                true.shares[group, row, LOST + 1] / true.shares[group, row, LOST + 2], rel=0.2
            )
        assert found.kept[group] == pytest.approx(true.kept[group], abs=0.12)


def test_images_at_twice_the_rate_are_fitted_alike() -> None:
    once = [recorded(seed) for seed in range(FEWEST_DRIVES)]
    twice = [recorded(seed) for seed in range(FEWEST_DRIVES)]
    for meter in twice:
        meter.samples = [
            sample._replace(time_s=sample.time_s + later) for sample in meter.samples for later in (0.0, 0.05)
        ]
        meter.samples.sort(key=lambda sample: sample.time_s)
        meter.ghosts = [(time_s + later, labels) for time_s, labels in meter.ghosts for later in (0.0, 0.05)]
    assert fit_errors(once, "mine").to_document() == fit_errors(twice, "mine").to_document()


def test_lives_that_the_recording_cuts_off_do_not_count_as_reported_late() -> None:
    meters = [recorded(seed, users=3) for seed in range(FEWEST_DRIVES)]
    for meter in meters:  # in sight from the first image to the last, and never reported
        meter.samples = [sample._replace(is_seen=False) for sample in meter.samples]
    found = fit_errors(meters, "mine")
    assert found.rests_on[:, :, [AT_ONCE, FOUND_FIRST]].sum() == 0
    assert found.process.shares[0, bin_of(FAR), SEEN] == 0.0
    assert found.process.shares[0, bin_of(FAR), FOUND + 2] == 0.0
    assert found.rests_on[0, bin_of(FAR), FOUND + 2] == FEWEST_DRIVES * (STEPS - 1)


def test_bins_without_samples_are_as_those_with_some() -> None:
    found = fitted()
    lead, vehicle = found.process.shares[:2]
    assert lead[bin_of(NEAR), LOST] != vehicle[bin_of(NEAR), LOST]
    assert lead[0] == pytest.approx(vehicle[0])
    assert lead[0, LOST] == pytest.approx(found.process.shares[:2, :, LOST].mean(), rel=0.4)
    assert found.rests_on[0, 0].tolist() == [0.0] * 10


def perfect_meter(seed: int) -> ErrorMeter:
    """Return a drive in which true boxes and reported boxes are the same."""
    meter, camera = ErrorMeter(Camera(), is_excerpt=True), Camera()
    for step in range(100):
        depth_m = 8.0 + 0.3 * step + seed
        bottom = camera.horizon_px + camera.focal_px * camera.height_m / depth_m
        boxes = [
            Box(label, x_px, x_px + 900.0 / depth_m, bottom - 600.0 / depth_m, bottom)
            for label, x_px in ((ObstacleLabel.VEHICLE, 380.0), (ObstacleLabel.PERSON, 500.0))
        ]
        truth = [TrueBox(i, box, (Target.LEAD, Target.PEDESTRIAN)[i], True) for i, box in enumerate(boxes)]
        meter.see(0.1 * step, truth if step > 10 else truth[:1], [ReportedBox(one.box) for one in truth])
    return meter


def test_a_perfect_detector_drives_as_the_truth_bit_for_bit() -> None:
    found = fit_errors([perfect_meter(seed) for seed in range(FEWEST_DRIVES)], "perfect", without=("ghosts",))
    assert found.process.to_json() == ErrorProcess.perfect().to_json()
    problem = UrbanFitted(UrbanFittedParams(errors=found.to_document(), duration_s=8.0))
    true = problem.with_truth()
    assert true is not None
    rng = np.random.default_rng(3)
    for seed in (1, 2):
        vectors = problem.space.sample(rng)
        driven = BrinkDriveFitted().run(problem.episode(vectors, seed))
        expected = BrinkDriveErrors().run(true.episode(vectors, seed))
        assert driven.verdicts == expected.verdicts
        assert driven.objectives == expected.objectives
        assert driven.features["way_m"] == expected.features["way_m"]


def driven(spec: EpisodeSpec) -> EpisodeResult:
    return BrinkDriveFitted().run(spec)


def test_episodes_draw_by_their_seed_and_never_by_what_was_driven_before() -> None:
    problem = UrbanFitted(UrbanFittedParams(errors=fitted().to_document(), duration_s=8.0))
    vectors = problem.space.sample(np.random.default_rng(1))
    spec, other = problem.episode(vectors, 5), problem.episode(vectors, 6)
    first = driven(spec)
    driven(other)
    again = driven(spec)
    assert (first.verdicts, first.features) == (again.verdicts, again.features)
    assert first.features["measured_errors"] != driven(replace(spec, seed=7)).features["measured_errors"]
    short = RoadUserErrors(known(), seed=1, index=2, steps=40)
    long = RoadUserErrors(known(), seed=1, index=2, steps=400)
    assert [short.at(step, 0, NEAR) for step in range(40)] == [long.at(step, 0, NEAR) for step in range(40)]


def test_replicates_are_drawn_by_the_episodes_seed_and_are_part_of_the_episode() -> None:
    found = fitted()
    problem = UrbanFitted(UrbanFittedParams(errors=found.to_document()))
    vectors = problem.space.sample(np.random.default_rng(1))
    specs = [problem.episode(vectors, episode_seed(3, number)) for number in range(300)]
    assert {spec.behaviour["replicate"] for spec in specs} == set(range(len(found.replicates)))
    assert specs[0].behaviour["process"] == found.replicates[problem.replicate(specs[0].seed)].to_json()
    edited = found.to_document() | {"replicates": []}
    point = UrbanFitted(UrbanFittedParams(errors=edited)).episode(vectors, specs[0].seed)
    assert point.behaviour["process"] == found.process.to_json()
    assert point.digest() != specs[0].digest()


def test_the_same_drives_are_driven_as_with_a_camera() -> None:
    fit, camera = UrbanFitted(UrbanFittedParams()), UrbanCamera(UrbanCameraParams())
    vectors = fit.space.sample(np.random.default_rng(1))
    one, other = fit.episode(vectors, 1), camera.episode(vectors, 1)
    assert (one.scenario, one.requirements, one.seed) == (other.scenario, other.requirements, other.seed)


def test_boxes_get_the_errors_that_the_meter_measures() -> None:
    camera = Camera()
    box = Box(ObstacleLabel.VEHICLE, 380.0, 440.0, 300.0, 350.0)
    depth_m = camera.ground_depth_m(box.y_max_px)
    assert depth_m is not None
    wrong = with_errors(camera, box, depth_m, 0.1, 0.2, -0.05)
    assert wrong is not None
    meter = ErrorMeter(camera)
    meter.see(0.0, [TrueBox(0, box, Target.LEAD, True)], [ReportedBox(wrong)])
    sample = meter.samples[0]
    assert (sample.far, sample.right_m, sample.size) == pytest.approx((0.1, 0.2, -0.05))
    assert with_errors(camera, box, depth_m, 0.0, 0.0, 0.0) is box


@pytest.mark.parametrize("name", TYPES)
def test_a_type_of_error_can_be_left_out(name: str) -> None:
    found, all_of_it = fitted(without=(name,)), fitted()
    assert found.without == (name,)
    process, whole, true = found.process, all_of_it.process, ErrorProcess.perfect()
    parts = {
        "misses": (process.shares[:, :, LOST], true.shares[:, :, LOST]),
        "delays": (process.shares[:, :, AT_ONCE], true.shares[:, :, AT_ONCE]),
        "labels": (process.shares[:, :, WRONG_LABEL], true.shares[:, :, WRONG_LABEL]),
        "places": (process.errors, true.errors),
        "ghosts": (process.ghosts, true.ghosts),
    }
    assert (parts[name][0] == parts[name][1]).all()
    others = [part for other, part in parts.items() if other != name]
    assert not any((mine == without).all() for mine, without in others)
    assert whole.to_json() != process.to_json()


def test_what_the_recording_does_not_have_is_said() -> None:
    meters = [recorded(seed) for seed in range(FEWEST_DRIVES)]
    for meter in meters:
        meter.samples = [sample for sample in meter.samples if sample.label is ObstacleLabel.VEHICLE]
    found = fit_errors(meters, "mine")
    assert found.unknown == ["pedestrian"]
    assert (found.process.shares[2] == ErrorProcess.perfect().shares[2]).all()
    words = " ".join(error_sentences(found))
    assert "No pedestrian in the recording" in words
    assert "as a vehicle, in 0.04 h: with 95% confidence fewer than 72 an hour" in words
    assert [row[:2] for row in error_rows(found)] == [
        (group, distance) for group in ("lead", "vehicle") for distance in ("10 to 20 m", "45 to 60 m")
    ]


def test_replicates_never_take_what_is_in_few_drives_for_perfect() -> None:
    meters = [recorded(seed) for seed in range(FEWEST_DRIVES)]
    for meter in meters[1:]:
        meter.samples = [sample for sample in meter.samples if sample.label is ObstacleLabel.VEHICLE]
    found = fit_errors(meters, "mine")
    for one in found.replicates:
        assert one.shares[2, bin_of(FAR), SEEN] < 0.9
        assert np.ptp(one.errors[2, bin_of(FAR), 0]) > 0.3
    seen = [one.shares[0, bin_of(FAR), SEEN] for one in found.replicates]
    assert 0.005 < np.std(seen) < 0.1


def test_too_little_is_refused() -> None:
    with pytest.raises(RecordingError, match=f"at least {FEWEST_DRIVES} drives.*got 2"):
        fitted(2)
    meters = [recorded(seed) for seed in range(FEWEST_DRIVES)]
    for meter in meters:
        meter.samples = []
    with pytest.raises(RecordingError, match="visible road users"):
        fit_errors(meters, "mine")


def test_the_files_can_be_read_back() -> None:
    found = fitted()
    document = parse_yaml(errors_yaml(found))
    assert FittedErrors.from_document("errors", document).to_document() == document
    body = CampaignBody.model_validate(yaml.safe_load(campaign_yaml(found, 2000, 1)))
    assert body.problem.params["errors"] == document
    assert body.budget.simulations == 2000


def edited(change: Callable[[dict[str, Any]], object]) -> dict[str, Any]:
    document: dict[str, Any] = copy.deepcopy(fitted(FEWEST_DRIVES, replicates=2).to_document())
    change(document)
    return document


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.pop("format"), "errors.format: missing"),
        (lambda d: d.update(format="brink-errors@9"), "expected brink-errors@1, got 'brink-errors@9'"),
        (lambda d: d.update(extra=1), "unknown field 'extra'"),
        (lambda d: d["lead"]["bins"].pop(), "expected 6 bins of distance"),
        (lambda d: d["lead"]["bins"][0].update(seen=1.5), r"shares: expected numbers in \[0, 1\], got 1.5"),
        (lambda d: d["lead"]["bins"][0].update(seen="x"), r"errors.lead.bins\[0\].seen: expected a number"),
        (lambda d: d["lead"]["bins"][1].update(from_m=12.0), "from_m: expected 10, got 12"),
        (
            lambda d: d["vehicle"]["bins"][1].update(far=[0.3, 0.2, 0.3, 0.4, 0.5]),
            "far: expected quantiles that",
        ),
        (lambda d: d["vehicle"]["bins"][1].update(far=[0.3]), "far: expected 5 numbers"),
        (lambda d: d["ghosts"]["person"].update(per_hour=float("nan")), "per_hour: expected a number"),
        (lambda d: d["replicates"][0].pop(), r"replicates\[0\]: expected 483 numbers.*got 482"),
        (lambda d: d["replicates"][1].__setitem__(3, True), r"replicates\[1\]\[3\]: expected a number"),
        (lambda d: d.update(replicates=d["replicates"] * 40), "at most 50"),
    ],
)
def test_a_document_that_cannot_be_is_refused(
    change: Callable[[dict[str, Any]], object], message: str
) -> None:
    with pytest.raises(ConfigError, match=message):
        UrbanFittedParams(errors=edited(change))
