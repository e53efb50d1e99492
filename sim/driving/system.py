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


class ModularDriving:
    """Implements `brink.sim.driving.interface.DrivingSystem`. Create a new one for each episode.

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

    __slots__ = (
        "_controller",
        "_localiser",
        "_plan",
        "_planner",
        "_poses",
        "_predictor",
        "_speed_mps",
        "_tracker",
        "_tracks",
    )

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
        self._localiser = localiser or GroundPlaneLocaliser(route, camera, settings.localisation)
        self._tracker = tracker or AlphaBetaTracker(settings.tracking)
        self._predictor = predictor or ConstantVelocityPredictor(route, settings.prediction)
        self._planner = planner or RoutePlanner(route, settings.shape, settings.planning)
        self._controller = controller or PursuitController(route, settings.shape, settings.control)
        self._tracks: list[Track] = []
        self._poses: deque[tuple[float, EgoState]] = deque(maxlen=REMEMBERED_STEPS)
        self._speed_mps = 0.0
        self._plan = Plan(PlanMode.CRUISE, 0.0, 0.0, 0.0, 0.0)

    def step(self, observation: Observation) -> Command:
        """Run one control step and return its command."""
        time_s, ego, boxes, light, seen_s = observation
        self._poses.append((time_s, ego))
        if boxes is not None:
            if seen_s is None:
                seen_s = time_s
            # Boxes belong where the ego was when the image was taken; what they show has moved on since.
            places = self._localiser.locate(self._pose_at(seen_s), boxes)
            self._tracks = self._tracker.update(seen_s, places)
            age_s = time_s - seen_s
            obstacles = self._predictor.predict(time_s, ego, self._tracks, age_s) if self._tracks else ()
            self._planner.perceive(time_s, ego, obstacles)
        self._plan = plan = self._planner.plan(time_s, ego, light)
        self._speed_mps = ego.speed_mps
        return self._controller.control(ego, plan)

    def _pose_at(self, time_s: float) -> EgoState:
        """Return the ego's state in the latest step at or before a time, or the oldest that is remembered."""
        for step_s, state in reversed(self._poses):
            if step_s <= time_s + 1e-9:
                return state
        return self._poses[0][1]

    @property
    def plan(self) -> PlanState:
        """The planner's last decision; the target speed is what its acceleration limit allows within 1 s."""
        plan = self._plan
        return PlanState(
            mode=plan.mode,
            target_speed_mps=max(min(plan.cruise_mps, self._speed_mps + plan.accel_limit_mps2), 0.0),
            target_offset_m=plan.target_offset_m,
        )

    @property
    def obstacles(self) -> tuple[PerceivedObstacle, ...]:
        """The confirmed tracks of the last perception step, with the centres of their bodies."""
        return tuple(
            PerceivedObstacle(
                track=track.number,
                label=track.label,
                x_m=track.x_m,
                y_m=track.y_m,
                vx_mps=track.vx_mps,
                vy_mps=track.vy_mps,
                length_m=track.length_m,
                width_m=track.width_m,
            )
            for track in self._tracks
        )
