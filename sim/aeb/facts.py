"""Owns the exact facts of an emergency-braking episode: clearances and contacts in every step of the physics.

Contacts are looked for at 100 Hz, apart from the camera's clock and from the detector.
"""

import math
from typing import Final

from brink.sim.aeb.street import CRUISE_MPS, END_M, LANE_M, LANE_Y_M, Actor, Street
from brink.sim.bullet.engine import BodyId, Box, Engine
from brink.sim.rendering.scene import Body, BodyKind
from brink.sim.requirements import Collision, CollisionKind, WorldSample
from brink.sim.world.ego import EgoCar

NEAR_M: Final = 8.0
CREEPING_MPS: Final = 0.05
"""An ego that is slower hits nobody: they walk into it."""
CAMERA_FORWARD_M: Final = 1.3
REGION_AHEAD_M: Final = 10.5
"""How far ahead of the camera the warning region reaches on the ground, and half a car's breath more."""
REGION_ASIDE_M: Final = 1.9
COURSE_S: Final = 2.0
"""Who will be in the region within this time, everybody going on as now, is on a course into it."""

_KINDS: Final = {BodyKind.VEHICLE: CollisionKind.VEHICLE, BodyKind.PERSON: CollisionKind.PEDESTRIAN}


class Facts:
    """Measures an episode.

    Args:
        street: Where it is. The engine's bodies are made from it.
        ego: The car under test.
        engine: Emptied before; gets the bodies.
    """

    def __init__(self, street: Street, ego: EgoCar, engine: Engine) -> None:
        self._street = street
        self._ego = ego
        self._engine = engine
        model = ego.model
        boxes = [
            Box(
                length_m=ego.length_m, width_m=ego.width_m, height_m=model.height_m, x_m=ego.x_m, y_m=ego.y_m,
                yaw_rad=ego.yaw_rad,
            ),
            *(_box(actor.body) for actor in street.actors),
            *(_box(body) for body in street.scene.parked),
        ]  # fmt: skip
        ids = engine.add_boxes(boxes)
        count = len(street.actors)
        self._ego_body = ids[0]
        self._actors = list(zip(street.actors, ids[1 : 1 + count], strict=True))
        self._parked = list(zip(street.scene.parked, ids[1 + count :], strict=True))
        self._gap_m: float | None = None
        self._person_m: float | None = None
        self._closing_mps = 0.0
        self._collision: Collision | None = None

    def touch(self) -> None:
        """Look for contacts and clearances now: call it after every step of the ego, before `sample`."""
        ego = self._ego
        self._engine.move(self._ego_body, ego.x_m, ego.y_m, ego.yaw_rad, ego.model.height_m)
        self._gap_m, self._person_m, self._closing_mps = None, None, 0.0
        for actor, body in self._actors:
            if self._far(actor.x_m, actor.y_m, actor.body):
                continue
            self._engine.move(body, actor.x_m, actor.y_m, actor.body.yaw_rad, actor.body.height_m)
            heading = actor.body.yaw_rad
            velocity = (actor.speed_mps * math.cos(heading), actor.speed_mps * math.sin(heading))
            self._ask(body, actor.body, actor.name, velocity, beside=actor.name.startswith("oncoming"))
        for still, body in self._parked:
            if not self._far(still.x_m, still.y_m, still):
                self._ask(body, still, "parked-car", (0.0, 0.0), beside=True)

    def _far(self, x_m: float, y_m: float, body: Body) -> bool:
        ego = self._ego
        reach_m = NEAR_M + 0.5 * (ego.length_m + body.length_m + body.width_m) + 1.0
        return abs(x_m - ego.x_m) > reach_m or abs(y_m - ego.y_m) > reach_m

    def _ask(
        self, body: BodyId, shape: Body, name: str, velocity: tuple[float, float], *, beside: bool
    ) -> None:
        """Look how one body lies to the ego; of what only passes beside it, nothing but contacts counts."""
        found = self._engine.closest(self._ego_body, body, NEAR_M)
        if found is None:
            return
        ego = self._ego
        along = velocity[0] - ego.speed_mps * math.cos(ego.yaw_rad)
        across = velocity[1] - ego.speed_mps * math.sin(ego.yaw_rad)
        gap_m = max(found.clearance_m, 0.0)
        if shape.kind is BodyKind.PERSON:
            self._person_m = gap_m if self._person_m is None else min(gap_m, self._person_m)
        if not beside and (self._gap_m is None or gap_m < self._gap_m):
            self._gap_m = gap_m
            self._closing_mps = along * found.normal_x + across * found.normal_y
        if found.clearance_m <= 0.0 and abs(ego.speed_mps) > CREEPING_MPS and self._collision is None:
            kind = _KINDS.get(shape.kind, CollisionKind.OBJECT)
            self._collision = Collision(
                kind=kind, counterpart=name, impact_speed_mps=math.hypot(along, across)
            )

    @property
    def collided(self) -> bool:
        """Whether the ego has hit somebody or something."""
        return self._collision is not None

    def expected(self) -> bool:
        """Return whether anybody is in the warning region, or on a course into it, by ground truth."""
        return any(self._is_expected(actor) for actor, _ in self._actors)

    def _is_expected(self, actor: Actor) -> bool:
        ego, body = self._ego, actor.body
        cos, sin = abs(math.cos(body.yaw_rad)), abs(math.sin(body.yaw_rad))
        half_along = 0.5 * (body.length_m * cos + body.width_m * sin)
        half_across = 0.5 * (body.length_m * sin + body.width_m * cos)
        vx = actor.speed_mps * math.cos(body.yaw_rad)
        vy = actor.speed_mps * math.sin(body.yaw_rad)
        for tenth in range(round(COURSE_S / 0.1) + 1):
            later_s = 0.1 * tenth
            ahead_m = actor.x_m + vx * later_s - (ego.x_m + ego.speed_mps * later_s + CAMERA_FORWARD_M)
            aside_m = actor.y_m + vy * later_s - ego.y_m
            if (
                -half_along <= ahead_m - half_along <= REGION_AHEAD_M
                and abs(aside_m) <= REGION_ASIDE_M + half_across
            ):
                return True
        return False

    def sample(self, time_s: float, *, brakes_for_nothing: bool) -> WorldSample:
        """Return what is true now."""
        ego = self._ego
        front_m = self._front_gap()
        return WorldSample(
            time_s=time_s,
            x_m=ego.x_m,
            y_m=ego.y_m,
            yaw_rad=ego.yaw_rad,
            speed_mps=ego.speed_mps,
            station_m=ego.x_m,
            offset_m=ego.y_m - LANE_Y_M,
            heading_error_rad=ego.yaw_rad,
            ego_length_m=ego.length_m,
            ego_width_m=ego.width_m,
            lane_left_m=0.5 * LANE_M,
            lane_right_m=-0.5 * LANE_M,
            speed_limit_mps=CRUISE_MPS + 2.0,
            front_gap_m=front_m,
            pedestrian_gap_m=self._person_m,
            nearest_gap_m=self._gap_m,
            closing_speed_mps=self._closing_mps,
            collision=self._collision,
            may_wait=self.expected(),
            goal_reached=ego.x_m > END_M - 20.0,
            brakes_for_nothing=brakes_for_nothing,
        )

    def _front_gap(self) -> float | None:
        """Return the gap to the nearest vehicle ahead in the ego's lane, bumper to bumper."""
        ego = self._ego
        gaps = [
            actor.x_m - 0.5 * actor.body.length_m - ego.x_m - 0.5 * ego.length_m
            for actor, _ in self._actors
            if actor.body.kind is not BodyKind.PERSON
            and abs(actor.y_m - ego.y_m) < 0.5 * (ego.width_m + actor.body.width_m)
            and actor.x_m > ego.x_m
        ]
        nearest_m = min(gaps, default=None)
        return None if nearest_m is None or nearest_m > 50.0 else max(nearest_m, 0.0)


def _box(body: Body) -> Box:
    return Box(
        length_m=body.length_m, width_m=body.width_m, height_m=body.height_m, x_m=body.x_m, y_m=body.y_m,
        yaw_rad=body.yaw_rad,
    )  # fmt: skip
