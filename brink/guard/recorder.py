"""Records what a guard would observe in an episode: its features whenever boxes arrive, and the verdicts.

Episodes are deterministic, so features need not be stored with results: they are recorded by running an episode again
(docs/adr/0055). Recording changes nothing in the episode: the driving system is only watched.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from brink.guard.features import ALL_FEATURES, FeatureExtractor
from brink.sim.driving.camera import Camera
from brink.sim.driving.interface import Command, Driving, Observation, PerceivedObstacle, PlanState, Route
from brink.sim.episode import EpisodeResult, EpisodeSpec, Verdict
from brink.sim.errors import InvalidEpisode
from brink.sim.guard.interface import KnownConditions, RangeScan
from brink.sim.urban.range_sensor import RangeSensor, known_conditions, range_sensor, scan_number
from brink.sim.urban.simulator import BrinkDrive, BrinkDriveErrors
from brink.sim.world.scenario import UrbanScenario
from brink.sim.world.world import World

HalfArray: TypeAlias = NDArray[np.float16]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RecordedDrive:
    """The features and verdicts of one episode.

    Attributes:
        features: Features whenever boxes arrived, `PERCEPTION_STEP_S` apart, in the order of
            `brink.guard.features.ALL_FEATURES`, shape ``(steps, features)``.
        begins_s: Time of the first features: when the boxes of the first image arrived.
        verdicts: Verdict of each requirement, by id.
        ended_at_s: When the episode ended.
    """

    features: HalfArray
    begins_s: float
    verdicts: Mapping[str, Verdict]
    ended_at_s: float


class Moment(NamedTuple):
    """What a guard receives in one control step; see `brink.sim.guard.interface.Guard.step`."""

    observation: Observation
    command: Command
    plan: PlanState
    scan: RangeScan | None


class WatchedDriving:
    """A driving system whose observations and commands are watched, and not changed.

    Args:
        driving: The driving system.
        sensor: The range sensor.
        watch: Called with what a guard would receive in each control step.
    """

    def __init__(self, driving: Driving, sensor: RangeSensor, watch: Callable[[Moment], None]) -> None:
        self._driving = driving
        self._sensor = sensor
        self._watch = watch

    def step(self, observation: Observation) -> Command:
        """Run one control step and return its command."""
        command = self._driving.step(observation)
        scan = None
        if observation.boxes is not None:
            scan = self._sensor.scan(scan_number(observation.time_s))
        self._watch(Moment(observation, command, self._driving.plan, scan))
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
    """Runs urban episodes with a watched driving system, and keeps the moments of the last one."""

    route: Route
    conditions: KnownConditions
    moments: list[Moment]

    def _driving(self, spec: EpisodeSpec, world: World, camera: Camera) -> Driving:
        scenario = UrbanScenario.from_json(spec.scenario)
        self.route, self.conditions, self.moments = world.route, known_conditions(scenario), []
        sensor = range_sensor(world, scenario, spec)
        return WatchedDriving(super()._driving(spec, world, camera), sensor, self.moments.append)


class _WatchingErrors(_Watching, BrinkDriveErrors):
    """The same, with errors relative to the truth."""


_SIMULATORS: Final[Mapping[str, Callable[[], _Watching]]] = {
    BrinkDrive.id: _Watching,
    BrinkDriveErrors.id: _WatchingErrors,
}
SIMULATORS: Final = tuple(_SIMULATORS)
"""Ids of the simulators whose episodes can be recorded."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ObservedDrive:
    """One episode as a guard in the car would see it.

    Attributes:
        route: The route of the drive.
        conditions: What the car knows about the conditions.
        moments: What a guard receives in each control step, in order.
        result: The result of the episode.
    """

    route: Route
    conditions: KnownConditions
    moments: Sequence[Moment]
    result: EpisodeResult


def observe_drive(spec: EpisodeSpec) -> ObservedDrive:
    """Run an episode and return what a guard would receive.

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
    return ObservedDrive(
        route=simulator.route, conditions=simulator.conditions, moments=simulator.moments, result=result
    )


def record_drive(spec: EpisodeSpec) -> RecordedDrive:
    """Run an episode and return the features and verdicts.

    Raises:
        InvalidEpisode: Its simulator does not drive with an obstacle detector, or the episode can never run.
        SimulationCrashed: The physics engine failed.
    """
    observed = observe_drive(spec)
    extractor = FeatureExtractor(observed.route, observed.conditions, ranges=True)
    moments = [moment for moment in observed.moments if moment.observation.boxes is not None]
    rows = [extractor.step(*moment) for moment in moments]
    ended_at_s = observed.result.features["ended_at_s"]
    assert isinstance(ended_at_s, float | int)
    return RecordedDrive(
        features=np.array(rows, np.float16).reshape(-1, len(ALL_FEATURES)),
        begins_s=moments[0].observation.time_s if moments else 0.0,
        verdicts=observed.result.verdicts,
        ended_at_s=float(ended_at_s),
    )
