"""Exact facts of an episode: bodies in the physics engine, and a `WorldSample` of the ego at each step.

The engine is queried only for pairs that may be close, as decided by cheap bounds on centre distances. A moving body
is moved to its pose right before it is queried, so distant bodies cost nothing.
"""

import math
from dataclasses import dataclass

from brink.sim.bullet.engine import Block, BodyId, Closest, Engine
from brink.sim.driving.interface import LightState
from brink.sim.plane import half_extents_m
from brink.sim.requirements import Collision, CollisionKind, WorldSample
from brink.sim.world.pedestrians import PERSON_HEIGHT_M
from brink.sim.world.scenery import fixtures
from brink.sim.world.world import RoadUser, World

FRONT_RANGE_M = 50.0
NEAR_M = 8.0
CORRIDOR_MARGIN_M = 0.2
BESIDE_WITHIN_M = 5.0
AHEAD_COS = math.cos(math.radians(45.0))
"""Within `BESIDE_WITHIN_M`, only bodies within this angle of the heading are ahead of the bumper.

Where the route bends across the oncoming lane, a car that passes beside the waiting ego is inside the ego's corridor
without being ahead of it.
"""

CREEPING_MPS = 0.05
"""In a collision with an ego slower than this, the other road user hits the ego."""

SUNK_IN_M = 0.3
SUNK_IN_S = 0.1
"""A vehicle still counts as ahead if the bumper is inside it by up to `SUNK_IN_M` plus this driving time."""

REGION_BEGINS_M = 1.3
REGION_AHEAD_M = 10.5
REGION_ASIDE_M = 1.9
"""Emergency braking has a reason if a road user is up to `REGION_AHEAD_M` before the camera and within
`REGION_ASIDE_M` of its axis, was within `LOOK_BACK_S`, or will be within `LOOK_AHEAD_S`, at constant velocities."""
LOOK_BACK_S = 0.5
LOOK_AHEAD_S = 2.0
LOOK_STEP_S = 0.1

WAITING_RANGE_M = 10.0
WAITING_ASIDE_M = 3.0
"""A person within this lateral distance of the ego's centre is in its way."""
JUNCTION_REACH_M = 7.0
CROSSING_REACH_M = 2.0


@dataclass(slots=True, kw_only=True)
class _Body:
    """A static body in the engine, with the radius of its bounding circle."""

    body: BodyId
    kind: CollisionKind
    name: str
    radius_m: float
    x_m: float
    y_m: float


@dataclass(slots=True)
class _Nearest:
    """The nearest body found so far in a step."""

    gap_m: float
    closing_mps: float
    collision: Collision | None
    pedestrian_m: float
    person_ahead: bool = False


class Facts:
    """Measures the facts of an episode.

    Args:
        world: The world to measure; the engine's bodies are created from it.
        engine: Receives the bodies.
    """

    def __init__(self, world: World, engine: Engine) -> None:
        self._world = world
        self._engine = engine
        self._near_station_m = 0.0
        self._still_clear_m = 0.0
        self._has_reason = False
        ego = world.ego
        self._junctions = [
            world.road.forward.pose_at(junction.forward_m)[:2] for junction in world.road.junctions
        ]
        self._ego_radius_m = 0.5 * math.hypot(ego.length_m, ego.width_m)
        self._ego_height_m = ego.model.height_m
        blocks = [_block(ego.length_m, ego.width_m, self._ego_height_m, ego.x_m, ego.y_m, ego.yaw_rad)]
        blocks += [_mover_block(vehicle, vehicle.size.height_m) for vehicle in world.vehicles]
        blocks += [_mover_block(walker, PERSON_HEIGHT_M) for walker in world.walkers]
        still = fixtures(world.road)
        blocks += [_block(f.length_m, f.width_m, f.height_m, f.x_m, f.y_m, f.yaw_rad) for f in still]
        ids = engine.add_blocks(blocks)
        self._ego_body = ids[0]
        movers = len(world.vehicles)
        self._vehicles = list(zip(world.vehicles, ids[1 : 1 + movers], strict=True))
        after = 1 + movers + len(world.walkers)
        self._walkers = list(zip(world.walkers, ids[1 + movers : after], strict=True))
        self._fixtures = [
            _Body(
                body=body,
                kind=CollisionKind.OBJECT,
                name=fixture.kind,
                radius_m=0.5 * math.hypot(fixture.length_m, fixture.width_m),
                x_m=fixture.x_m,
                y_m=fixture.y_m,
            )
            for fixture, body in zip(still, ids[after:], strict=True)
        ]

    def measure(self, time_s: float, *, emergency: bool = False) -> WorldSample:
        """Return the current facts about the ego.

        Args:
            time_s: Simulated time.
            emergency: Whether the ego's last command was emergency braking.
        """
        world = self._world
        ego, route = world.ego, world.route
        self._engine.move(self._ego_body, ego.x_m, ego.y_m, ego.yaw_rad, self._ego_height_m)
        station_m, offset_m = route.line.project(ego.x_m, ego.y_m, self._near_station_m)
        self._near_station_m = station_m
        nearest = _Nearest(NEAR_M, 0.0, None, NEAR_M)
        front_m = self._vehicles_around(station_m, offset_m, nearest)
        self._walkers_around(nearest)
        self._fixtures_around(nearest)
        light, line_gap_m = self._light(time_s, station_m + 0.5 * ego.length_m)
        half_lane_m = 0.5 * route.lane_width_m
        heading_error = ego.yaw_rad - route.line.pose_at(station_m)[2]
        goal = station_m + 0.5 * ego.length_m >= route.length_m
        waiting = (
            goal
            or (
                light not in (None, LightState.GREEN)
                and line_gap_m is not None
                and line_gap_m < WAITING_RANGE_M
            )
            or (front_m is not None and front_m < WAITING_RANGE_M)
            or nearest.person_ahead
        )
        return WorldSample(
            time_s=time_s,
            x_m=ego.x_m,
            y_m=ego.y_m,
            yaw_rad=ego.yaw_rad,
            speed_mps=ego.speed_mps,
            station_m=station_m,
            offset_m=offset_m,
            heading_error_rad=(heading_error + math.pi) % (2.0 * math.pi) - math.pi,
            ego_length_m=ego.length_m,
            ego_width_m=ego.width_m,
            lane_left_m=half_lane_m,
            lane_right_m=-half_lane_m,
            speed_limit_mps=route.speed_limit_mps,
            front_gap_m=front_m,
            pedestrian_gap_m=nearest.pedestrian_m if nearest.pedestrian_m < NEAR_M else None,
            nearest_gap_m=nearest.gap_m if nearest.gap_m < NEAR_M else None,
            closing_speed_mps=nearest.closing_mps,
            collision=nearest.collision,
            light=light,
            stop_line_gap_m=line_gap_m,
            may_wait=waiting,
            in_conflict_area=offset_m + 0.5 * ego.width_m > half_lane_m
            or self._on_junction_or_crossing(station_m),
            goal_reached=goal,
            brakes_for_nothing=self._brakes_for_nothing(emergency=emergency),
        )

    def _brakes_for_nothing(self, *, emergency: bool) -> bool:
        """Return whether the ego has had no reason to brake since its emergency braking began."""
        self._has_reason = emergency and (self._has_reason or self._anyone_expected())
        return emergency and not self._has_reason

    def _anyone_expected(self) -> bool:
        """Return whether anyone is right before the ego, has just been there, or is on a course to there."""
        ego = self._world.ego
        cos_yaw, sin_yaw = math.cos(ego.yaw_rad), math.sin(ego.yaw_rad)
        for user, _ in (*self._vehicles, *self._walkers):
            turn = user.yaw_rad - ego.yaw_rad
            half_along_m, half_across_m = half_extents_m(user.length_m, user.width_m, turn)
            dx, dy = user.x_m - ego.x_m, user.y_m - ego.y_m
            ahead_m = dx * cos_yaw + dy * sin_yaw - REGION_BEGINS_M
            aside_m = dy * cos_yaw - dx * sin_yaw
            closing_mps = user.speed_mps * math.cos(turn) - ego.speed_mps
            across_mps = user.speed_mps * math.sin(turn)
            for step in range(-round(LOOK_BACK_S / LOOK_STEP_S), round(LOOK_AHEAD_S / LOOK_STEP_S) + 1):
                then_s = LOOK_STEP_S * step
                if (
                    -half_along_m <= ahead_m + closing_mps * then_s - half_along_m <= REGION_AHEAD_M
                    and abs(aside_m + across_mps * then_s) <= REGION_ASIDE_M + half_across_m
                ):
                    return True
        return False

    def _vehicles_around(self, station_m: float, offset_m: float, nearest: _Nearest) -> float | None:
        """Return the front gap, and update the nearest body."""
        ego, line = self._world.ego, self._world.route.line
        x_m, y_m, radius_m = ego.x_m, ego.y_m, self._ego_radius_m
        front_m: float | None = None
        half_ego_m = 0.5 * ego.width_m + CORRIDOR_MARGIN_M
        still_ahead_m = station_m + 0.5 * ego.length_m - SUNK_IN_M - SUNK_IN_S * abs(ego.speed_mps)
        for vehicle, body in self._vehicles:
            dx, dy = vehicle.x_m - x_m, vehicle.y_m - y_m
            if not -56.0 < dx < 56.0 or not -56.0 < dy < 56.0:
                continue
            half_length_m = 0.5 * vehicle.length_m
            bound_m = math.sqrt(dx * dx + dy * dy) - radius_m - half_length_m - 0.6
            ahead = False
            if bound_m < (FRONT_RANGE_M if front_m is None else front_m):
                at_m, off_m = line.project(vehicle.x_m, vehicle.y_m, station_m)
                turn = vehicle.yaw_rad - line.pose_at(at_m)[2]
                cos_turn, sin_turn = abs(math.cos(turn)), abs(math.sin(turn))
                half_width_m = 0.5 * vehicle.width_m
                across_m = half_width_m * cos_turn + half_length_m * sin_turn
                along_m = half_length_m * cos_turn + half_width_m * sin_turn
                ahead = at_m - along_m > still_ahead_m and abs(off_m - offset_m) < across_m + half_ego_m
            if not ahead and bound_m >= nearest.gap_m:
                continue
            self._engine.move(body, vehicle.x_m, vehicle.y_m, vehicle.yaw_rad, vehicle.size.height_m)
            limit_m = FRONT_RANGE_M if ahead else nearest.gap_m
            kind = CollisionKind.VEHICLE if vehicle.is_vehicle else CollisionKind.OBJECT
            found = self._query(vehicle, body, kind, limit_m, nearest)
            if not ahead or found is None or (front_m is not None and found.clearance_m >= front_m):
                continue
            if found.clearance_m > BESIDE_WITHIN_M or self._before_bumper(found):
                front_m = max(found.clearance_m, 0.0)
        return front_m

    def _before_bumper(self, found: Closest) -> bool:
        """Return whether the shortest line from the ego to a body points ahead rather than to the side."""
        yaw_rad = self._world.ego.yaw_rad
        return -(found.normal_x * math.cos(yaw_rad) + found.normal_y * math.sin(yaw_rad)) > AHEAD_COS

    def _walkers_around(self, nearest: _Nearest) -> None:
        ego = self._world.ego
        x_m, y_m, radius_m = ego.x_m, ego.y_m, self._ego_radius_m
        cos_yaw, sin_yaw = math.cos(ego.yaw_rad), math.sin(ego.yaw_rad)
        reach_m = 0.5 * ego.length_m + WAITING_RANGE_M
        for walker, body in self._walkers:
            dx, dy = walker.x_m - x_m, walker.y_m - y_m
            if not -15.0 < dx < 15.0 or not -15.0 < dy < 15.0:
                continue
            if 0.0 < dx * cos_yaw + dy * sin_yaw < reach_m:
                nearest.person_ahead |= abs(dy * cos_yaw - dx * sin_yaw) < WAITING_ASIDE_M
            bound_m = math.sqrt(dx * dx + dy * dy) - radius_m - 0.4
            if bound_m < nearest.pedestrian_m:
                self._engine.move(body, walker.x_m, walker.y_m, walker.yaw_rad, PERSON_HEIGHT_M)
                limit_m = nearest.pedestrian_m
                found = self._query(walker, body, CollisionKind.PEDESTRIAN, limit_m, nearest)
                if found is not None and found.clearance_m < nearest.pedestrian_m:
                    nearest.pedestrian_m = max(found.clearance_m, 0.0)

    def _query(
        self, mover: RoadUser, body: BodyId, kind: CollisionKind, limit_m: float, nearest: _Nearest
    ) -> Closest | None:
        """Return the position of a body relative to the ego, and update the nearest body."""
        found = self._engine.closest(self._ego_body, body, limit_m)
        if found is None:
            return None
        gap_m, normal_x, normal_y = found
        if gap_m < nearest.gap_m:
            ego = self._world.ego
            ego_x, ego_y = ego.speed_mps * math.cos(ego.yaw_rad), ego.speed_mps * math.sin(ego.yaw_rad)
            other_x = mover.speed_mps * math.cos(mover.yaw_rad)
            other_y = mover.speed_mps * math.sin(mover.yaw_rad)
            nearest.gap_m = max(gap_m, 0.0)
            nearest.closing_mps = (other_x - ego_x) * normal_x + (other_y - ego_y) * normal_y
            if gap_m <= 0.0 and abs(ego.speed_mps) > CREEPING_MPS:
                # Not the speed along the normal, which may point sideways even in a rear-end collision.
                impact_mps = math.hypot(other_x - ego_x, other_y - ego_y)
                nearest.collision = Collision(kind=kind, counterpart=mover.name, impact_speed_mps=impact_mps)
        return found

    def _fixtures_around(self, nearest: _Nearest) -> None:
        """Update the nearest body with static bodies, if the ego may have come near one since the last check."""
        ego = self._world.ego
        self._still_clear_m -= ego.speed_mps * 0.055
        if self._still_clear_m > min(nearest.gap_m, 1.0):
            return
        x_m, y_m, radius_m = ego.x_m, ego.y_m, self._ego_radius_m
        clear_m = FRONT_RANGE_M
        for still in self._fixtures:
            bound_m = math.hypot(still.x_m - x_m, still.y_m - y_m) - radius_m - still.radius_m
            if bound_m >= clear_m or bound_m > NEAR_M:
                clear_m = min(clear_m, bound_m)
                continue
            found = self._engine.closest(self._ego_body, still.body, NEAR_M)
            if found is None:
                clear_m = min(clear_m, NEAR_M)
                continue
            gap_m, normal_x, normal_y = found
            clear_m = min(clear_m, gap_m)
            if gap_m < nearest.gap_m:
                nearest.gap_m = max(gap_m, 0.0)
                nearest.closing_mps = -ego.speed_mps * (
                    math.cos(ego.yaw_rad) * normal_x + math.sin(ego.yaw_rad) * normal_y
                )
                if gap_m <= 0.0 and abs(ego.speed_mps) > CREEPING_MPS:
                    nearest.collision = Collision(
                        kind=still.kind, counterpart=still.name, impact_speed_mps=abs(ego.speed_mps)
                    )
        self._still_clear_m = clear_m

    def _light(self, time_s: float, bumper_m: float) -> tuple[LightState | None, float | None]:
        signals = self._world.signals
        if signals is None:
            return None, None
        length_m = self._world.ego.length_m
        for line_m in self._world.route.stop_line_stations_m:
            if bumper_m - length_m < line_m < bumper_m + FRONT_RANGE_M:
                return signals.main_at(time_s), line_m - bumper_m
        return None, None

    def _on_junction_or_crossing(self, station_m: float) -> bool:
        world = self._world
        on_road = station_m < world.leaves_road_m  # stations on a side street do not refer to the road
        if on_road and abs(station_m - world.road.crossing_m) < CROSSING_REACH_M + 2.0:
            return True
        ego = world.ego
        return any(
            math.hypot(ego.x_m - x_m, ego.y_m - y_m) < JUNCTION_REACH_M for x_m, y_m in self._junctions
        )


def _block(length_m: float, width_m: float, height_m: float, x_m: float, y_m: float, yaw_rad: float) -> Block:
    return Block(length_m=length_m, width_m=width_m, height_m=height_m, x_m=x_m, y_m=y_m, yaw_rad=yaw_rad)


def _mover_block(user: RoadUser, height_m: float) -> Block:
    """Return the body of a road user; one who is absent, at NaN, comes later."""
    x_m, y_m, yaw_rad = (0.0 if math.isnan(one) else one for one in (user.x_m, user.y_m, user.yaw_rad))
    return _block(user.length_m, user.width_m, height_m, x_m, y_m, yaw_rad)
