"""Other vehicles on a road: the lead vehicle, oncoming and crossing cars, and merging cars.

The scenario (road, weather, time of day) decides how they drive; the episode's seed only varies each vehicle around
its type. Every vehicle has its own random stream.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from brink.sim.driving.interface import LightState
from brink.sim.world.line import Piece, ReferenceLine
from brink.sim.world.pedestrians import Walker
from brink.sim.world.road import (
    CROSSING_WIDTH_M,
    PARKING_STRIP_M,
    SIDE_STREET_M,
    SPEED_LIMIT_MPS,
    STOP_LINE_BEFORE_CROSSING_M,
    Junction,
    Road,
    SignalPlan,
    exit_junction,
    joining_lane,
    side_lane,
    stream_lane,
    turn_begins_m,
    turn_piece,
)
from brink.sim.world.streams import Stream, generator
from brink.sim.world.vehicle import CAR, VAN, DrivingStyle, Mover, MustStop, PullOut, StopPoint, Vehicle
from brink.sim.world.weather import Conditions

JOINING_GAP_S = 4.5
"""Drivers merge into or cross a lane only if no vehicle on it would arrive within this time."""

MERGING_ROOM_M = 7.0
HALF_LANE_M = 1.9
"""Drivers do not merge where a vehicle is within `MERGING_ROOM_M` along and `HALF_LANE_M` across the lane."""

MOUTH_SETBACK_M = 2.5
"""Distance from the kerb line at which drivers wait to leave a side street."""

ROOM_TO_STOP_M = 28.0
NEAR_LANE_M = 2.5
"""Drivers stop for persons on a crossing who are this close to their lane, and not for those who have left it."""
LEAD_STARTS_AHEAD_M = 26.0
"""Distance between the centres of the ego and the lead vehicle at the start."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Surroundings:
    """What vehicles check to decide whether they may go. The lists are filled once all road users exist."""

    signals: SignalPlan | None
    movers: list[Mover]
    walkers: list[Walker]


def make_traffic(
    road: Road, weather: Conditions, around: Surroundings, *, seed: int, exit_right: bool | None
) -> list[Vehicle]:
    """Return all other vehicles of an episode, the lead vehicle first.

    Args:
        road: The road they drive on.
        weather: Sets how they drive.
        around: What they take into account.
        seed: The episode's seed.
        exit_right: Whether the ego takes the right exit (False: the left one); None if it follows the road.
    """
    builder = _TrafficBuilder(road=road, weather=weather, around=around, seed=seed)
    vehicles = [builder.lead(), *builder.oncoming()]
    if road.junctions[0].lit:
        vehicles += builder.crossing()
    else:
        vehicles.append(builder.joining())
    if road.style.parking:
        vehicles.append(builder.pulling_out())
    if exit_right is not None:
        vehicles.append(builder.local(right=exit_right))
    return vehicles


@dataclass(frozen=True, slots=True, kw_only=True)
class _TrafficBuilder:
    road: Road
    weather: Conditions
    around: Surroundings
    seed: int

    def _style(
        self, index: int, share: float = 1.0, slowdowns: tuple[tuple[float, float, float], ...] = ()
    ) -> DrivingStyle:
        rng = generator(self.seed, Stream.VEHICLE, index)
        variation = float(rng.normal(0.0, 0.02))
        speed = SPEED_LIMIT_MPS * self.weather.speed_share * self.road.style.pace * share
        return DrivingStyle(
            speed_mps=speed * (1.0 + variation),
            headway_s=self.weather.headway_s,
            braking_mps2=self.weather.braking_mps2,
            friction=self.weather.friction,
            slowdowns=slowdowns,
        )

    def lead(self) -> Vehicle:
        """Return the vehicle ahead of the ego; it slows down repeatedly, for no reason that the ego can perceive."""
        rng = generator(self.seed, Stream.VEHICLE, 100)
        main_stream = self.road.style.main_stream
        slowdowns = []
        for number in range(4):
            begins_s = 5.0 + 8.0 * number + float(rng.uniform(-0.7, 0.7))
            lasts_s = float(rng.uniform(2.4, 3.2))
            slowdowns.append((begins_s, begins_s + lasts_s, 0.3))
        path = stream_lane(self.road, main_stream)
        style = self._style(0, slowdowns=tuple(slowdowns))
        stops = self._stops(forward=True)
        if main_stream == 2:
            junction = exit_junction(self.road, right=False)
            stops.append(self._give_way_left(junction))
        return Vehicle(
            name="lead",
            size=CAR,
            path=path,
            station_m=LEAD_STARTS_AHEAD_M + float(rng.uniform(-1.0, 1.0)),
            speed_mps=style.speed_mps,
            style=style,
            stops=stops,
            phase=0,
        )

    def oncoming(self) -> list[Vehicle]:
        """Return the cars in the oncoming lane."""
        vehicles = []
        lane = self.road.backward
        distances_m = (65.0, 125.0, 180.0)
        for number, ahead_m in enumerate(distances_m if self.road.length_m > 180.0 else distances_m[:2]):
            rng = generator(self.seed, Stream.VEHICLE, 110 + number)
            style = self._style(10 + number)
            stops = self._stops(forward=False)
            station_m = lane.length_m - ahead_m + float(rng.uniform(-4.0, 4.0))
            for stop in stops:
                # Oncoming cars start far enough before a line to be able to stop there.
                if stop.station_m - ROOM_TO_STOP_M < station_m < stop.station_m + CAR.length_m:
                    station_m = stop.station_m - ROOM_TO_STOP_M
            vehicles.append(
                Vehicle(
                    name=f"oncoming-{number + 1}",
                    size=VAN if number == 1 else CAR,
                    path=lane,
                    station_m=station_m,
                    speed_mps=style.speed_mps,
                    style=style,
                    stops=stops,
                    phase=1 + number,
                )
            )
        return vehicles

    def crossing(self) -> list[Vehicle]:
        """Return the cars that cross at the lights, one from each side."""
        junction = self.road.junctions[0]
        vehicles = []
        for number, from_right in enumerate((True, False)):
            rng = generator(self.seed, Stream.VEHICLE, 120 + number)
            path = side_lane(junction, self.road.style.lane_width_m, from_right=from_right)
            line_m = SIDE_STREET_M - self.road.stop_line_before_junction_m
            style = self._style(3 + number)
            vehicles.append(
                Vehicle(
                    name=f"crossing-{number + 1}",
                    size=CAR,
                    path=path,
                    station_m=4.0 + float(rng.uniform(0.0, 16.0)),
                    speed_mps=style.speed_mps,
                    style=style,
                    stops=(StopPoint(line_m, self._side_red),),
                    phase=3 + number,
                )
            )
        return vehicles

    def joining(self) -> Vehicle:
        """Return a car that leaves the right side street and merges into the ego's lane when there is a gap."""
        rng = generator(self.seed, Stream.VEHICLE, 130)
        junction = self.road.junctions[0]
        path = joining_lane(self.road, junction)
        half_lane_m = 0.5 * self.road.style.lane_width_m
        mouth_m = SIDE_STREET_M - self.road.kerb_m - MOUTH_SETBACK_M
        point = self.road.forward.pose_at(junction.forward_m + half_lane_m)
        style = self._style(3, share=0.8)
        return Vehicle(
            name="joining",
            size=CAR,
            path=path,
            station_m=mouth_m - 14.0 + float(rng.uniform(-1.0, 1.0)),
            speed_mps=3.0,
            style=style,
            stops=(StopPoint(mouth_m, self._not_free(point)),),
            phase=3,
        )

    def pulling_out(self) -> Vehicle:
        """Return a parked car that pulls out into the ego's lane when there is a gap."""
        rng = generator(self.seed, Stream.VEHICLE, 140)
        lane = self.road.forward
        at_m = 0.62 * self.road.length_m
        style = self._style(6, share=0.7)
        return Vehicle(
            name="pulling-out",
            size=CAR,
            path=lane,
            station_m=at_m,
            speed_mps=0.0,
            style=style,
            stops=(
                StopPoint(at_m + 0.5 * CAR.length_m, self._not_free(lane.pose_at(at_m))),
                *self._stops(forward=True),
            ),
            pull_out=PullOut(-0.5 * (self.road.style.lane_width_m + PARKING_STRIP_M), at_m, 12.0),
            starts_s=4.0 + float(rng.uniform(-0.5, 0.5)),
            phase=1,
        )

    def local(self, *, right: bool) -> Vehicle:
        """Return a slow car in the street that the ego turns into."""
        rng = generator(self.seed, Stream.VEHICLE, 150)
        junction = exit_junction(self.road, right=right)
        width_m = self.road.style.lane_width_m
        begins_m = turn_begins_m(junction.forward_m, width_m, right=right)
        arc = turn_piece(right=right)
        path = self.road.forward.up_to(begins_m, arc, Piece(self.road.length_m))
        return Vehicle(
            name="local",
            size=VAN,
            path=path,
            station_m=begins_m + arc.length_m + 14.0 + float(rng.uniform(-1.5, 1.5)),
            speed_mps=0.0,
            style=self._style(5, share=0.55),
            starts_s=0.45 * begins_m / 8.0,
            phase=2,
        )

    def _stops(self, *, forward: bool) -> list[StopPoint]:
        """Return the stop point on a lane: at the traffic lights or, without any, at the pedestrian crossing."""
        lane = self.road.forward if forward else self.road.backward
        junction = self.road.junctions[0]
        if junction.lit:
            middle_m = junction.forward_m if forward else junction.backward_m
            return [StopPoint(middle_m - self.road.stop_line_before_junction_m, self._main_red)]
        crossing_m = _station_on(lane, self.road.centre, self.road.crossing_m, forward=forward)
        line_m = crossing_m - 0.5 * CROSSING_WIDTH_M - STOP_LINE_BEFORE_CROSSING_M
        return [StopPoint(line_m, self._people_cross)]

    def _main_red(self, vehicle: Vehicle, time_s: float) -> bool:
        signals = self.around.signals
        return signals is not None and signals.main_at(time_s) is not LightState.GREEN

    def _side_red(self, vehicle: Vehicle, time_s: float) -> bool:
        signals = self.around.signals
        return signals is not None and signals.side_at(time_s) is not LightState.GREEN

    def _people_cross(self, vehicle: Vehicle, time_s: float) -> bool:
        """Return whether somebody with priority is in the vehicle's way on the crossing, or about to be."""
        _, offset_m = self.road.centre.project(vehicle.x_m, vehicle.y_m, self.road.crossing_m)
        half_lane_m = 0.5 * self.road.style.lane_width_m
        lane_m = math.copysign(half_lane_m, offset_m)
        return any(
            walker.has_right_of_way and walker.is_near(lane_m, half_lane_m, NEAR_LANE_M)
            for walker in self.around.walkers
        )

    def _not_free(self, point: tuple[float, float, float]) -> MustStop:
        """Return a rule that makes a vehicle wait while a road user on the lane is about to arrive at a point."""
        x_m, y_m, yaw_rad = point

        def must_stop(vehicle: Vehicle, time_s: float) -> bool:
            return not lane_is_free(self.around.movers, vehicle, x_m, y_m, yaw_rad)

        return must_stop

    def _give_way_left(self, junction: Junction) -> StopPoint:
        """Return the point at which a vehicle turning left gives way to oncoming cars."""
        begins_m = turn_begins_m(junction.forward_m, self.road.style.lane_width_m, right=False)
        point = self.road.backward.pose_at(junction.backward_m)
        return StopPoint(begins_m, self._not_free(point))


def lane_is_free(
    movers: Sequence[Mover],
    asking: Mover,
    x_m: float,
    y_m: float,
    yaw_rad: float,
    gap_s: float = JOINING_GAP_S,
) -> bool:
    """Return whether no road user on a lane will reach a point within a time gap.

    Args:
        movers: All vehicles and the ego, the asking vehicle included.
        asking: The vehicle that wants to enter the lane; it is never in its own way.
        x_m: The point.
        y_m: The point.
        yaw_rad: Direction of the lane at the point.
        gap_s: The time gap.
    """
    cos_lane, sin_lane = math.cos(yaw_rad), math.sin(yaw_rad)
    for mover in movers:
        if mover is asking:
            continue
        dx, dy = x_m - mover.x_m, y_m - mover.y_m
        across_m = dy * cos_lane - dx * sin_lane
        if abs(across_m) < HALF_LANE_M and abs(dx * cos_lane + dy * sin_lane) < MERGING_ROOM_M:
            return False
        if mover.speed_mps < 0.3 or math.cos(mover.yaw_rad - yaw_rad) < 0.3:
            continue
        towards_m = dx * math.cos(mover.yaw_rad) + dy * math.sin(mover.yaw_rad)
        if 0.0 < towards_m < gap_s * mover.speed_mps + 3.0 and math.hypot(dx, dy) < 60.0:
            return False
    return True


def _station_on(lane: ReferenceLine, centre: ReferenceLine, station_m: float, *, forward: bool) -> float:
    x_m, y_m, _ = centre.pose_at(station_m)
    return lane.project(x_m, y_m, station_m if forward else lane.length_m - station_m)[0]
