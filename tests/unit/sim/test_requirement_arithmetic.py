"""Known robustness values of each requirement on hand-made samples."""

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from brink.sim.driving.interface import LightState
from brink.sim.requirements import (
    Collision,
    CollisionKind,
    FrontGap,
    LaneKeeping,
    MovingFrontGap,
    NoCollision,
    Progress,
    RedLight,
    Requirement,
    SpeedLimit,
    WorldSample,
)

CALM = WorldSample(
    time_s=0.0, x_m=0.0, y_m=0.0, yaw_rad=0.0, speed_mps=8.0, station_m=0.0, offset_m=0.0, heading_error_rad=0.0,
    ego_length_m=4.5, ego_width_m=1.8, lane_left_m=1.75, lane_right_m=-1.75, speed_limit_mps=8.33,
)  # fmt: skip


def observe_gaps(requirement: Requirement, *gaps_m: float | None) -> list[float]:
    return [
        requirement.observe(replace(CALM, time_s=0.05 * step, front_gap_m=gap_m))
        for step, gap_m in enumerate(gaps_m)
    ]


def observe_lights(requirement: Requirement, *steps: tuple[LightState | None, float | None]) -> list[float]:
    return [
        requirement.observe(replace(CALM, time_s=0.05 * step, light=light, stop_line_gap_m=gap_m))
        for step, (light, gap_m) in enumerate(steps)
    ]


def test_front_gap_robustness_is_the_gap_minus_one_and_a_half_metres() -> None:
    requirement = FrontGap()
    assert observe_gaps(requirement, None, 10.0, 1.5, 1.0, 0.0, 4.0) == [50.0, 8.5, 0.0, -0.5, -1.5, 2.5]
    verdict = requirement.verdict()
    assert (verdict.robustness, verdict.unit) == (-1.5, "m")
    assert verdict.violated_at_s == pytest.approx(0.15)
    assert requirement.features() == {"smallest_front_gap_m": 0.0}


def test_a_standing_ego_does_not_violate_the_front_gap() -> None:
    requirement = MovingFrontGap()
    moving_m = [
        requirement.observe(replace(CALM, time_s=0.05 * step, front_gap_m=gap_m, speed_mps=speed_mps))
        for step, (gap_m, speed_mps) in enumerate(
            [(4.0, 0.0), (1.0, 0.29), (None, 0.0), (1.0, -0.4), (1.0, 0.3)]
        )
    ]
    assert moving_m == [2.5, 0.0, 50.0, -0.5, -0.5]
    assert requirement.verdict().violated_at_s == pytest.approx(0.15)
    assert requirement.features() == {"smallest_front_gap_m": 1.0}


def test_a_gap_of_exactly_one_and_a_half_metres_satisfies() -> None:
    requirement = FrontGap()
    observe_gaps(requirement, 1.5)
    assert not requirement.verdict().violated
    assert requirement.verdict().violated_at_s is None


@given(gaps_m=st.lists(st.none() | st.floats(0.0, 1e6), min_size=1, max_size=30))
def test_a_verdict_is_violated_if_and_only_if_a_robustness_was_negative(gaps_m: list[float | None]) -> None:
    requirement = FrontGap()
    series = observe_gaps(requirement, *gaps_m)
    verdict = requirement.verdict()
    assert verdict.robustness == min(series)
    assert verdict.violated == any(value < 0 for value in series) == (verdict.violated_at_s is not None)
    assert all(math.isfinite(value) for value in series)


def test_a_harder_impact_is_a_deeper_violation() -> None:
    def robustness(impact_mps: float) -> float:
        requirement = NoCollision()
        hit = Collision(
            kind=CollisionKind.PEDESTRIAN, counterpart="pedestrian-3", impact_speed_mps=impact_mps
        )
        requirement.observe(replace(CALM, nearest_gap_m=2.0))
        requirement.observe(replace(CALM, time_s=0.05, nearest_gap_m=0.0, collision=hit))
        assert requirement.features() == {
            "collision_with": "pedestrian-3",
            "collision_kind": "pedestrian",
            "impact_speed_mps": impact_mps,
        }
        assert requirement.verdict().violated_at_s == 0.05
        return requirement.verdict().robustness

    assert robustness(0.0) == pytest.approx(-0.01)
    assert robustness(6.0) == pytest.approx(-0.61)


def test_contact_without_a_collision_of_the_ego_satisfies() -> None:
    requirement = NoCollision()
    assert requirement.observe(replace(CALM, nearest_gap_m=0.0)) == 0.0
    assert not requirement.verdict().violated


def test_lane_keeping_measures_the_outermost_corner() -> None:
    requirement = LaneKeeping(tolerance_m=0.0)
    assert requirement.observe(CALM) == pytest.approx(1.75 - 0.9)
    assert requirement.observe(replace(CALM, offset_m=1.0)) == pytest.approx(-0.15)
    assert requirement.observe(replace(CALM, offset_m=-1.0)) == pytest.approx(-0.15)
    turned = 0.9 * math.cos(0.2) + 2.25 * math.sin(0.2)
    assert requirement.observe(replace(CALM, heading_error_rad=-0.2)) == pytest.approx(1.75 - turned)


RED, AMBER, GREEN = LightState.RED, LightState.AMBER, LightState.GREEN


def test_stopping_before_the_line_at_red_satisfies() -> None:
    requirement = RedLight()
    series = observe_lights(requirement, (None, None), (RED, 30.0), (RED, 5.0), (RED, 0.8), (RED, 0.0))
    assert series == [10.0, 10.0, 5.0, 0.8, 0.0]
    assert not requirement.verdict().violated


def test_running_a_red_light_is_violated_by_the_overrun() -> None:
    requirement = RedLight()
    series = observe_lights(requirement, (RED, 0.3), (RED, -0.1), (RED, -0.5), (RED, -2.0), (None, None))
    assert series == [0.3, -0.1, -0.5, -2.0, 10.0]
    assert requirement.verdict().violated_at_s == 0.05


def test_passing_at_amber_satisfies_even_if_the_light_turns_red_meanwhile() -> None:
    requirement = RedLight()
    observe_lights(requirement, (AMBER, 0.3), (AMBER, -0.1), (RED, -0.5), (RED, -2.0))
    assert not requirement.verdict().violated


def test_starting_past_the_stop_line_does_not_violate() -> None:
    requirement = RedLight()
    observe_lights(requirement, (RED, -1.0), (RED, -2.0))
    assert not requirement.verdict().violated


def test_consecutive_lights_are_evaluated_separately() -> None:
    requirement = RedLight()
    observe_lights(requirement, (GREEN, 0.2), (GREEN, -0.2), (RED, 40.0), (RED, 0.2), (RED, -0.2))
    assert requirement.verdict().robustness == pytest.approx(-0.2)
    assert requirement.verdict().violated_at_s == pytest.approx(0.2)


def test_speed_limit_robustness_includes_the_speedometer_tolerance() -> None:
    requirement = SpeedLimit()
    assert requirement.observe(replace(CALM, speed_mps=8.33)) == pytest.approx(0.5)
    assert requirement.observe(replace(CALM, speed_mps=9.83)) == pytest.approx(-1.0)
    assert requirement.verdict().unit == "m/s"


def stand(requirement: Progress, seconds: int, **facts: bool) -> list[float]:
    return [
        requirement.observe(
            replace(
                CALM,
                time_s=float(second),
                speed_mps=0.0,
                may_wait=facts.get("may_wait", False),
                in_conflict_area=facts.get("in_conflict_area", False),
                goal_reached=facts.get("goal_reached", False),
            )
        )
        for second in range(seconds + 1)
    ]


def test_standing_still_without_a_cause_violates_after_ten_seconds() -> None:
    requirement = Progress()
    series = stand(requirement, 12)
    assert series == [10.0 - second for second in range(13)]
    assert requirement.verdict().violated_at_s == 11.0
    assert requirement.features()["longest_idle_s"] == 12.0


def test_standing_still_in_a_conflict_area_violates_after_four_seconds() -> None:
    requirement = Progress()
    stand(requirement, 5, in_conflict_area=True)
    assert requirement.verdict().robustness == -1.0
    assert requirement.features()["longest_dangerous_stop_s"] == 5.0


@pytest.mark.parametrize("cause", ["may_wait", "goal_reached"])
def test_standing_still_with_a_cause_satisfies(cause: str) -> None:
    requirement = Progress()
    stand(requirement, 25, in_conflict_area=True, **{cause: True})
    assert not requirement.verdict().violated


def test_moving_again_resets_the_standstill_timer() -> None:
    requirement = Progress()
    stand(requirement, 8)
    assert requirement.observe(replace(CALM, time_s=9.0)) == 10.0
    assert requirement.verdict().robustness == 2.0


def test_a_sample_with_a_nan_is_rejected() -> None:
    with pytest.raises(ValueError, match="NaN"):
        FrontGap().observe(replace(CALM, front_gap_m=math.nan))


def test_robustness_is_clipped_to_the_horizon() -> None:
    requirement = SpeedLimit()
    assert requirement.observe(replace(CALM, speed_mps=1e6)) == -requirement.horizon
