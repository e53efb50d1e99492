"""Fallbacks: when an intervention begins and ends, what the car then does, and which boxes it ignores."""

import itertools
from collections.abc import Callable, Sequence

import pytest

from brink.guard.box_filter import BoxFilter, BoxFilterSettings
from brink.guard.fallback import (
    Intervention,
    InterventionSettings,
    SafeStop,
    SafeStopSettings,
    SlowDown,
    SlowDownSettings,
)
from brink.sim.catalogue import plugin_ids
from brink.sim.driving.camera import Camera, Solid
from brink.sim.driving.interface import Box, Command, EgoState, Observation, ObstacleLabel
from brink.sim.errors import InvalidEpisode
from brink.sim.guard.interface import Fallback, GuardReading
from brink.sim.guard.option import FALLBACKS, fallback_settings, make_fallback
from brink.sim.guard.setting import settings_from_json, settings_to_json

DT_S = 0.05
CAMERA = Camera()
CALM, ALARM = (GuardReading(probabilities=(0.5,), alarm=alarm) for alarm in (False, True))


def ego(*, x_m: float = 0.0, speed_mps: float = 8.0) -> EgoState:
    return EgoState(
        x_m=x_m, y_m=0.0, yaw_rad=0.0, speed_mps=speed_mps, accel_mps2=0.0, station_m=x_m, offset_m=0.0
    )


def observed(time_s: float, state: EgoState, boxes: tuple[Box, ...] | None = None) -> Observation:
    return Observation(time_s=time_s, ego=state, boxes=boxes, light=None)


def driven(
    fallback: Fallback, alarm: Callable[[float], bool], *, seconds: float, wanted_mps2: float = 1.5
) -> list[tuple[float, float, float]]:
    """Drive a point mass from 8 m/s; return time, speed and executed acceleration of each control step."""
    speed_mps, found = 8.0, []
    for step in range(round(seconds / DT_S)):
        time_s = step * DT_S
        reading = ALARM if alarm(time_s) else CALM
        observation = fallback.perceive(observed(time_s, ego(speed_mps=speed_mps)), reading)
        wanted = wanted_mps2 if speed_mps < 8.0 else 0.0
        command = fallback.step(observation, Command(accel_mps2=wanted, steer_rad=0.1), reading)
        assert command.steer_rad == 0.1
        assert command.accel_mps2 <= wanted
        found.append((time_s, speed_mps, command.accel_mps2))
        speed_mps = max(speed_mps + command.accel_mps2 * DT_S, 0.0)
    return found


def episodes(alarms: Sequence[bool], settings: InterventionSettings) -> list[bool]:
    intervention = Intervention(settings)
    return [intervention.step(step * 0.1, alarm) for step, alarm in enumerate(alarms)]


def test_a_short_alarm_makes_an_intervention_of_the_least_length() -> None:
    active = episodes([True] + [False] * 30, InterventionSettings(least_s=1.0, clear_s=0.5))

    assert active == [True] * 10 + [False] * 21


def test_an_alarm_that_flickers_makes_one_intervention() -> None:
    flickering = [step % 3 == 0 for step in range(60)] + [False] * 20

    active = episodes(flickering, InterventionSettings(least_s=0.5, clear_s=0.5))

    assert sum(now != before for before, now in zip([False, *active], active, strict=False)) == 2
    assert active[57]
    assert not active[63]


def test_an_alarm_that_does_not_end_lets_the_car_go_on_after_a_while() -> None:
    settings = InterventionSettings(least_s=0.5, clear_s=0.5, longest_s=3.0, rest_s=1.0)

    active = episodes([True] * 50, settings)

    assert all(active[:30])
    assert not any(active[30:40])
    assert all(active[40:])


def test_safe_stop_brakes_as_set_holds_the_car_and_goes_on_with_limited_jerk() -> None:
    settings = SafeStopSettings(decel_mps2=4.0, clear_s=0.5, jerk_mps3=3.0)

    steps = driven(SafeStop(settings), lambda time_s: 1.0 <= time_s < 5.0, seconds=12.0)

    braking = [accel for time_s, speed, accel in steps if 1.0 <= time_s < 5.4 and speed > 0.3]
    assert set(braking) == {-4.0}
    assert min(speed for time_s, speed, _ in steps if 4.0 < time_s < 5.4) == 0.0
    after = [accel for time_s, _, accel in steps if time_s > 5.6]
    rises = [now - before for before, now in itertools.pairwise(after)]
    assert max(rises) == pytest.approx(3.0 * DT_S)
    assert max(after) == 1.5


def test_slow_down_reaches_its_speed_and_keeps_it_while_the_alarm_lasts() -> None:
    steps = driven(SlowDown(SlowDownSettings(speed_mps=3.0)), lambda time_s: time_s >= 1.0, seconds=15.0)

    assert all(speed == 8.0 for time_s, speed, _ in steps if time_s <= 1.0)
    assert min(accel for _, _, accel in steps) == -3.0
    assert [speed for time_s, speed, _ in steps if time_s > 5.0] == pytest.approx([3.0] * 199, abs=0.1)


@pytest.mark.parametrize("fallback_id", plugin_ids(FALLBACKS))
def test_without_an_alarm_no_fallback_changes_anything(fallback_id: str) -> None:
    fallback = make_fallback(fallback_id, fallback_settings(fallback_id, {}))
    for step in range(100):
        observation = observed(step * DT_S, ego(), (Box(ObstacleLabel.PERSON, 300.0, 500.0, 0.0, 100.0),))
        command = Command(accel_mps2=1.0, steer_rad=-0.2)
        assert fallback.perceive(observation, CALM) is observation
        assert fallback.step(observation, command, CALM) is command
        assert not fallback.active


@pytest.mark.parametrize("fallback_id", plugin_ids(FALLBACKS))
def test_settings_survive_json_and_reject_what_is_unknown_or_out_of_range(fallback_id: str) -> None:
    settings = fallback_settings(fallback_id, {})
    document = settings_to_json(settings)

    assert settings_from_json("settings", type(settings), document) == settings
    with pytest.raises(InvalidEpisode, match="unknown setting 'braveness'"):
        fallback_settings(fallback_id, {"braveness": 1.0})
    for name in document:
        with pytest.raises(InvalidEpisode, match=f"settings.{name}: expected a number in"):
            fallback_settings(fallback_id, {name: -1.0})


def test_an_unknown_fallback_is_refused_with_the_known_ones() -> None:
    with pytest.raises(InvalidEpisode, match=r"expected one of .*safe-stop@1.*did you mean 'safe-stop@1'"):
        fallback_settings("safe-stop@2", {})


def seen(label: ObstacleLabel, x_m: float, y_m: float, state: EgoState) -> Box:
    """Return the box of a body that really stands somewhere."""
    length, width, height = (4.5, 1.9, 1.5) if label is ObstacleLabel.VEHICLE else (0.5, 0.5, 1.75)
    body = Solid(label=label, x_m=x_m, y_m=y_m, yaw_rad=0.0, length_m=length, width_m=width, height_m=height)
    found = CAMERA.project(state.x_m, state.y_m, state.yaw_rad, body)
    assert found is not None
    return found[0]


def kept(frames: Sequence[tuple[EgoState, Sequence[Box]]]) -> list[int]:
    """Return how many boxes of each perception step are plausible."""
    boxes = BoxFilter(BoxFilterSettings())
    return [len(boxes.plausible(step * 0.1, state, given)) for step, (state, given) in enumerate(frames)]


@pytest.mark.parametrize("speed_mps", [0.0, 5.0, 12.0])
def test_a_vehicle_that_is_there_from_the_beginning_is_plausible_while_the_ego_closes_in(
    speed_mps: float,
) -> None:
    states = [ego(x_m=0.8 * step) for step in range(40)]
    frames = [
        (s, [seen(ObstacleLabel.VEHICLE, 45.0 + 0.1 * speed_mps * i, 0.5, s)]) for i, s in enumerate(states)
    ]

    assert kept(frames) == [1] * 40


def test_a_person_who_walks_into_the_image_from_the_side_is_plausible() -> None:
    frames = [(ego(), [seen(ObstacleLabel.PERSON, 10.0, 7.9 - 0.12 * step, ego())]) for step in range(60)]

    assert kept(frames) == [1] * 60


def test_what_appears_in_the_middle_of_the_image_nearby_is_doubted_for_a_while() -> None:
    box = seen(ObstacleLabel.VEHICLE, 15.0, 0.0, ego())
    nothing: list[Box] = []
    frames = [(ego(), nothing)] * 5 + [(ego(), [box])] * 30

    assert kept(frames) == [0] * 25 + [1] * 10


@pytest.mark.parametrize(
    "box",
    [
        Box(ObstacleLabel.VEHICLE, 300.0, 400.0, 100.0, 250.0),  # above the horizon
        Box(ObstacleLabel.VEHICLE, 300.0, 400.0, 50.0, 340.0),  # 12 m high
        Box(ObstacleLabel.PERSON, 380.0, 420.0, 338.0, 350.0),  # 0.4 m high at 14 m
    ],
)
def test_a_box_that_no_body_on_the_ground_can_have_is_implausible(box: Box) -> None:
    assert kept([(ego(speed_mps=0.0), [box])] * 3) == [0] * 3


def test_a_person_who_keeps_up_with_the_car_is_implausible() -> None:
    states = [ego(x_m=0.8 * step) for step in range(20)]
    frames = [(state, [seen(ObstacleLabel.PERSON, state.x_m + 8.0, 1.0, state)]) for state in states]

    assert kept(frames)[5:] == [0] * 15
