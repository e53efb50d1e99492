"""Every constant of the driving system, with its unit. The defaults make a good driver when perception is perfect."""

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
    """How a box becomes a place.

    Attributes:
        vehicle_height_m: Assumed height of a vehicle that is placed by its size.
        person_height_m: Assumed height of a person that is placed by their size.
        vehicle_width_m: Assumed width of a vehicle.
        vehicle_length_m: Assumed length of a vehicle.
        person_size_m: Assumed extent of a person.
        min_extent_m: Nothing is taken to be narrower or shorter.
        max_ground_range_m: Bottom edges that mean a farther place are not trusted: the box is placed by its size.
        min_range_m: Nothing is placed nearer to the camera than this.
        pixel_noise_px: Assumed error of a bottom edge, one standard deviation.
        border_px: A box that comes as near to the image's left or right border may go on beyond it.
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


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackingSettings:
    """How places become tracks.

    Attributes:
        birth_hits: Hits after which a track is believed.
        death_misses: Misses in a row after which a believed track is dropped; an unbelieved one goes at the first.
        gate_m: A place may lie this far from where its track is expected...
        gate_per_sigma: ...plus this many standard deviations of its range.
        min_overlap: A box that overlaps its track's last box by this much (intersection over union) belongs to
            it, wherever it was placed.
        manoeuvre_mps2: Acceleration to be expected of others; larger follows faster and smooths less.
        floor_sigma_m: Standard deviation of a place, besides what its pixels cause.
        min_position_gain: Least share of a position error that is corrected at once.
        min_velocity_gain: Least share of a velocity error that is corrected at once.
        cut_velocity_share: A box that the image's border cuts moves as the border lets it: its velocity errors count
            by this share only.
        extent_gain: Share of the width's error that is corrected at once.
        max_speed_mps: No track is believed to be faster.
        stands_below_mps: What was slower stands...
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
    """How far ahead others are predicted.

    Attributes:
        horizon_s: Constant velocity along and across the route for this long.
    """

    horizon_s: float = 3.0


@dataclass(frozen=True, slots=True, kw_only=True)
class SpeedSettings:
    """How fast the road may be driven.

    Attributes:
        cruise_mps: Speed on a free straight road.
        limit_margin_mps: Stays this far below the speed limit.
        lateral_accel_mps2: Comfortable lateral acceleration in curves; low enough for a wet road.
        curve_decel_mps2: Comfortable braking before curves.
        min_curve_mps: No curve is taken slower.
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
    """How a gap is kept (intelligent driver model), and how hard the ego may brake for it.

    Attributes:
        standstill_gap_m: Bumper to bumper behind what stands.
        time_gap_s: Besides, this long at the present speed.
        accel_mps2: Comfortable acceleration.
        decel_mps2: Comfortable braking.
        hold_gap_m: A standing ego stays where it is until the gap exceeds the standstill gap by this much.
        reserve_gap_m: Emergency braking means to keep this gap.
        emergency_above_mps2: Braking that must be harder than this is an emergency.
        emergency_factor: An emergency is braked this many times harder than needed.
        max_decel_mps2: Hardest braking ever asked for; the road may give less.
        range_m: What is farther ahead is not looked at.
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
    """When the ego stops for persons and for crossing vehicles.

    Attributes:
        person_gap_m: Stops this far before a person's station.
        person_margin_m: Free space kept to a person beside the ego's body.
        vehicle_margin_m: The same for a vehicle that crosses.
        crossing_above_mps: Whoever moves across the route faster than this may be heading into the path.
        vehicle_crossing_above_mps: A vehicle crosses if it moves across the route faster than this...
        vehicle_crossing_slope: ...and than this share of its speed along it; less is a bend, seen badly.
        time_margin_s: The ego goes first only if it is past this long before the other comes.
        decel_mps2: Comfortable braking for a stop.
        approach_gain_per_s: How firmly the braking profile is followed.
        hold_s: Goes on yielding this long after the reason has gone.
        stay_margin_m: Free space is wanted wider by this for whom the ego already yields to.
        pass_slowly_within_m: Someone who stands this close beside the body is passed slowly...
        pass_person_mps: ...at this speed.
        range_m: Persons farther ahead are not looked at.
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


@dataclass(frozen=True, slots=True, kw_only=True)
class LightSettings:
    """How red and amber lights are met.

    Attributes:
        stop_margin_m: Stops this far before the stop line.
        decel_mps2: Comfortable braking.
        approach_gain_per_s: How firmly the braking profile is followed.
        amber_go_above_mps2: At amber the ego goes on if stopping would need harder braking.
        red_go_above_mps2: At red the ego goes on if stopping would need harder braking (it would end past the line).
        confirm_s: A change of a light is believed once it was reported for this long.
        memory_s: A light that is no longer reported is believed for this long.
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
    """How the ego moves over within its lane.

    Attributes:
        clearance_m: Free space wanted beside the ego's body.
        edge_margin_m: The ego's body stays this far inside its lane.
        stay_margin_m: What blocked the lane must leave this much more room before it is passed.
        hold_s: Keeps the offset this long after the reason has gone.
        rate_mps: How fast the wanted offset moves.
        look_ahead_m: What is farther ahead is no reason yet.
        creep_mps: Speed while the ego has not yet moved over.
        stop_gap_m: Stops if it comes this close before it has moved over.
        tight_clearance_m: What leaves less room than this is passed slowly...
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
    """When and how the ego passes through the oncoming lane.

    Attributes:
        standing_s: Overtakes what it believes has stood for this long.
        min_gap_m: Cannot pull out from nearer than this.
        max_gap_m: Does not think of it from farther away.
        easy_gap_m: From nearer than this the ego swings out wider...
        swing_share: ...by this share of what is missing.
        clearance_m: Free space beside the obstacle.
        min_clearance_m: Goes on while there is at least this.
        speed_mps: Speed in the oncoming lane.
        creep_mps: Speed until the obstacle is cleared sideways.
        rate_mps: How fast the wanted offset moves.
        blind_gap_m: What was nearer than this when it went out of sight is remembered: the ego has turned away.
        oncoming_mps: Oncoming vehicles are taken to be at least this fast.
        pull_out_s: Time that moving out and in again takes, on top of the way.
        return_gap_m: Returns when its rear is this far past the obstacle.
        margin_m: The oncoming lane must exist this far beyond the obstacle.
        light_margin_m: Never overtakes where a stop line lies within this beyond the obstacle: it may be a queue.
        give_up_s: Returns at the latest after this long.
        rest_s: Does not try again for this long after giving up.
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
    """How the plan becomes steering and acceleration.

    Attributes:
        look_ahead_s: Pure pursuit looks this long ahead at the present speed...
        min_look_ahead_m: ...but at least this far...
        max_look_ahead_m: ...and at most this far.
        speed_gain_per_s: PID: proportional.
        speed_integral_per_s2: PID: integral.
        speed_derivative: PID: derivative, on the measured acceleration.
        integral_limit_mps2: Bound of the integral's share.
        accel_mps2: Most acceleration of the speed PID.
        decel_mps2: Most braking of the speed PID.
        jerk_mps3: Acceleration rises no faster than this; braking is never delayed.
        steer_rate_radps: Steering angle changes no faster than this.
        hold_below_mps: Slower than this, an ego that should stop is held by the brakes...
        hold_decel_mps2: ...this hard.
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
