"""Records what a guard would observe in an episode: its features at every perception step, and the verdicts.

Episodes are deterministic, so features need not be stored with results: they are recorded by running an episode again
(docs/adr/0055). Recording changes nothing in the episode: the driving system is only watched.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from brink.sim.driving.interface import Command, DrivingSystem, Observation, PerceivedObstacle, PlanState
from brink.sim.episode import EpisodeSpec, Json, Verdict
from brink.sim.errors import InvalidEpisode
from brink.sim.guard.features import ALL_FEATURES, FeatureExtractor
from brink.sim.urban.behaviour import PERCEPTION_STEP_S
from brink.sim.urban.range_sensor import RangeSensor, known_conditions, range_sensor
from brink.sim.urban.simulator import BrinkDrive, BrinkDriveErrors
from brink.sim.world.scenario import UrbanScenario
from brink.sim.world.world import World

HalfArray: TypeAlias = NDArray[np.float16]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RecordedDrive:
    """The features and verdicts of one episode.

    Attributes:
        features: Features at the perception steps 0, 1, 2, …, in the order of
            `brink.sim.guard.features.ALL_FEATURES`, shape ``(steps, features)``.
        verdicts: Verdict of each requirement, by id.
        objectives: Objectives of the search by name.
        facts: Further facts about the episode, by name.
        ended_at_s: When the episode ended.
    """

    features: HalfArray
    verdicts: Mapping[str, Verdict]
    objectives: Mapping[str, float]
    facts: Mapping[str, Json]
    ended_at_s: float


class WatchedDriving:
    """A driving system whose observations and commands are watched, and not changed.

    Args:
        driving: The driving system.
        extractor: Turns them into features.
        sensor: The range sensor.
    """

    def __init__(self, driving: DrivingSystem, extractor: FeatureExtractor, sensor: RangeSensor) -> None:
        self._driving = driving
        self._extractor = extractor
        self._sensor = sensor
        self.rows: list[NDArray[np.float32]] = []

    def step(self, observation: Observation) -> Command:
        """Run one control step and return its command."""
        command = self._driving.step(observation)
        if observation.boxes is not None:
            scan = self._sensor.scan(round(observation.time_s / PERCEPTION_STEP_S))
            self.rows.append(self._extractor.step(observation, command, self._driving.plan, scan))
        return command

    @property
    def plan(self) -> PlanState:
        """The planner's decision in the last step."""
        return self._driving.plan

    @property
    def obstacles(self) -> tuple[PerceivedObstacle, ...]:
        """The obstacles near the ego that the planner treated as real in the last step."""
        return self._driving.obstacles


class _Watching(BrinkDrive):
    """Runs urban episodes with a watched driving system, which it keeps until the next episode."""

    watched: WatchedDriving

    def _driving(self, world: World, scenario: UrbanScenario, spec: EpisodeSpec) -> DrivingSystem:
        driving = super()._driving(world, scenario, spec)
        extractor = FeatureExtractor(world.route, known_conditions(scenario), ranges=True)
        self.watched = WatchedDriving(driving, extractor, range_sensor(world, scenario, spec))
        return self.watched


class _WatchingErrors(_Watching, BrinkDriveErrors):
    """The same, with errors relative to the truth."""


_SIMULATORS: Final[Mapping[str, Callable[[], _Watching]]] = {
    BrinkDrive.id: _Watching,
    BrinkDriveErrors.id: _WatchingErrors,
}
SIMULATORS: Final = tuple(_SIMULATORS)
"""Ids of the simulators whose episodes can be recorded."""


def record_drive(spec: EpisodeSpec) -> RecordedDrive:
    """Run an episode and return the features and verdicts.

    Raises:
        InvalidEpisode: Its simulator does not drive with an obstacle detector, or the episode can never run.
        SimulationCrashed: The physics engine failed.
    """
    make = _SIMULATORS.get(spec.simulator)
    if make is None:
        raise InvalidEpisode(
            f"simulator: a guard can be fitted to drives of {', '.join(SIMULATORS)}; got {spec.simulator!r}"
        )
    simulator = make()
    result = simulator.run(spec)
    ended_at_s = result.features["ended_at_s"]
    assert isinstance(ended_at_s, float | int)
    return RecordedDrive(
        features=np.array(simulator.watched.rows, np.float16).reshape(-1, len(ALL_FEATURES)),
        verdicts=result.verdicts,
        objectives=result.objectives,
        facts=result.features,
        ended_at_s=float(ended_at_s),
    )
