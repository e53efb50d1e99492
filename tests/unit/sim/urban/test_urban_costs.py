import pytest

from brink.sim.urban import benchmark
from brink.sim.urban.behaviour import BehaviourMode, DetectorBehaviour
from brink.sim.urban.benchmark import Cost, episode_cpu_s, measure_costs, process_memory_mb, resident_mb
from brink.sim.world.scenario import DrivingTask, RoadCurve, TimeOfDay, UrbanScenario, Weather


def test_a_cost_is_met_up_to_its_bound() -> None:
    assert Cost(what="x", value=60.0, unit="ms", most=60.0).met
    assert not Cost(what="x", value=60.1, unit="ms", most=60.0).met
    assert Cost(what="x", value=60.1, unit="ms", most=None).met is None


def test_an_episode_costs_processor_time() -> None:
    scenario = UrbanScenario(
        time_of_day=TimeOfDay.NOON,
        weather=Weather.CLEAR,
        pedestrians=0,
        road_curve=RoadCurve.STRAIGHT,
        road_id=0,
        road_length=0,
        driving_task=DrivingTask.FOLLOW_ROAD,
    )
    cost_s = episode_cpu_s(scenario, DetectorBehaviour(mode=BehaviourMode.INJECTED))
    assert 0.005 < cost_s < 2.0


def test_memory_stays_flat() -> None:
    first_mb, last_mb = process_memory_mb(90, settle=30)
    assert 20.0 < first_mb < 150.0
    assert last_mb - first_mb < 4.0
    assert resident_mb() > 20.0


def test_every_cost_of_the_floors_is_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(benchmark, "process_memory_mb", lambda episodes: (60.0, 60.5))
    monkeypatch.setattr(benchmark, "episode_cpu_s", lambda scenario, behaviour: 0.05)
    costs = list(measure_costs(repeats=1, episodes=10))
    assert [cost.most for cost in costs] == [60.0, 100.0, None, 70.0, 2.0]
    assert [round(cost.value, 6) for cost in costs] == [50.0, 50.0, 50.0, 60.0, 0.5]
