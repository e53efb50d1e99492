import pytest
from hypothesis import given
from hypothesis import strategies as st

from brink.sim.driving.interface import Box, ObstacleLabel
from brink.sim.driving.localisation import Place
from brink.sim.driving.settings import TrackingSettings
from brink.sim.driving.tracking import AlphaBetaTracker, Track

SETTINGS = TrackingSettings()


def place(
    x_m: float,
    y_m: float = 0.0,
    *,
    label: ObstacleLabel = ObstacleLabel.VEHICLE,
    sigma_m: float = 0.1,
    column_px: float = 400.0,
) -> Place:
    box = Box(label=label, x_min_px=column_px, x_max_px=column_px + 60.0, y_min_px=300.0, y_max_px=360.0)
    return Place(label, x_m, y_m, 1.8, 4.5, sigma_m, False, box)


def run(tracker: AlphaBetaTracker, steps: range, *places_at: tuple[float, float]) -> list[Track]:
    """Feed places that start at x and move at vx."""
    tracks: list[Track] = []
    for step in steps:
        tracks = tracker.update(
            0.1 * step,
            [
                place(x_m + speed * 0.1 * step, column_px=100.0 * n)
                for n, (x_m, speed) in enumerate(places_at)
            ],
        )
    return tracks


def test_a_track_is_believed_at_its_second_hit() -> None:
    tracker = AlphaBetaTracker(SETTINGS)
    assert tracker.update(0.0, [place(20.0)]) == []
    assert len(tracker.update(0.1, [place(20.0)])) == 1


def test_a_single_flash_never_becomes_a_track() -> None:
    tracker = AlphaBetaTracker(SETTINGS)
    for step in range(20):
        assert tracker.update(0.1 * step, [place(20.0)] if step % 2 == 0 else []) == []


def test_a_track_survives_four_misses_and_dies_at_the_fifth() -> None:
    tracker = AlphaBetaTracker(SETTINGS)
    run(tracker, range(5), (20.0, 0.0))
    alive = [len(tracker.update(0.5 + 0.1 * miss, [])) for miss in range(6)]
    assert alive == [1, 1, 1, 1, 0, 0]


def test_a_track_keeps_its_number_through_a_short_gap() -> None:
    tracker = AlphaBetaTracker(SETTINGS)
    (before,) = run(tracker, range(10), (20.0, 5.0))
    for miss in range(4):
        tracker.update(1.0 + 0.1 * miss, [])
    (after,) = tracker.update(1.4, [place(20.0 + 5.0 * 1.4)])
    assert after.number == before.number


def test_a_missed_track_goes_on_at_its_velocity() -> None:
    tracker = AlphaBetaTracker(SETTINGS)
    run(tracker, range(10), (20.0, 5.0))
    (track,) = tracker.update(1.2, [])
    assert track.x_m == pytest.approx(20.0 + 5.0 * 1.2, abs=0.05)


@given(speed=st.floats(-15.0, 15.0))
def test_the_velocity_of_steady_motion_is_found_within_half_a_second(speed: float) -> None:
    (track,) = run(AlphaBetaTracker(SETTINGS), range(5), (20.0, speed))
    assert track.vx_mps == pytest.approx(speed, abs=0.05)
    assert track.vy_mps == pytest.approx(0.0, abs=1e-9)


def test_far_places_move_the_velocity_less_than_near_ones() -> None:
    def shaken(sigma_m: float) -> float:
        tracker = AlphaBetaTracker(SETTINGS)
        fastest = 0.0
        for step in range(40):
            x_m = 30.0 + (0.5 if step % 2 else -0.5)
            for track in tracker.update(0.1 * step, [place(x_m, sigma_m=sigma_m)]):
                fastest = max(fastest, abs(track.vx_mps)) if step > 20 else fastest
        return fastest

    assert shaken(3.0) < shaken(0.05)
    assert shaken(3.0) < 1.0


def test_labels_are_never_mixed() -> None:
    tracker = AlphaBetaTracker(SETTINGS)
    run(tracker, range(3), (20.0, 0.0))
    person = place(20.0, label=ObstacleLabel.PERSON)
    tracker.update(0.3, [person])
    labels = [track.label for track in tracker.update(0.4, [person])]
    assert labels == [ObstacleLabel.VEHICLE, ObstacleLabel.PERSON]


def test_two_obstacles_side_by_side_keep_apart() -> None:
    tracks = run(AlphaBetaTracker(SETTINGS), range(30), (20.0, 4.0), (24.0, -1.0))
    assert [round(track.vx_mps, 2) for track in tracks] == [4.0, -1.0]


def test_a_box_that_stays_in_place_in_the_image_is_followed_however_far_it_jumps_on_the_ground() -> None:
    tracker = AlphaBetaTracker(SETTINGS)
    run(tracker, range(3), (20.0, 0.0))
    (track,) = tracker.update(0.3, [place(28.0, column_px=0.0)])
    assert track.misses == 0


def test_what_stands_is_known_to_stand_until_it_moves() -> None:
    tracker = AlphaBetaTracker(SETTINGS)
    (track,) = run(tracker, range(40), (20.0, 0.0))
    assert track.standing_since_s == pytest.approx(0.2)
    for step in range(40, 70):
        (track,) = tracker.update(0.1 * step, [place(20.0 + 3.0 * 0.1 * (step - 39))])
    assert track.standing_since_s is None


def test_passing_what_stands_does_not_make_it_move() -> None:
    tracker = AlphaBetaTracker(SETTINGS)
    run(tracker, range(10), (20.0, 0.0))
    for step in range(10, 20):
        (track,) = tracker.update(0.1 * step, [place(20.0 + 0.3 * (step - 9))._replace(is_cut=True)])
    assert (track.x_m, track.vx_mps) == pytest.approx((20.0, 0.0))
