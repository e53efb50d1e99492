import math

import pytest
from driving_loop import road
from hypothesis import given
from hypothesis import strategies as st

from brink.sim.driving.interface import LightReading, LightState
from brink.sim.driving.longitudinal import (
    NO_LIMIT_MPS2,
    SpeedProfile,
    TrafficLightLaw,
    follow_accel,
    stop_accel,
)
from brink.sim.driving.settings import FollowSettings, LightSettings, SpeedSettings
from brink.sim.world.line import Piece

FOLLOW = FollowSettings()
RED, GREEN = LightState.RED, LightState.GREEN
speeds = st.floats(0.0, 20.0)
gaps = st.floats(-5.0, 100.0)


@given(speed=speeds, gap=gaps, other=st.floats(-20.0, 20.0))
def test_the_gap_law_is_bounded(speed: float, gap: float, other: float) -> None:
    accel = follow_accel(FOLLOW, speed, gap, other)
    assert -FOLLOW.max_decel_mps2 <= accel <= FOLLOW.accel_mps2


@given(speed=st.floats(0.5, 15.0), gap=st.floats(0.2, 80.0), more=st.floats(0.0, 20.0), other=speeds)
def test_a_wider_gap_never_requires_more_braking(speed: float, gap: float, more: float, other: float) -> None:
    near, far = follow_accel(FOLLOW, speed, gap, other), follow_accel(FOLLOW, speed, gap + more, other)
    assert far >= near - 1e-9


def test_the_speed_is_constant_at_the_desired_gap_behind_an_equally_fast_vehicle() -> None:
    wanted_m = FOLLOW.standstill_gap_m + FOLLOW.time_gap_s * 7.0
    assert follow_accel(FOLLOW, 7.0, wanted_m, 7.0) == pytest.approx(0.0, abs=1e-12)


def test_a_late_obstacle_is_an_emergency() -> None:
    # 64 / (2 (9 - 2.5)) = 4.9 m/s^2 are needed to stop 2.5 m before it.
    needed = 64.0 / (2.0 * (9.0 - FOLLOW.reserve_gap_m))
    assert follow_accel(FOLLOW, 8.0, 9.0, 0.0) == pytest.approx(-FOLLOW.emergency_factor * needed)


def test_stopping_follows_the_braking_parabola() -> None:
    assert stop_accel(2.0, 2.0, 8.0, 16.0) == pytest.approx(-2.0)
    assert stop_accel(2.0, 2.0, 8.0, 60.0) > 5.0
    assert stop_accel(2.0, 2.0, 8.0, 4.0) < -9.0
    assert stop_accel(2.0, 2.0, 0.0, -1.0) < 0.0


def accel_at(
    law: TrafficLightLaw, state: LightState | None, to_line_m: float, speed: float = 8.0, t: float = 0
) -> float:
    reading = None if state is None else LightReading(state=state, stop_line_station_m=100.0)
    return law.accel(t, reading, 100.0 - to_line_m, speed)


@pytest.mark.parametrize(
    ("state", "to_line_m", "stops"),
    [
        (LightState.GREEN, 10.0, False),
        (LightState.AMBER, 15.0, True),  # 64 / 30 = 2.1 m/s^2: comfortable
        (LightState.AMBER, 10.0, False),  # 3.2 m/s^2: too hard, so the ego continues
        (LightState.RED, 10.0, True),
        (LightState.RED, 4.0, False),  # 8 m/s^2: impossible
    ],
)
def test_the_decision_to_stop_in_the_dilemma_zone(state: LightState, to_line_m: float, stops: bool) -> None:
    assert (accel_at(TrafficLightLaw(LightSettings()), state, to_line_m) < -1.0) == stops


def test_an_ego_that_continued_at_amber_continues_when_the_light_turns_red() -> None:
    law = TrafficLightLaw(LightSettings())
    assert accel_at(law, LightState.AMBER, 10.0) == NO_LIMIT_MPS2
    for step in range(1, 6):
        assert accel_at(law, LightState.RED, 8.0, t=0.1 * step) == NO_LIMIT_MPS2


def test_a_single_wrong_reading_is_ignored() -> None:
    law = TrafficLightLaw(LightSettings())
    shown = [GREEN, GREEN, RED, GREEN, GREEN, RED, RED, RED]
    limits = [accel_at(law, state, 12.0, t=0.1 * step) for step, state in enumerate(shown)]
    assert [limit < 0.0 for limit in limits] == [False] * 7 + [True]


def test_a_decision_to_continue_ends_at_green() -> None:
    law = TrafficLightLaw(LightSettings())
    shown = [LightState.RED, GREEN, GREEN, GREEN, RED, RED, RED]
    limits = [
        accel_at(law, state, 4.0 if step < 4 else 15.0, t=0.1 * step) for step, state in enumerate(shown)
    ]
    assert limits[0] == NO_LIMIT_MPS2
    assert limits[-1] < 0.0


def test_a_decision_to_stop_at_amber_holds() -> None:
    law = TrafficLightLaw(LightSettings())
    assert accel_at(law, LightState.AMBER, 15.0) < 0.0
    assert accel_at(law, LightState.AMBER, 9.0, speed=7.5) < 0.0


def test_a_light_that_is_not_reported_is_remembered_for_a_while() -> None:
    law = TrafficLightLaw(LightSettings())
    accel_at(law, LightState.RED, 15.0)
    assert accel_at(law, None, 12.0, speed=7.0, t=1.0) < 0.0
    assert accel_at(law, None, 12.0, speed=7.0, t=3.0) == NO_LIMIT_MPS2


def test_the_profile_brakes_before_curves() -> None:
    settings = SpeedSettings()
    profile = SpeedProfile(road(Piece(60.0), Piece(20.0, 1 / 10), Piece(60.0)), settings)
    assert profile.speed_at(5.0) == settings.cruise_mps
    assert profile.speed_at(70.0) == pytest.approx(math.sqrt(settings.lateral_accel_mps2 * 10.0))
    assert profile.speed_at(120.0) == settings.cruise_mps
    for station in range(55):
        slower = profile.speed_at(station) ** 2 - profile.speed_at(station + 1) ** 2
        assert slower <= 2 * settings.curve_decel_mps2 + 1e-9


@given(station=st.floats(-100.0, 1000.0))
def test_the_profile_is_positive_everywhere(station: float) -> None:
    profile = SpeedProfile(road(Piece(60.0), Piece(20.0, -1 / 4), Piece(60.0)), SpeedSettings())
    assert 0.0 < profile.speed_at(station) <= SpeedSettings().cruise_mps


def test_an_oncoming_obstacle_is_braked_for_earlier_than_a_standing_one() -> None:
    assert follow_accel(FOLLOW, 8.0, 25.0, -8.0) < follow_accel(FOLLOW, 8.0, 25.0, 0.0)
