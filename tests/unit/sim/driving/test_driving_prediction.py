import math

import pytest
from driving_loop import road
from hypothesis import given
from hypothesis import strategies as st

from brink.sim.driving.interface import Box, EgoState, ObstacleLabel
from brink.sim.driving.localisation import Place
from brink.sim.driving.prediction import ConstantVelocityPredictor, RoadObstacle
from brink.sim.driving.settings import PredictionSettings
from brink.sim.driving.tracking import Track
from brink.sim.world.line import Piece

BOX = Box(label=ObstacleLabel.VEHICLE, x_min_px=0.0, x_max_px=1.0, y_min_px=0.0, y_max_px=1.0)


def obstacle(right_m: float, left_m: float, across_mps: float) -> RoadObstacle:
    return RoadObstacle(
        track=1,
        label=ObstacleLabel.PERSON,
        near_m=20.0,
        far_m=20.5,
        right_m=right_m,
        left_m=left_m,
        across_mps=across_mps,
    )


def test_a_person_who_walks_into_the_strip_is_predicted_there_from_entering_to_leaving() -> None:
    # From 3.5 m to the right with 0.5 m width at 1.5 m/s: 2 m to the strip's edge, 4.5 m to have left it.
    assert obstacle(-3.5, -3.0, 1.5).time_in(-1.0, 1.0) == pytest.approx((2.0 / 1.5, 3.0))
    assert obstacle(-3.5, -3.0, 3.0).time_in(-1.0, 1.0) == pytest.approx((2.0 / 3.0, 1.5))


def test_who_walks_away_or_too_slowly_is_not_predicted_in_the_strip() -> None:
    assert obstacle(-3.5, -3.0, -1.5).time_in(-1.0, 1.0) is None
    assert obstacle(-3.5, -3.0, 0.5).time_in(-1.0, 1.0) is None
    assert obstacle(1.5, 2.0, 1.0).time_in(-1.0, 1.0) is None


@given(
    right_m=st.floats(-8.0, 8.0),
    width_m=st.floats(0.1, 3.0),
    across_mps=st.floats(-5.0, 5.0),
)
def test_prediction_agrees_with_stepping_through_time(
    right_m: float, width_m: float, across_mps: float
) -> None:
    one = obstacle(right_m, right_m + width_m, across_mps)
    window = one.time_in(-1.0, 1.0)
    for step in range(31):
        time_s = 0.1 * step
        moved = obstacle(right_m + across_mps * time_s, right_m + width_m + across_mps * time_s, across_mps)
        is_in = moved.overlaps(-1.0 - 1e-9, 1.0 + 1e-9)
        if window is not None and window[0] + 1e-6 < time_s < window[1] - 1e-6:
            assert is_in
        if is_in and moved.overlaps(-1.0 + 1e-6, 1.0 - 1e-6) and time_s < 3.0:
            assert window is not None
            assert window[0] - 1e-6 <= time_s <= window[1] + 1e-6


def test_on_a_bend_velocity_is_split_along_and_across_the_route() -> None:
    route = road(Piece(20.0), Piece(30.0, 1 / 30), Piece(50.0))
    x_m, y_m, yaw_rad = route.pose_at(35.0, 3.5)
    track = Track(1, Place(ObstacleLabel.VEHICLE, x_m, y_m, 1.8, 4.5, 0.1, False, BOX))
    ego = EgoState(
        x_m=10.0, y_m=0.0, yaw_rad=0.0, speed_mps=8.0, accel_mps2=0.0, station_m=10.0, offset_m=0.0
    )
    track.vx_mps, track.vy_mps = -6.0 * math.cos(yaw_rad), -6.0 * math.sin(yaw_rad)
    (found,) = ConstantVelocityPredictor(route, PredictionSettings()).predict(1.0, ego, [track])
    assert (found.near_m, found.far_m) == pytest.approx((32.75, 37.25))
    assert (found.right_m, found.left_m) == pytest.approx((2.6, 4.4))
    assert (found.along_mps, found.across_mps) == pytest.approx((-6.0, 0.0))
