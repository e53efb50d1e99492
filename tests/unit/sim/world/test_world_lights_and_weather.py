import itertools
from dataclasses import astuple

from hypothesis import given
from hypothesis import strategies as st

from brink.sim.driving.interface import LightState
from brink.sim.urban.scenario import TimeOfDay, Weather
from brink.sim.world.lights import CYCLE_S, SignalPlan
from brink.sim.world.streams import Stream, generator
from brink.sim.world.weather import conditions


@given(st.floats(0, CYCLE_S), st.floats(0, 200))
def test_two_directions_never_have_green_or_amber_together(phase_s: float, time_s: float) -> None:
    plan = SignalPlan(phase_s=phase_s)
    assert LightState.RED in (plan.main_at(time_s), plan.side_at(time_s))


@given(st.floats(0, CYCLE_S), st.floats(0, 200))
def test_red_lasts_as_long_as_it_says(phase_s: float, time_s: float) -> None:
    plan = SignalPlan(phase_s=phase_s)
    left_s = plan.main_red_for_s(time_s)
    if plan.main_at(time_s) is LightState.RED:
        assert plan.main_at(time_s + left_s - 1e-6) is LightState.RED
        assert plan.main_at(time_s + left_s + 1e-6) is LightState.GREEN
    else:
        assert left_s == 0.0


def test_friction_is_that_of_the_road_surface() -> None:
    expected = {
        Weather.CLEAR: 0.9,
        Weather.CLOUDY: 0.9,
        Weather.WET: 0.6,
        Weather.WET_CLOUDY: 0.6,
        Weather.MEDIUM_RAIN: 0.5,
        Weather.HARD_RAIN: 0.4,
    }
    for weather, friction in expected.items():
        assert conditions(TimeOfDay.NOON, weather).friction == friction
    assert 0.5 < conditions(TimeOfDay.NOON, Weather.SOFT_RAIN).friction < 0.6


def test_every_hour_and_weather_differs_from_every_other() -> None:
    kinds = {astuple(conditions(t, w)) for t, w in itertools.product(TimeOfDay, Weather)}
    assert len(kinds) == len(TimeOfDay) * len(Weather)


def test_streams_do_not_depend_on_each_other() -> None:
    first = generator(7, Stream.VEHICLE, 1).random(4)
    generator(7, Stream.VEHICLE, 0).random(100)
    assert (generator(7, Stream.VEHICLE, 1).random(4) == first).all()
    others = [
        generator(8, Stream.VEHICLE, 1),
        generator(7, Stream.PEDESTRIAN, 1),
        generator(7, Stream.VEHICLE),
    ]
    assert all((other.random(4) != first).all() for other in others)
