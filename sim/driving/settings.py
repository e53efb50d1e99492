"""All constants of the driving system. With perfect perception, the defaults drive well."""

from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True, kw_only=True)
class VehicleShape:
    """The ego's body; its reference point is the centre of the box.

    Attributes:
        length_m: Bumper to bumper.
        width_m: Without mirrors.
        wheelbase_m: Axle to axle, centred in the body.
        max_steer_rad: Steering angle at full lock.
    """

    length_m: float = 4.5
    width_m: float = 1.8
    wheelbase_m: float = 2.7
    max_steer_rad: float = 0.6


@dataclass(frozen=True, slots=True, kw_only=True)
class LocalisationSettings:
    """Constants of localisation.

    Attributes:
        vehicle_height_m: Assumed height of a vehicle that is placed by its size.
        person_height_m: Assumed height of a person who is placed by their size.
        vehicle_width_m: Assumed width of a vehicle.
        vehicle_length_m: Assumed length of a vehicle.
        person_size_m: Assumed extent of a person.
        min_extent_m: Minimum width and length of an obstacle.
        max_ground_range_m: Bottom edges that imply a farther place are not trusted; the box is placed by its size.
        min_range_m: Minimum distance from the camera.
        pixel_noise_px: Assumed standard deviation of a bottom edge.
        border_px: A box this close to the left or right image border may extend beyond it.
        pitch_rad_per_mps2: Assumed pitch of the camera, for each m/s^2 of the ego's acceleration.
    """

    vehicle_height_m: float = 1.5
    person_height_m: float = 1.7
    vehicle_width_m: float = 1.9
    vehicle_length_m: float = 4.5
    person_size_m: float = 0.5
    min_extent_m: float = 0.4
    max_ground_range_m: float = 80.0
    min_range_m: float = 1.0
    pixel_noise_px: float = 1.0
    border_px: float = 2.0
    pitch_rad_per_mps2: float = 0.0032


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackingSettings:
    """Constants of tracking.

    Attributes:
        birth_hits: Hits that confirm a track.
        death_misses: Misses in a row that end a confirmed track; a tentative one ends at the first.
        gate_m: Maximum distance of a place from its track's predicted position...
        gate_per_sigma: ...plus this many standard deviations of its range.
        min_overlap: A box that overlaps its track's last box by at least this intersection over union belongs to the
            track, wherever it was placed.
        manoeuvre_mps2: Expected acceleration of others; a larger value follows faster and smooths less.
        floor_sigma_m: Standard deviation of a place, in addition to the effect of pixel noise.
        min_position_gain: Lower bound of the position gain.
        min_velocity_gain: Lower bound of the velocity gain.
        cut_velocity_share: Factor on the velocity gain of boxes cut by the image border, which move with the border.
        extent_gain: Gain on the errors of width and length.
        max_speed_mps: Upper bound of a track's speed.
        stands_below_mps: A track slower than this is standing...
        moves_above_mps: ...until it is faster than this.
    """

    birth_hits: int = 2
    death_misses: int = 5
    gate_m: float = 2.0
    gate_per_sigma: float = 3.0
    min_overlap: float = 0.3
    manoeuvre_mps2: float = 4.0
    floor_sigma_m: float = 0.1
    min_position_gain: float = 0.35
    min_velocity_gain: float = 0.08
    cut_velocity_share: float = 0.2
    extent_gain: float = 0.5
    max_speed_mps: float = 25.0
    stands_below_mps: float = 0.7
    moves_above_mps: float = 1.4


@dataclass(frozen=True, slots=True, kw_only=True)
class PredictionSettings:
    """Constants of prediction.

    Attributes:
        horizon_s: Prediction horizon.
    """

    horizon_s: float = 3.0


@dataclass(frozen=True, slots=True, kw_only=True)
class SpeedSettings:
    """Constants of the speed profile.

    Attributes:
        cruise_mps: Speed on a free straight road.
        limit_margin_mps: Margin below the speed limit.
        lateral_accel_mps2: Comfortable lateral acceleration in curves; low enough for a wet road.
        curve_decel_mps2: Comfortable braking before curves.
        min_curve_mps: Minimum speed in curves.
        grid_m: Step of the speed profile.
    """

    cruise_mps: float = 8.0
    limit_margin_mps: float = 0.3
    lateral_accel_mps2: float = 1.8
    curve_decel_mps2: float = 1.2
    min_curve_mps: float = 2.5
    grid_m: float = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class FollowSettings:
    """Constants of the gap law (intelligent driver model) and of emergency braking.

    Attributes:
        standstill_gap_m: Gap to a standing obstacle, bumper to bumper.
        time_gap_s: Additional gap, as a time at the current speed.
        accel_mps2: Comfortable acceleration.
        decel_mps2: Comfortable braking.
        hold_gap_m: A standing ego stays where it is until the gap exceeds the standstill gap by this much.
        reserve_gap_m: Gap that emergency braking aims to keep.
        emergency_above_mps2: Necessary braking above this is an emergency.
        emergency_factor: Braking in an emergency, as a multiple of the necessary braking.
        max_decel_mps2: Hardest braking ever commanded; the road may allow less.
        range_m: Obstacles farther ahead are ignored.
    """

    standstill_gap_m: float = 4.0
    time_gap_s: float = 1.3
    accel_mps2: float = 1.8
    decel_mps2: float = 2.2
    hold_gap_m: float = 1.0
    reserve_gap_m: float = 2.5
    emergency_above_mps2: float = 3.0
    emergency_factor: float = 1.3
    max_decel_mps2: float = 8.0
    range_m: float = 60.0


@dataclass(frozen=True, slots=True, kw_only=True)
class YieldSettings:
    """Constants of giving way to persons and crossing vehicles.

    Attributes:
        person_gap_m: Distance to stop before a person's station.
        person_margin_m: Free space to keep between a person and the ego's body.
        vehicle_margin_m: The same for a crossing vehicle.
        crossing_above_mps: A person who moves across the route faster than this may be heading into the path.
        vehicle_crossing_above_mps: A vehicle crosses if it moves across the route faster than this...
        vehicle_crossing_slope: ...and faster than this share of its speed along the route; less is a misperceived
            bend.
        time_margin_s: The ego goes first only if it is clear this long before the other arrives.
        decel_mps2: Comfortable braking for a stop.
        approach_gain_per_s: Feedback gain on the braking profile.
        hold_s: The ego keeps yielding this long after the reason is gone.
        stay_margin_m: Additional free space to those whom the ego already yields to.
        pass_slowly_within_m: A person this close beside the body is passed slowly...
        pass_person_mps: ...at this speed.
        range_m: Persons farther ahead are ignored.
        zebra_kerb_m: On a crossing, persons have priority up to this far behind the kerb on the right...
        zebra_left_m: ...and this far to the left of the path, unless they are walking away.
        zebra_along_mps: Persons who walk along the road faster than this are passing the crossing by.
        zebra_gap_m: Distance to stop before the crossing.
    """

    person_gap_m: float = 3.5
    person_margin_m: float = 0.6
    vehicle_margin_m: float = 0.5
    crossing_above_mps: float = 0.3
    vehicle_crossing_above_mps: float = 1.0
    vehicle_crossing_slope: float = 0.8
    time_margin_s: float = 1.0
    decel_mps2: float = 2.0
    approach_gain_per_s: float = 2.0
    hold_s: float = 0.8
    stay_margin_m: float = 0.4
    pass_slowly_within_m: float = 1.0
    pass_person_mps: float = 4.0
    range_m: float = 45.0
    zebra_kerb_m: float = 0.9
    zebra_left_m: float = 2.5
    zebra_along_mps: float = 0.6
    zebra_gap_m: float = 1.5


@dataclass(frozen=True, slots=True, kw_only=True)
class LightSettings:
    """Constants of the traffic light law.

    Attributes:
        stop_margin_m: Distance to stop before the stop line.
        decel_mps2: Comfortable braking.
        approach_gain_per_s: Feedback gain on the braking profile.
        amber_go_above_mps2: At amber the ego continues if stopping would need harder braking.
        red_go_above_mps2: At red the ego continues if stopping would need harder braking (it would end past the
            line).
        confirm_s: A change of state counts after it has been reported for this long.
        memory_s: A light that is no longer reported is remembered for this long.
    """

    stop_margin_m: float = 1.0
    decel_mps2: float = 1.8
    approach_gain_per_s: float = 2.0
    amber_go_above_mps2: float = 2.8
    red_go_above_mps2: float = 6.5
    confirm_s: float = 0.12
    memory_s: float = 1.5


@dataclass(frozen=True, slots=True, kw_only=True)
class NudgeSettings:
    """Constants of nudging.

    Attributes:
        clearance_m: Free space beside the ego's body.
        edge_margin_m: Distance to keep between the ego's body and the edge of its lane.
        stay_margin_m: Additional room that an obstacle must leave before it is passed, once it has blocked the lane.
        hold_s: The offset is kept this long after its cause is gone.
        rate_mps: Rate at which the path offset moves.
        look_ahead_m: Obstacles farther ahead do not cause a nudge yet.
        creep_mps: Minimum speed until the ego has moved over.
        stop_gap_m: The ego stops this close to an obstacle if it has not moved over.
        tight_clearance_m: An obstacle that leaves less room than this is passed slowly...
        pass_speed_mps: ...at this speed.
    """

    clearance_m: float = 0.35
    edge_margin_m: float = 0.15
    stay_margin_m: float = 0.15
    hold_s: float = 1.0
    rate_mps: float = 1.0
    look_ahead_m: float = 30.0
    creep_mps: float = 2.0
    stop_gap_m: float = 2.2
    tight_clearance_m: float = 0.5
    pass_speed_mps: float = 6.0


@dataclass(frozen=True, slots=True, kw_only=True)
class OvertakeSettings:
    """Constants of overtaking.

    Attributes:
        standing_s: A vehicle must have stood this long to be overtaken.
        min_gap_m: Minimum gap from which the ego can pull out.
        max_gap_m: Maximum gap from which overtaking is considered.
        easy_gap_m: From a smaller gap than this the ego swings out wider...
        swing_share: ...by this share of the difference.
        clearance_m: Free space beside the obstacle.
        min_clearance_m: Free space below which the ego does not go on.
        speed_mps: Speed in the oncoming lane.
        creep_mps: Speed until the obstacle is cleared sideways.
        rate_mps: Rate at which the path offset moves.
        blind_gap_m: An obstacle that was closer than this when it left the image is remembered: the ego has turned
            away.
        oncoming_mps: Minimum assumed speed of oncoming vehicles.
        pull_out_s: Time for moving out and back, in addition to the driving time.
        return_gap_m: The ego returns when its rear is this far past the obstacle.
        margin_m: The oncoming lane must extend this far beyond the obstacle.
        light_margin_m: No overtaking if a stop line lies within this distance beyond the obstacle, which may be
            queueing.
        give_up_s: The ego returns after this long at the latest.
        rest_s: Pause before the next attempt after giving up.
    """

    standing_s: float = 3.0
    min_gap_m: float = 3.6
    max_gap_m: float = 20.0
    easy_gap_m: float = 9.0
    swing_share: float = 0.25
    clearance_m: float = 0.6
    min_clearance_m: float = 0.3
    speed_mps: float = 5.5
    creep_mps: float = 2.2
    rate_mps: float = 2.2
    blind_gap_m: float = 4.5
    oncoming_mps: float = 8.0
    pull_out_s: float = 2.5
    return_gap_m: float = 2.0
    margin_m: float = 12.0
    light_margin_m: float = 30.0
    give_up_s: float = 15.0
    rest_s: float = 4.0


@dataclass(frozen=True, slots=True, kw_only=True)
class ControlSettings:
    """Constants of the controller.

    Attributes:
        look_ahead_s: Look-ahead of pure pursuit, as a time at the current speed...
        min_look_ahead_m: ...but at least this far...
        max_look_ahead_m: ...and at most this far.
        speed_gain_per_s: Proportional gain of the PID.
        speed_integral_per_s2: Integral gain of the PID.
        speed_derivative: Derivative gain of the PID, on the measured acceleration.
        integral_limit_mps2: Bound of the integral term.
        accel_mps2: Largest acceleration of the PID.
        decel_mps2: Hardest braking of the PID.
        jerk_mps3: Largest rate at which acceleration rises; braking is never delayed.
        steer_rate_radps: Largest rate of the steering angle.
        hold_below_mps: An ego that should stop is held by the brakes below this speed...
        hold_decel_mps2: ...with this deceleration.
        period_s: Control period, at 20 Hz.
    """

    look_ahead_s: float = 0.8
    min_look_ahead_m: float = 3.5
    max_look_ahead_m: float = 9.0
    speed_gain_per_s: float = 1.2
    speed_integral_per_s2: float = 0.25
    speed_derivative: float = 0.05
    integral_limit_mps2: float = 1.5
    accel_mps2: float = 1.8
    decel_mps2: float = 2.5
    jerk_mps3: float = 3.0
    steer_rate_radps: float = 1.2
    hold_below_mps: float = 0.2
    hold_decel_mps2: float = 2.0
    period_s: float = 0.05


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanningSettings:
    """The planner's constants, by behaviour."""

    speed: SpeedSettings = field(default_factory=SpeedSettings)
    follow: FollowSettings = field(default_factory=FollowSettings)
    give_way: YieldSettings = field(default_factory=YieldSettings)
    light: LightSettings = field(default_factory=LightSettings)
    nudge: NudgeSettings = field(default_factory=NudgeSettings)
    overtake: OvertakeSettings = field(default_factory=OvertakeSettings)


@dataclass(frozen=True, slots=True, kw_only=True)
class DrivingSettings:
    """All constants of the driving system, by part."""

    shape: VehicleShape = field(default_factory=VehicleShape)
    localisation: LocalisationSettings = field(default_factory=LocalisationSettings)
    tracking: TrackingSettings = field(default_factory=TrackingSettings)
    prediction: PredictionSettings = field(default_factory=PredictionSettings)
    planning: PlanningSettings = field(default_factory=PlanningSettings)
    control: ControlSettings = field(default_factory=ControlSettings)
