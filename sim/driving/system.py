"""The modular driving system: detections in, commands out, through replaceable parts.

    boxes -> localiser -> tracker -> predictor -> planner -> controller -> command

The obstacle detector runs before it, outside: it is the component under test, and its boxes are the input.
"""

from collections import deque
from typing import Final

from brink.sim.driving.camera import Camera
from brink.sim.driving.control import Controller, PursuitController
from brink.sim.driving.interface import (
    Command,
    EgoState,
    Observation,
    PerceivedObstacle,
    PlanMode,
    PlanState,
    Route,
)
from brink.sim.driving.obstacles import (
    AlphaBetaTracker,
    ConstantVelocityPredictor,
    GroundPlaneLocaliser,
    Localiser,
    Predictor,
    Track,
    Tracker,
)
from brink.sim.driving.planning import Plan, Planner, RoutePlanner
from brink.sim.driving.settings import DrivingSettings

REMEMBERED_STEPS: Final = 22
"""Steps for which the ego's own states are remembered; images that are older count as this old."""

_DEFAULT_CAMERA = Camera()
_DEFAULT_SETTINGS = DrivingSettings()


class BoxTracking:
    """Places boxes where the ego was when their image was taken, and follows them. Create a new one for each episode.

    Args:
        localiser: Boxes to places.
        tracker: Places to tracks.
    """

    __slots__ = ("_localiser", "_poses", "_tracker")

    def __init__(self, localiser: Localiser, tracker: Tracker) -> None:
        self._localiser = localiser
        self._tracker = tracker
        self._poses: deque[tuple[float, EgoState]] = deque(maxlen=REMEMBERED_STEPS)

    def update(self, observation: Observation) -> list[Track] | None:
        """Process one control step.

        Returns:
            The confirmed tracks at the time of the image; None if the observation has no boxes.
        """
        time_s, boxes = observation.time_s, observation.boxes
        self._poses.append((time_s, observation.ego))
        if boxes is None:
            return None
        seen_s = time_s if observation.seen_s is None else observation.seen_s
        return self._tracker.update(seen_s, self._localiser.locate(self._pose_at(seen_s), boxes))

    def _pose_at(self, time_s: float) -> EgoState:
        """Return the ego's state at a time: that of the last step up to then, or the oldest one in memory."""
        for step_s, state in reversed(self._poses):
            if step_s <= time_s + 1e-9:
                return state
        return self._poses[0][1]


class ModularDriving:
    """Implements `brink.sim.driving.interface.Driving`. Create a new one for each episode.

    Args:
        route: Route to follow.
        settings: All constants.
        camera: Camera that the boxes come from.
        localiser: Boxes to places; by default on a ground plane.
        tracker: Places to tracks; by default alpha-beta.
        predictor: Tracks to obstacles on the route; by default at constant velocity.
        planner: Obstacles to a plan; by default the route planner.
        controller: Plan to command; by default pure pursuit and PID.
    """

    __slots__ = ("_controller", "_plan", "_planner", "_predictor", "_speed_mps", "_tracking", "_tracks")

    def __init__(
        self,
        route: Route,
        *,
        settings: DrivingSettings = _DEFAULT_SETTINGS,
        camera: Camera = _DEFAULT_CAMERA,
        localiser: Localiser | None = None,
        tracker: Tracker | None = None,
        predictor: Predictor | None = None,
        planner: Planner | None = None,
        controller: Controller | None = None,
    ) -> None:
        self._tracking = BoxTracking(
            localiser or GroundPlaneLocaliser(route, camera, settings.localisation),
            tracker or AlphaBetaTracker(settings.tracking),
        )
        self._predictor = predictor or ConstantVelocityPredictor(route, settings.prediction)
        self._planner = planner or RoutePlanner(route, settings.shape, settings.planning)
        self._controller = controller or PursuitController(route, settings.shape, settings.control)
        self._tracks: list[Track] = []
        self._speed_mps = 0.0
        self._plan = Plan(PlanMode.CRUISE, 0.0, 0.0, 0.0, 0.0)

    def step(self, observation: Observation) -> Command:
        """Run one control step and return its command."""
        time_s, ego = observation.time_s, observation.ego
        tracks = self._tracking.update(observation)
        if tracks is not None:
            self._tracks = tracks
            # What the image shows has moved on since.
            age_s = 0.0 if observation.seen_s is None else time_s - observation.seen_s
            obstacles = self._predictor.predict(time_s, ego, tracks, age_s) if tracks else ()
            self._planner.perceive(time_s, ego, obstacles)
        self._plan = plan = self._planner.plan(time_s, ego, observation.light)
        self._speed_mps = ego.speed_mps
        return self._controller.control(ego, plan)

    @property
    def plan(self) -> PlanState:
        """The planner's last decision; the target speed is what its acceleration limit allows within 1 s."""
        plan = self._plan
        speed_mps = max(min(plan.cruise_mps, self._speed_mps + plan.accel_limit_mps2), 0.0)
        return PlanState(plan.mode, speed_mps, plan.target_offset_m)

    @property
    def obstacles(self) -> tuple[PerceivedObstacle, ...]:
        """The confirmed tracks of the last perception step, with the centres of their bodies."""
        return tuple(
            PerceivedObstacle(
                track.number,
                track.label,
                track.x_m,
                track.y_m,
                track.vx_mps,
                track.vy_mps,
                track.length_m,
                track.width_m,
            )
            for track in self._tracks
        )
