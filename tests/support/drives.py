"""Recorded drives in every world that can be exported, simulated once per process."""

import base64
from dataclasses import replace
from functools import cache

import numpy as np

from brink.sim.aeb.simulator import BrinkAeb
from brink.sim.encounter.simulator import BrinkEncounter
from brink.sim.episode import EpisodeSpec, Json, JsonObject
from brink.sim.trace import Trace
from brink.sim.urban.simulator import BrinkDrive
from brink.sim.world.scenario import DrivingTask, RoadCurve, TimeOfDay, Weather
from brink.worker.wire import Completed, LeasedJob, WireVerdict

REQUIREMENTS = ("front-gap@1", "no-collision@1", "red-light@1")


@cache
def urban_drive(number: int) -> Trace:
    """Return one of twelve drives: one on each road, with all tasks, times of day and weathers among them."""
    curve, road_id = list(RoadCurve)[number // 3], number % 3
    scenario: JsonObject = {
        "time_of_day": list(TimeOfDay)[number % 3].value,
        "weather": list(Weather)[number % 7].value,
        "pedestrians": 18 if number % 2 else 0,
        "road_curve": curve.value,
        "road_id": road_id,
        "road_length": (number // 3 + number) % 3,
        "driving_task": list(DrivingTask)[(number // 2) % 3].value,
    }
    spec = EpisodeSpec(
        simulator="brink-drive@3",
        scenario=scenario,
        behaviour={"mode": "oracle"},
        requirements=REQUIREMENTS,
        seed=number,
        duration_s=30.0,
    )
    return recorded(BrinkDrive(), spec)


@cache
def encounter_drive() -> Trace:
    """Return an encounter with a car, an oncoming van and a person who crosses."""

    def user(kind: str, **changes: float) -> JsonObject:
        step: JsonObject = {
            "action": "keep",
            "from_s": 0.0,
            "lasts_s": 12.0,
            "s_m": 0.0,
            "d_m": 0.0,
            "heading_rad": 0.0,
            "speed_mps": 0.0,
            "accel_mps2": 0.0,
            "aside_m": 0.0,
            **changes,
        }
        return {"kind": kind, "stretches": [step]}

    users: list[Json] = [
        user("car", s_m=25.0, speed_mps=6.0, aside_m=-0.5),
        user("van", s_m=90.0, d_m=3.4, heading_rad=-3.14159, speed_mps=7.0),
        user("pedestrian", s_m=60.0, d_m=-6.0, heading_rad=1.5708, speed_mps=1.0),
    ]
    spec = EpisodeSpec(
        simulator="brink-encounter@2",
        scenario={
            "time_of_day": "sunset",
            "weather": "wet",
            "road_curve": "left",
            "road_id": 1,
            "road_length": 2,
            "driving_task": "follow_road",
            "road_users": users,
        },
        behaviour={"mode": "oracle"},
        requirements=("no-collision@1",),
        seed=5,
        duration_s=12.0,
    )
    return recorded(BrinkEncounter(), spec)


@cache
def street_drive() -> Trace:
    """Return a drive of the emergency brake towards a fallen tree and a person."""
    spec = EpisodeSpec(
        simulator="brink-aeb@3",
        scenario={
            "time_of_day": "night",
            "weather": "soft_rain",
            "occluder": "van",
            "crossing_m": 50.0,
            "arrival_s": 0.0,
            "oncoming_m": 60.0,
            "obstacle": "novelty",
        },
        behaviour={"mode": "oracle"},
        requirements=("no-collision@1",),
        seed=2,
        duration_s=15.0,
    )
    return recorded(BrinkAeb(), spec)


def recorded(simulator: BrinkDrive | BrinkEncounter | BrinkAeb, spec: EpisodeSpec) -> Trace:
    """Simulate an episode and return its trace."""
    document = simulator.run(spec, record=True).trace
    assert document is not None
    return Trace.from_bytes(document)


def absent(trace: Trace, name: str, *spans: tuple[int, int]) -> Trace:
    """Return a drive in which a road user is absent for some samples: from one up to another one."""

    def changed(motion: np.ndarray) -> np.ndarray:
        motion = motion.copy()
        for first, end in spans:
            motion[first:end] = np.nan
        return motion

    return replace(
        trace,
        actors=tuple(
            replace(actor, motion=changed(actor.motion)) if actor.name == name else actor
            for actor in trace.actors
        ),
    )


def simulate(job: LeasedJob) -> Completed:
    """Simulate a job of an urban drive in this process."""
    result = BrinkDrive().run(EpisodeSpec.from_json(job.spec), record=job.record)
    verdicts = {
        name: WireVerdict(robustness=one.robustness, unit=one.unit, violated_at_s=one.violated_at_s)
        for name, one in result.verdicts.items()
    }
    return Completed(
        verdicts=verdicts,
        objectives=dict(result.objectives),
        features=dict(result.features),
        trace=None if result.trace is None else base64.b64encode(result.trace).decode(),
    )
