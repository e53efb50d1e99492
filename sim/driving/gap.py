"""Longitudinal laws: keeping a gap, and stopping at a point. Plain functions of what is perceived now.

The gap law is the interaction part of the intelligent driver model (Treiber, Hennecke and Helbing 2000): it knows
only the gap, the own speed and the other's, so whatever a box says about its distance and motion acts at once and in
proportion. It brakes comfortably from far away, which a wet road allows; a late appearance is an emergency.
"""

import math

from brink.sim.driving.settings import FollowSettings

NO_LIMIT_MPS2 = 100.0
"""What a law answers that asks for nothing."""


def follow_accel(settings: FollowSettings, speed_mps: float, gap_m: float, other_mps: float) -> float:
    """Return the highest acceleration in m/s^2 that keeps a gap to what is ahead.

    Args:
        settings: Gaps and accelerations.
        speed_mps: The ego's speed.
        gap_m: From the front bumper to the obstacle; negative if inside.
        other_mps: The obstacle's speed along the route, negative if it comes towards the ego.
    """
    hardest = -settings.max_decel_mps2
    if gap_m <= 0.1:
        return hardest
    accel, decel = settings.accel_mps2, settings.decel_mps2
    standstill_m = settings.standstill_gap_m
    if speed_mps < 0.3 and other_mps < 0.5 and gap_m < standstill_m + settings.hold_gap_m:
        return -1.0
    closing = speed_mps - other_mps
    dynamic_m = speed_mps * settings.time_gap_s + speed_mps * closing / (2.0 * math.sqrt(accel * decel))
    ratio = (standstill_m + (dynamic_m if dynamic_m > 0.0 else 0.0)) / gap_m
    wanted = accel * (1.0 - ratio * ratio)
    if closing > 0.0:
        room_m = max(gap_m - settings.reserve_gap_m, 0.2)
        if other_mps > 0.0:
            needed = closing * closing / (2.0 * room_m)
        else:
            # What comes towards the ego takes its share of the room while the ego stops.
            needed = speed_mps * (speed_mps - 2.0 * other_mps) / (2.0 * room_m)
        if needed > settings.emergency_above_mps2:
            return max(hardest, -settings.emergency_factor * needed)
    # Without an emergency, the model's own reaction to a short gap is bounded by what a wet road gives.
    return max(wanted, -settings.emergency_above_mps2)


def stop_accel(decel_mps2: float, gain_per_s: float, speed_mps: float, distance_m: float) -> float:
    """Return the highest acceleration in m/s^2 that stops the ego within a distance.

    Follows the speed profile sqrt(2 decel distance): far away it asks for nothing, on the profile for `decel_mps2`,
    above it for more.

    Args:
        decel_mps2: Comfortable braking, > 0.
        gain_per_s: How firmly the profile is followed.
        speed_mps: The ego's speed.
        distance_m: To the point where it should stand; negative if past it.
    """
    if distance_m <= 0.0:
        return -max(decel_mps2, gain_per_s * speed_mps)
    allowed_mps = math.sqrt(2.0 * decel_mps2 * distance_m)
    return gain_per_s * (allowed_mps - speed_mps) - decel_mps2
