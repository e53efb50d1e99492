"""The emergency brake: its regions to the pixel, and its latch to the frame."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from brink.sim.aeb.braking import PERSON, Detection, EmergencyBrake, Region

WARNING = Region.from_reference(730.0, 230.0, 1280, 720)
SMALL = Region.from_reference(730.0, 230.0, 640, 360)
COLUMN, ROW = st.floats(-50, 700, width=32), st.floats(-50, 360, width=32)


def box(x_min: float, y_min: float, x_max: float, y_max: float, label: str = "person") -> Detection:
    return Detection(label, x_min, y_min, x_max, y_max)


@pytest.mark.parametrize(
    ("candidate", "meets"),
    [
        (box(600, 300, 680, 600), True),
        (box(600, 300, 680, 469), False),  # ends above the region
        (box(280, 480, 490, 500), False),  # in the bounding rectangle, but not in the trapezoid
        (box(280, 480, 490, 719), True),  # its lower end reaches the wide part of the region
        (box(1004, 500, 1200, 720), True),  # touches the corner
        (box(1006, 500, 1200, 720), False),
        (box(0, 0, 1280, 720), True),
        (box(600, 700, 610, 900), True),  # extends below the picture
    ],
)
def test_a_box_is_tested_against_the_trapezoid_not_its_bounds(candidate: Detection, meets: bool) -> None:
    assert WARNING.intersects(candidate) is meets


def test_regions_scale_with_the_picture() -> None:
    for candidate in (box(280, 480, 500, 500), box(280, 480, 500, 719), box(1004, 500, 1200, 720)):
        half = Detection(candidate.label, *(0.5 * value for value in candidate[1:5]))
        assert SMALL.intersects(half) is WARNING.intersects(candidate)


def test_only_a_vehicle_in_the_lane_triggers_the_brake() -> None:
    brake = EmergencyBrake.for_picture(640, 360)
    beside, ahead = box(438, 150, 640, 360, "vehicle"), box(260, 200, 380, 300, "vehicle")
    farther = box(260, 180, 380, 230, "vehicle")
    assert not any(brake.decide(0.05 * frame, [beside, farther]) for frame in range(20))
    assert [brake.decide(1.0 + 0.05 * frame, [ahead]) for frame in range(4)] == [False, False, True, True]


def test_a_flickering_vehicle_does_not_trigger_the_brake() -> None:
    brake = EmergencyBrake.for_picture(640, 360)
    ahead = [box(260, 200, 380, 300, "vehicle")]
    assert not any(brake.decide(0.05 * frame, ahead if frame % 3 else []) for frame in range(30))


@pytest.mark.parametrize(
    ("person_frames", "reported", "braking"),
    [
        (1, "010000", "011111"),
        (2, "010010", "000000"),
        (2, "011000", "001111"),
        (2, "010100", "000111"),
        (3, "011011", "000000"),
        (3, "011100", "000111"),
    ],
)
def test_a_person_is_confirmed_in_some_of_three_frames(
    person_frames: int, reported: str, braking: str
) -> None:
    brake = EmergencyBrake.for_picture(1280, 720, person_frames=person_frames)
    person = box(600, 300, 680, 600)
    found = [
        brake.decide(0.05 * frame, [person] if flag == "1" else []) for frame, flag in enumerate(reported)
    ]
    assert "".join("1" if flag else "0" for flag in found) == braking


def test_the_latch_holds_and_releases() -> None:
    brake = EmergencyBrake.for_picture(1280, 720, hold_s=0.5, person_frames=1)
    person = [box(600, 300, 680, 600)]
    assert not brake.decide(0.0, [])
    assert brake.decide(0.05, person)
    assert all(brake.decide(0.05 * frame, []) for frame in range(2, 11))
    assert not brake.decide(0.55, [])
    assert brake.decide(0.60, person)


@pytest.mark.parametrize("first", range(0, 300, 7))
def test_a_hold_has_the_same_number_of_frames_whenever_it_begins(first: int) -> None:
    brake = EmergencyBrake.for_picture(1280, 720, hold_s=0.5, person_frames=1)
    assert brake.decide(first * 0.05, [box(600, 300, 680, 600)])
    assert sum(brake.decide((first + later) * 0.05, []) for later in range(1, 30)) == 9


@settings(deadline=None)
@given(COLUMN, COLUMN, ROW, ROW)
def test_a_box_intersects_the_region_if_any_of_its_rows_does(a: float, b: float, c: float, d: float) -> None:
    box = Detection(PERSON, min(a, b), min(c, d), max(a, b), max(c, d))
    rows = np.linspace(box.y_min_px, min(box.y_max_px, 360.0), 400)
    inside = rows[rows >= 235.0]
    half = 0.5 * (115.0 + (inside - 235.0) / 125.0 * 250.0)
    touches = bool(np.any((box.x_min_px <= 320 + half) & (box.x_max_px >= 320 - half)))
    assert SMALL.intersects(box) is touches
