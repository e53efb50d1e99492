"""Measures the cost of urban episodes: CPU time by kind of episode, and memory of a process."""

import json
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from brink.bench.trials import run_trial, single_threaded
from brink.bench.urban_candidates import draw_candidate
from brink.sim.catalogue import make_requirements
from brink.sim.driving.camera import Camera
from brink.sim.driving.interface import ObstacleLabel
from brink.sim.driving.system import ModularDriving
from brink.sim.urban.behaviour import BehaviourMode, DetectorBehaviour, InjectedTrajectory
from brink.sim.world.scenario import DrivingTask, RoadCurve, TimeOfDay, UrbanScenario, Weather
from brink.sim.world.world import make_world

DURATION_S = 30.0
FRONT_GAP = "front-gap@1"

_BUSY = UrbanScenario(
    time_of_day=TimeOfDay.SUNSET,
    weather=Weather.WET,
    pedestrians=18,
    road_curve=RoadCurve.CROSSROAD,
    road_id=1,
    road_length=2,
    driving_task=DrivingTask.SECOND_EXIT,
)
_GHOSTS = (
    InjectedTrajectory(
        label=ObstacleLabel.VEHICLE,
        t0_step=10.0,
        t1_step=300.0,
        first_px=(330.0, 470.0, 250.0, 400.0),
        last_px=(320.0, 480.0, 240.0, 410.0),
    ),
    InjectedTrajectory(
        label=ObstacleLabel.PERSON,
        t0_step=0.0,
        t1_step=290.0,
        first_px=(20.0, 80.0, 250.0, 420.0),
        last_px=(60.0, 120.0, 240.0, 400.0),
    ),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Cost:
    """One measured cost.

    Attributes:
        what: Name of the measurement.
        value: The figure.
        unit: ``ms`` or ``MB``.
        most: Upper bound, or None.
    """

    what: str
    value: float
    unit: str
    most: float | None

    @property
    def met(self) -> bool | None:
        """Whether the figure is within its bound; None without a bound."""
        return None if self.most is None else self.value <= self.most


def measure_costs(*, repeats: int = 15, episodes: int = 2000) -> Iterator[Cost]:
    """Measure the costs and yield them one by one.

    Args:
        repeats: Episodes of each kind; the figure is their median.
        episodes: Episodes in the process whose memory is measured.
    """
    injected = DetectorBehaviour(mode=BehaviourMode.INJECTED, trajectories=_GHOSTS)
    oracle = DetectorBehaviour(mode=BehaviourMode.ORACLE)
    few = replace(_BUSY, pedestrians=8)
    yield _episode_cost("30 s, injected, 8 vehicles, 8 pedestrians", few, injected, repeats, 60.0)
    yield _episode_cost("30 s, injected, 8 vehicles, 18 pedestrians", _BUSY, injected, repeats, 100.0)
    yield _episode_cost("30 s, ground truth, 8 vehicles, 18 pedestrians", _BUSY, oracle, repeats, None)
    first_mb, last_mb = process_memory_mb(episodes)
    yield Cost(what="process after 20 episodes", value=first_mb, unit="MB", most=70.0)
    yield Cost(what=f"growth over {episodes} episodes", value=last_mb - first_mb, unit="MB", most=2.0)


def _episode_cost(
    what: str, scenario: UrbanScenario, behaviour: DetectorBehaviour, repeats: int, most_ms: float | None
) -> Cost:
    times_ms = [episode_cpu_s(scenario, behaviour) * 1e3 for _ in range(repeats + 2)][2:]
    return Cost(what=what, value=statistics.median(times_ms), unit="ms", most=most_ms)


def episode_cpu_s(scenario: UrbanScenario, behaviour: DetectorBehaviour) -> float:
    """Return the CPU time of one full 30 s episode, which continues at the goal and after collisions."""
    from brink.sim.bullet.engine import process_engine
    from brink.sim.urban.episode_loop import run_loop

    engine = process_engine()
    camera = Camera()
    before_s = time.process_time()
    engine.reset()
    world = make_world(scenario, 5)
    run_loop(
        world,
        ModularDriving(world.route, camera=camera),
        behaviour,
        make_requirements((FRONT_GAP,)),
        engine=engine,
        camera=camera,
        seed=5,
        duration_s=DURATION_S,
        recorder=None,
        to_the_end=True,
    )
    return time.process_time() - before_s


def process_memory_mb(episodes: int, settle: int = 20) -> tuple[float, float]:
    """Return the memory of a fresh process after some random episodes, and after all of them.

    Args:
        episodes: Number of episodes.
        settle: Number of episodes before the first figure.
    """
    # A new interpreter rather than a spawned process, which would import the main module of this one.
    command = [sys.executable, "-m", "brink.bench.urban_costs", str(episodes), str(settle)]
    with single_threaded():
        answer = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    first_mb, last_mb = json.loads(answer.splitlines()[-1])
    return first_mb, last_mb


def _memory_after(episodes: int, settle: int) -> tuple[float, float]:
    first_mb = 0.0
    for index in range(episodes):
        run_trial(draw_candidate(np.random.default_rng(index)).spec(index, (FRONT_GAP,)))
        if index + 1 == settle:
            first_mb = resident_mb()
    return first_mb, resident_mb()


def resident_mb() -> float:
    """Return the resident memory of this process, or its peak where the system does not report the current value."""
    status = Path("/proc/self/status")
    if status.exists():
        for line in status.read_text().splitlines():
            if line.startswith("VmRSS:"):
                return int(line.split()[1]) / 1024.0
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 1e6 if sys.platform == "darwin" else peak / 1024.0


if __name__ == "__main__":
    sys.stdout.write(json.dumps(_memory_after(int(sys.argv[1]), int(sys.argv[2]))) + "\n")
