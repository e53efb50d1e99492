"""Features of a guard: hand-computed values, causality, and what they need to be imported."""

import math
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from brink.guard.features import FAR_M, MAX_TTC_S, NO_BOX_M, FeatureExtractor
from brink.guard.range_features import closing_mps
from brink.sim.driving.interface import (
    Box,
    Command,
    EgoState,
    LightReading,
    LightState,
    Observation,
    ObstacleLabel,
    PlanMode,
    PlanState,
)
from brink.sim.guard.interface import RANGE_M, RangeScan
from brink.sim.world.line import Piece, ReferenceLine
from brink.sim.world.road import LaneRoute

FOCAL_PX, CAMERA_M, BUMPER_M = 400.0, 1.7, 0.95
"""Of the camera: focal length, height above the ground, and how far the bumper is ahead of it."""
COAST = Command(accel_mps2=0.0, steer_rad=0.0)
CRUISE = PlanState(mode=PlanMode.CRUISE, target_speed_mps=8.0, target_offset_m=0.0)


def straight(*stop_lines_m: float) -> LaneRoute:
    return LaneRoute(
        line=ReferenceLine(0.0, 0.0, 0.0, (Piece(300.0),)),
        lane_width_m=3.5,
        speed_limit_mps=14.0,
        stop_line_stations_m=stop_lines_m,
        oncoming=(),
    )


def car_at(deep_m: float, *, lifted_px: float = 0.0, aside_m: float = 0.0) -> Box:
    """Return the box of the rear of a car, 1.5 m high and 1.8 m wide, at a depth from the camera."""
    base_px = 300.0 + FOCAL_PX * CAMERA_M / deep_m - lifted_px
    middle_px = 400.0 - FOCAL_PX * aside_m / deep_m
    half_px = 0.5 * FOCAL_PX * 1.8 / deep_m
    return Box(
        label=ObstacleLabel.VEHICLE,
        x_min_px=middle_px - half_px,
        x_max_px=middle_px + half_px,
        y_min_px=base_px - FOCAL_PX * 1.5 / deep_m,
        y_max_px=base_px,
    )


def observed(
    step: int, *boxes: Box, speed_mps: float = 8.0, station_m: float = 5.0, light: LightReading | None = None
) -> Observation:
    return Observation(
        time_s=0.1 * step,
        ego=EgoState(
            x_m=station_m,
            y_m=0.0,
            yaw_rad=0.0,
            speed_mps=speed_mps,
            accel_mps2=0.0,
            station_m=station_m,
            offset_m=0.0,
        ),
        boxes=boxes,
        light=light,
    )


def named(extractor: FeatureExtractor, *given: object) -> dict[str, float]:
    vector = extractor.step(*given)  # type: ignore[arg-type]
    assert np.isfinite(vector).all()
    return dict(zip(extractor.names, vector.tolist(), strict=True))


def about(value: float) -> object:
    return pytest.approx(value, rel=2e-3, abs=2e-3)  # half precision


def test_a_standing_car_ahead_is_consistent_and_has_the_time_to_collision_of_the_ego_speed() -> None:
    extractor = FeatureExtractor(straight())
    first = named(extractor, observed(0, car_at(20.0)), COAST, CRUISE)
    assert first["box_base_m"] == about(20.0 - BUMPER_M)
    assert first["box_size_m"] == about(20.0 - BUMPER_M)
    assert (first["vehicles"], first["persons"], first["boxes_in_path"], first["births_1s"]) == (1, 0, 1, 1)
    assert first["ttc_s"] == about((20.0 - BUMPER_M) / 8.0), "a new box is taken to stand"
    second = named(extractor, observed(1, car_at(19.2), station_m=5.8), COAST, CRUISE)
    assert second["box_base_over_size"] == about(0.0)
    assert second["box_speed_by_base_mps"] == about(0.0)
    assert second["box_speed_by_size_mps"] == about(0.0)
    assert second["box_ttc_by_base_s"] == about((19.2 - BUMPER_M) / 8.0)
    assert second["box_ttc_by_size_s"] == about(0.1 / math.log(20.0 / 19.2))
    assert second["box_needed_decel_mps2"] == about(64.0 / (2.0 * (19.2 - BUMPER_M)))
    assert second["box_age_s"] == about(0.1)
    assert second["births_1s"] == 1


def test_a_box_that_floats_is_inconsistent_with_the_ground() -> None:
    floating = named(FeatureExtractor(straight()), observed(0, car_at(20.0, lifted_px=60.0)), COAST, CRUISE)
    assert floating["box_base_m"] == FAR_M, "its base is above the horizon"
    assert floating["box_size_m"] == about(20.0 - BUMPER_M)
    assert floating["box_base_over_size"] == about(math.log((FAR_M + BUMPER_M) / 20.0))
    assert floating["most_inconsistent_1s"] == about(math.log((FAR_M + BUMPER_M) / 20.0))


def test_a_box_beside_the_path_is_relevant_only_if_none_is_in_it() -> None:
    beside, ahead = car_at(8.0, aside_m=4.0), car_at(20.0)
    alone = named(FeatureExtractor(straight()), observed(0, beside), COAST, CRUISE)
    assert (alone["box_in_path"], alone["boxes_in_path"], alone["ttc_s"]) == (0, 0, MAX_TTC_S)
    assert alone["box_lateral_m"] == about(4.0)
    both = named(FeatureExtractor(straight()), observed(0, beside, ahead), COAST, CRUISE)
    assert (both["box_in_path"], both["vehicles"]) == (1, 2)
    assert both["box_base_m"] == about(20.0 - BUMPER_M)


def test_births_and_deaths_are_counted_and_near_ones_are_sudden() -> None:
    extractor = FeatureExtractor(straight())
    named(extractor, observed(0), COAST, CRUISE)
    born = named(extractor, observed(1, car_at(10.0), car_at(60.0, aside_m=20.0)), COAST, CRUISE)
    assert (born["births_3s"], born["sudden_births_3s"], born["deaths_3s"]) == (2, 1, 0)
    gone = named(extractor, observed(2), COAST, CRUISE)
    assert (gone["deaths_3s"], gone["sudden_deaths_3s"], gone["box_base_m"]) == (2, 1, NO_BOX_M)
    later = [named(extractor, observed(step), COAST, CRUISE) for step in range(3, 40)]
    assert later[9]["births_1s"] == 0, "more than a second ago"
    assert later[9]["births_3s"] == 2
    assert later[-1]["births_3s"] == later[-1]["sudden_deaths_3s"] == 0
    assert later[-1]["since_box_s"] == about(3.8)


def test_the_stop_line_is_read_from_the_map_and_the_light_as_reported() -> None:
    extractor = FeatureExtractor(straight(60.0))
    red = LightReading(state=LightState.RED, stop_line_station_m=60.0)
    first = named(extractor, observed(0), COAST, CRUISE)
    assert (first["light"], first["light_reported"]) == (-1, 0)
    assert first["line_m"] == about(60.0 - 7.25)
    assert first["line_needed_decel_mps2"] == about(64.0 / (2.0 * 52.75))
    second = named(extractor, observed(1, light=red), COAST, CRUISE)
    assert (second["light"], second["light_changes_3s"], second["light_red_3s"]) == (2, 1, about(0.5))
    assert named(FeatureExtractor(straight()), observed(0), COAST, CRUISE)["line_m"] == 80.0


def test_features_depend_on_the_past_alone() -> None:
    rng = np.random.default_rng(4)
    moments = [
        observed(
            step,
            car_at(float(rng.uniform(5, 60)), aside_m=float(rng.normal())),
            speed_mps=float(rng.uniform(0, 9)),
        )
        for step in range(80)
    ]
    scans = [RangeScan(distances_m=tuple(rng.uniform(3, 60, 5).tolist())) for _ in moments]

    def rows(count: int, spoiled: bool) -> list[list[float]]:
        extractor = FeatureExtractor(straight(90.0), ranges=True)
        later = [(observed(step), RangeScan(distances_m=(1.0,) * 5)) for step in range(count, 80)]
        given = [*zip(moments, scans, strict=True)][:count] + (later if spoiled else [])
        return [extractor.step(moment, COAST, CRUISE, scan).tolist() for moment, scan in given]

    assert rows(50, spoiled=True)[:50] == rows(50, spoiled=False) == rows(80, spoiled=False)[:50]


def test_most_features_forget_after_three_seconds() -> None:
    def last(*early: Box) -> dict[str, float]:
        extractor = FeatureExtractor(straight())
        for step in range(5):
            named(extractor, observed(step, *early), COAST, CRUISE)
        for step in range(5, 40):
            found = named(extractor, observed(step), COAST, CRUISE)
        return found

    before, after = last(), last(car_at(12.0))
    assert {name for name in before if before[name] != after[name]} == {"since_box_s", "since_in_path_s"}


def test_boxes_without_an_extent_are_left_out() -> None:
    broken = car_at(20.0)._replace(y_min_px=math.nan)
    flat = car_at(20.0)._replace(x_max_px=0.0)
    found = named(FeatureExtractor(straight()), observed(0, broken, flat), COAST, CRUISE)
    assert (found["vehicles"], found["box_base_m"]) == (0, NO_BOX_M)


def test_a_step_without_boxes_is_refused() -> None:
    between = replace(observed(0), boxes=None)
    with pytest.raises(ValueError, match="perception step"):
        FeatureExtractor(straight()).step(between, COAST)


def test_the_range_in_the_path_gives_closing_speed_and_time_to_collision() -> None:
    extractor = FeatureExtractor(straight(), ranges=True)
    for step in range(11):
        ahead_m = 30.0 - 0.8 * step
        scan = RangeScan(distances_m=(math.inf, math.inf, ahead_m, math.inf, 5.0))
        found = named(extractor, observed(step, station_m=5.0 + 0.8 * step), COAST, CRUISE, scan)
    assert found["range_path_m"] == about(22.0)
    assert found["range_path_closing_mps"] == about(8.0)
    assert found["range_path_ttc_s"] == about(22.0 / 8.0)
    assert found["range_path_needed_decel_mps2"] == about(64.0 / (2.0 * 20.5))
    assert found["range_path_speed_mps"] == about(0.0), "what is ahead stands"
    assert found["range_unreported_m"] == about(RANGE_M - 22.0)
    assert found["range_least_m"] == 5, "something is beside the path"


def test_drop_outs_are_bridged_for_half_a_second() -> None:
    extractor = FeatureExtractor(straight(), ranges=True)
    seen = RangeScan(distances_m=(math.inf, math.inf, 20.0, math.inf, math.inf))
    lost = RangeScan(distances_m=(math.nan,) * 5)
    ranges = [
        named(extractor, observed(step), COAST, CRUISE, scan)["range_2_m"]
        for step, scan in enumerate([seen, *[lost] * 6])
    ]
    assert ranges == [20.0] * 6 + [RANGE_M]
    assert (
        named(FeatureExtractor(straight(), ranges=True), observed(0), COAST, CRUISE)["range_path_m"]
        == RANGE_M
    )


def test_a_scan_of_another_sensor_is_refused() -> None:
    with pytest.raises(ValueError, match="5 sectors"):
        FeatureExtractor(straight(), ranges=True).step(
            observed(0), COAST, CRUISE, RangeScan(distances_m=(1.0,))
        )


@pytest.mark.parametrize(
    ("distances_m", "expected"),
    [
        ([20.0, 19.0, 18.0, 17.0], 10.0),
        ([10.0, 10.5, 11.0], -5.0),
        ([50.0, 12.0, 11.0, 10.0], 10.0),
        ([12.0, 11.0], 0.0),
        ([60.0, 60.0, 60.0], 0.0),
    ],
)
def test_closing_speed_is_the_slope_since_the_last_jump(distances_m: list[float], expected: float) -> None:
    assert closing_mps(distances_m) == pytest.approx(expected)


def test_a_guard_needs_numpy_alone() -> None:
    program = "import sys; import brink.guard.monitor; print(*{one.split('.')[0] for one in sys.modules})"
    loaded = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=60
    ).stdout.split()
    assert "numpy" in loaded
    assert not {"scipy", "sklearn", "pandas", "pydantic", "pybullet", "sqlalchemy", "torch", "yaml"} & {
        *loaded
    }
