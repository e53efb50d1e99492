"""Reference drivers, who take the driving system's place in an encounter, and what they would have avoided.

What a reference driver avoids, a driving system should have avoided. It keeps its lane and its route, sees everybody
around it, obeys lights and limits, and brakes: it never swerves. *Careful* is the competent and careful human driver
of UN Regulation No. 157, Annex 3: it takes 0.4 s to judge a risk and 0.75 s to reach the brake, and its braking
builds up to 0.774 g within 0.6 s. *Ideal* brakes at once.

The regulation covers motorways: vehicles ahead, cutting in and cutting out. Here, a road user is a risk when it is,
or will be, in the ego's way, and the ego comes closer than the distance within which the careful driver can stop
short of it (Shalev-Shwartz, Shammah, Shashua, "On a formal model of safe and scalable self-driving cars", 2017,
definition 1, with the regulation's figures). A vehicle will be in the way if it goes on moving sideways as it does,
once it has left the middle of its lane by more than 0.375 m (the regulation's wandering zone); a person counts as
soon as they move towards the ego's way. On a wet road, a driver brakes no harder than the tyres allow, and reckons
with it. A driver who has stopped behind somebody waits until there is room to go on.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Final, NamedTuple

from brink.sim.driving.interface import (
    CONTROL_STEP_S,
    Command,
    EgoState,
    LightReading,
    Observation,
    PerceivedObstacle,
    PlanMode,
    PlanState,
)
from brink.sim.driving.system import ModularDriving
from brink.sim.encounter.specification import Kind
from brink.sim.encounter.world import EncounterWorld, ScriptedUser
from brink.sim.episode import Verdict
from brink.sim.plane import half_extents_m
from brink.sim.world.ego import GRAVITY_MPS2

COLLISION: Final = "no-collision@1"
AFTERWARDS_S: Final = 5.0
"""A driver who violates a requirement no later than this after the system has not avoided the violation."""
BRAKING_MPS2: Final = 0.774 * GRAVITY_MPS2
BUILD_UP_S: Final = 0.6
WANDERING_M: Final = 0.375
STANDSTILL_M: Final = 2.0
"""Gap at which the driver stops."""
RESTART_M: Final = 5.0
"""A driver who stands moves on once nobody in the way is closer than this."""
STANDING_MPS: Final = 0.1
HOLDING_MPS2: Final = 1.0
"""Deceleration that a standing driver demands in order to stay."""
SIDE_M: Final = 0.2
"""Room on either side that the driver wants to have."""
HEADWAY_S: Final = 2.0
"""Headway below which the driver does not accelerate."""
SIGHT_M: Final = 100.0
"""How far the driver sees."""
HORIZON_S: Final = 4.0
"""How far ahead in time the driver predicts what others do."""
CALM_S: Final = 0.5
"""How long a risk must be over before the driver lets go of the brake."""
ALERT_S: Final = 2.0
"""For how long after braking the driver reacts to another risk without delay."""
_KEEPS_COURSE_MPS: Final = 0.05
"""Below this speed across the way, a road user keeps its course."""
_EQUALLY_FAST_MPS: Final = 1e-6


class Driver(StrEnum):
    """A reference driver, in the order in which they are asked who would have avoided a violation."""

    CAREFUL = "careful"
    IDEAL = "ideal"


NOBODY: Final = "no"
"""Neither driver would have avoided the violation."""


class Avoidance(StrEnum):
    """How a reference driver avoided a violation."""

    BRAKING = "braking"
    """The driver had braked, for a road user or a red light, before the time of the violation."""
    DRIVING_ON = "driving on"
    """The driver had not: it had passed earlier, or kept its lane."""


def avoidance(violated_at_s: float, brakes_at_s: float | None) -> Avoidance:
    """Return how a reference driver avoided a violation.

    Args:
        violated_at_s: When the driving system violated the requirement.
        brakes_at_s: When the driver first braked; None if never.
    """
    braked = brakes_at_s is not None and brakes_at_s <= violated_at_s
    return Avoidance.BRAKING if braked else Avoidance.DRIVING_ON


@dataclass(frozen=True, slots=True, kw_only=True)
class Reactions:
    """How fast a driver reacts.

    Attributes:
        risk_perception_s: Time from a risk to the decision to brake.
        delay_s: Time from there to the first braking.
        build_up_s: Time from there to full braking.
    """

    risk_perception_s: float
    delay_s: float
    build_up_s: float


REACTIONS: Final[Mapping[Driver, Reactions]] = {
    Driver.CAREFUL: Reactions(risk_perception_s=0.4, delay_s=0.75, build_up_s=BUILD_UP_S),
    Driver.IDEAL: Reactions(risk_perception_s=0.0, delay_s=0.0, build_up_s=0.0),
}
_CAREFUL: Final = REACTIONS[Driver.CAREFUL]
_UNBRAKED_S: Final = _CAREFUL.risk_perception_s + _CAREFUL.delay_s + 0.5 * _CAREFUL.build_up_s
"""The careful driver stops as if driving on for this long and then braking in full."""


def avoids(
    requirement: str, violated_at_s: float, verdicts: Mapping[str, Verdict], contact_at_s: float | None
) -> bool:
    """Return whether a reference driver avoided a violation, and any contact, until `AFTERWARDS_S` after it.

    A driver who has stopped and is then driven into has not avoided the violation.

    Args:
        requirement: What the driving system violated.
        violated_at_s: When it did.
        verdicts: Verdicts on the driver's drive, by requirement.
        contact_at_s: When another road user first touched the driver's car, even while it stood; None if none did.
    """
    moments = [verdicts[name].violated_at_s for name in (requirement, COLLISION) if name in verdicts]
    until_s = violated_at_s + AFTERWARDS_S
    return all(moment_s is None or moment_s > until_s for moment_s in (*moments, contact_at_s))


def braking_mps2(friction: float) -> float:
    """Return the hardest deceleration of a driver on a road with this friction coefficient."""
    return min(BRAKING_MPS2, friction * GRAVITY_MPS2)


def stopping_distance_m(
    speed_mps: float, other_mps: float = 0.0, hardest_mps2: float = BRAKING_MPS2
) -> float:
    """Return the smallest gap at which the careful driver still stops short of another road user.

    Args:
        speed_mps: The driver's speed.
        other_mps: The other's speed along the driver's way; the other may brake as hard as the driver does. Negative
            if it comes the other way.
        hardest_mps2: The hardest deceleration of both.
    """
    own_m = speed_mps * _UNBRAKED_S + speed_mps * speed_mps / (2.0 * hardest_mps2)
    if other_mps >= 0.0:
        return STANDSTILL_M + max(0.0, own_m - other_mps * other_mps / (2.0 * hardest_mps2))
    return STANDSTILL_M + own_m - other_mps * (_UNBRAKED_S + speed_mps / hardest_mps2)


class ObservedUser(NamedTuple):
    """A road user as the driver sees it, relative to the driver's way.

    Attributes:
        kind: Kind of road user.
        gap_m: Clearance along the way from the driver's front bumper; negative beside or behind it.
        length_m: Extent along the way.
        aside_m: Clearance to the strip that the driver's car sweeps, or minus how far the body reaches into it.
        width_m: Extent across the way.
        along_mps: Speed along the way.
        towards_mps: Speed across the way, positive towards the strip.
        strayed_m: How far it has moved across the way since it last kept its course.
    """

    kind: Kind
    gap_m: float
    length_m: float
    aside_m: float
    width_m: float
    along_mps: float
    towards_mps: float
    strayed_m: float


def is_risk(
    sight: ObservedUser, speed_mps: float, car: tuple[float, float], hardest_mps2: float = BRAKING_MPS2
) -> bool:
    """Return whether a driver has to brake for a road user.

    Args:
        sight: The road user.
        speed_mps: The driver's speed.
        car: Length and width of the driver's car.
        hardest_mps2: The driver's hardest deceleration.
    """
    needed_m = stopping_distance_m(speed_mps, sight.along_mps, hardest_mps2)
    if sight.aside_m < SIDE_M:
        return -sight.length_m < sight.gap_m < needed_m
    if sight.towards_mps <= 0.0 or (sight.kind is not Kind.PEDESTRIAN and sight.strayed_m < WANDERING_M):
        return False
    enters_s = (sight.aside_m - SIDE_M) / sight.towards_mps
    if enters_s > HORIZON_S:
        return False
    leaves_s = enters_s + (sight.width_m + car[1] + 2.0 * SIDE_M) / sight.towards_mps
    if not _meets(sight, speed_mps, car[0], enters_s, leaves_s):
        return False
    return sight.gap_m < needed_m


def _meets(sight: ObservedUser, speed_mps: float, length_m: float, enters_s: float, leaves_s: float) -> bool:
    """Return whether the driver would meet a road user while it is in the driver's way."""
    ahead_m, behind_m = sight.gap_m - STANDSTILL_M, sight.gap_m + sight.length_m + length_m
    closing_mps = speed_mps - sight.along_mps
    if abs(closing_mps) < _EQUALLY_FAST_MPS:
        return ahead_m <= 0.0 <= behind_m
    times = sorted((ahead_m / closing_mps, behind_m / closing_mps))
    return times[0] <= leaves_s and times[1] >= enters_s


class ReferenceDriving:
    """A reference driver at the wheel of the ego. Implements `Driving`; create a new one for each episode.

    Args:
        world: The world, of which it knows the truth.
        driver: Which driver.
    """

    def __init__(self, world: EncounterWorld, driver: Driver) -> None:
        self._world = world
        self._reactions = REACTIONS[driver]
        self._hardest_mps2 = braking_mps2(world.weather.friction)
        self._alone = ModularDriving(world.route)
        self._course_m: dict[str, float] = {}
        self._risk_since_s: float | None = None
        self._risk_until_s = -math.inf
        self._braking_since_s: float | None = None
        self._calm_since_s = -math.inf
        self._held = False
        self._station_m = 0.0

    def step(self, observation: Observation) -> Command:
        """Run one control step and return its command."""
        time_s = observation.time_s
        ego = self._ego()
        boxes = None if observation.boxes is None else ()
        command = self._alone.step(
            Observation(time_s=time_s, ego=ego, boxes=boxes, light=self._light(time_s))
        )
        sights = [sight for user in self._world.road_users if (sight := self._sight(user, ego)) is not None]
        car = (self._world.ego.length_m, self._world.ego.width_m)
        risk = any(is_risk(sight, ego.speed_mps, car, self._hardest_mps2) for sight in sights)
        braking = self._brake(time_s, risk)
        if abs(ego.speed_mps) < STANDING_MPS and any(_blocks(sight) for sight in sights):
            braking = max(braking, HOLDING_MPS2)
        self._held = braking > 0.0
        if self._held:
            return Command(accel_mps2=min(command.accel_mps2, -braking), steer_rad=command.steer_rad)
        if any(_is_close(sight, ego.speed_mps) for sight in sights):
            return Command(accel_mps2=min(command.accel_mps2, 0.0), steer_rad=command.steer_rad)
        return command

    @property
    def plan(self) -> PlanState:
        """What the driver does: stop or cruise."""
        plan = self._alone.plan
        return plan._replace(mode=PlanMode.STOP, target_speed_mps=0.0) if self._held else plan

    @property
    def obstacles(self) -> tuple[PerceivedObstacle, ...]:
        """Always empty: the driver knows the ground truth."""
        return ()

    def _ego(self) -> EgoState:
        ego = self._world.ego
        self._station_m, offset_m = self._world.route.line.project(ego.x_m, ego.y_m, self._station_m)
        return EgoState(
            x_m=ego.x_m,
            y_m=ego.y_m,
            yaw_rad=ego.yaw_rad,
            speed_mps=ego.speed_mps,
            accel_mps2=ego.accel_mps2,
            station_m=self._station_m,
            offset_m=offset_m,
        )

    def _light(self, time_s: float) -> LightReading | None:
        signals = self._world.signals
        bumper_m = self._station_m + 0.5 * self._world.ego.length_m
        ahead = [line_m for line_m in self._world.route.stop_line_stations_m if line_m > bumper_m - 1.0]
        if signals is None or not ahead:
            return None
        return LightReading(state=signals.main_at(time_s), stop_line_station_m=min(ahead))

    def _sight(self, user: ScriptedUser, ego: EgoState) -> ObservedUser | None:
        """Return a road user as the driver sees it; None if it is behind the middle of the car, or far away."""
        dx, dy = user.x_m - ego.x_m, user.y_m - ego.y_m
        if math.hypot(dx, dy) > SIGHT_M:
            return None
        line = self._world.route.line
        station_m, offset_m = line.project(user.x_m, user.y_m, ego.station_m)
        if station_m < ego.station_m:
            return None
        turn = user.yaw_rad - line.pose_at(station_m)[2]
        half_along_m, half_across_m = half_extents_m(user.length_m, user.width_m, turn)
        across_mps = user.speed_mps * math.sin(turn)
        side = 1.0 if offset_m >= ego.offset_m else -1.0
        return ObservedUser(
            kind=user.kind,
            gap_m=station_m - half_along_m - ego.station_m - 0.5 * self._world.ego.length_m,
            length_m=2.0 * half_along_m,
            aside_m=abs(offset_m - ego.offset_m) - half_across_m - 0.5 * self._world.ego.width_m,
            width_m=2.0 * half_across_m,
            along_mps=user.speed_mps * math.cos(turn),
            towards_mps=-side * across_mps,
            strayed_m=self._strayed(user, offset_m, across_mps),
        )

    def _strayed(self, user: ScriptedUser, offset_m: float, across_mps: float) -> float:
        """Return how far a road user has moved across the way since it last kept its course."""
        if abs(across_mps) < _KEEPS_COURSE_MPS:
            self._course_m[user.name] = offset_m
        return abs(offset_m - self._course_m.setdefault(user.name, offset_m))

    def _brake(self, time_s: float, risk: bool) -> float:
        """Return the deceleration that the driver demands, 0 for none."""
        reactions = self._reactions
        if risk:
            self._risk_until_s = time_s
            if self._risk_since_s is None:
                self._risk_since_s = time_s
        elif self._risk_since_s is not None and time_s - self._risk_until_s > CALM_S:
            if self._braking_since_s is not None:
                self._calm_since_s = time_s
            self._risk_since_s = self._braking_since_s = None
        if self._risk_since_s is None:
            return 0.0
        if self._braking_since_s is None:
            alert = time_s - self._calm_since_s < ALERT_S
            wait_s = 0.0 if alert else reactions.risk_perception_s + reactions.delay_s
            if time_s - self._risk_since_s < wait_s - 0.5 * CONTROL_STEP_S:
                return 0.0
            self._braking_since_s = time_s
        since_s = time_s - self._braking_since_s + CONTROL_STEP_S
        build_up = 1.0 if reactions.build_up_s == 0.0 else min(1.0, since_s / reactions.build_up_s)
        return self._hardest_mps2 * build_up


def _blocks(sight: ObservedUser) -> bool:
    """Return whether a road user keeps a standing driver from moving on."""
    return sight.aside_m < SIDE_M and -sight.length_m < sight.gap_m < RESTART_M


def _is_close(sight: ObservedUser, speed_mps: float) -> bool:
    """Return whether a road user ahead is so close that the driver does not accelerate."""
    return sight.aside_m < SIDE_M and -sight.length_m < sight.gap_m < STANDSTILL_M + HEADWAY_S * speed_mps
