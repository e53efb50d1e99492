"""The brake: its regions to the pixel, its latch to the frame."""

import pytest

from brink.sim.aeb.braking import Detection, EmergencyBrake, Region

WARNING = Region.scaled(730.0, 230.0, 1280, 720)


def box(x_min: float, y_min: float, x_max: float, y_max: float, label: str = "person") -> Detection:
    return Detection(label, x_min, y_min, x_max, y_max)


def test_corners_are_those_of_the_paper() -> None:
    assert WARNING.corners() == ((525.0, 470.0), (755.0, 470.0), (1005.0, 720.0), (275.0, 720.0))
    assert EmergencyBrake.for_picture(1280, 720).danger.corners()[0] == (550.0, 470.0)


@pytest.mark.parametrize(
    ("candidate", "meets"),
    [
        (box(600, 300, 680, 600), True),
        (box(600, 300, 680, 469), False),  # ends above it
        (box(280, 480, 490, 500), False),  # in the rectangle around the trapezoid, not in the trapezoid
        (box(280, 480, 490, 719), True),  # its lower end reaches the wide part
        (box(1004, 500, 1200, 720), True),  # touches the corner
        (box(1006, 500, 1200, 720), False),
        (box(0, 0, 1280, 720), True),
        (box(600, 700, 610, 900), True),  # goes on below the picture
    ],
)
def test_a_box_meets_the_trapezoid_and_not_the_rectangle_around_it(candidate: Detection, meets: bool) -> None:
    assert WARNING.meets(candidate) is meets


def test_regions_scale_with_the_picture() -> None:
    small = Region.scaled(730.0, 230.0, 640, 360)
    for candidate in (box(280, 480, 500, 500), box(280, 480, 500, 719), box(1004, 500, 1200, 720)):
        half = Detection(candidate.label, *(0.5 * value for value in candidate[1:5]))
        assert small.meets(half) is WARNING.meets(candidate)


def test_a_vehicle_beside_the_lane_does_not_brake_and_one_in_it_does() -> None:
    brake = EmergencyBrake.for_picture(640, 360)
    beside, ahead = box(438, 150, 640, 360, "vehicle"), box(260, 200, 380, 300, "vehicle")
    farther = box(260, 180, 380, 230, "vehicle")
    assert not any(brake.decide(0.05 * frame, [beside, farther]) for frame in range(20))
    assert [brake.decide(1.0 + 0.05 * frame, [ahead]) for frame in range(4)] == [False, False, True, True]


def test_a_vehicle_that_flickers_does_not_brake() -> None:
    brake = EmergencyBrake.for_picture(640, 360)
    ahead = [box(260, 200, 380, 300, "vehicle")]
    assert not any(brake.decide(0.05 * frame, ahead if frame % 3 else []) for frame in range(30))


def test_the_latch_holds_and_lets_go() -> None:
    brake = EmergencyBrake.for_picture(1280, 720, hold_s=0.5)
    person = [box(600, 300, 680, 600)]
    assert not brake.decide(0.0, [])
    assert brake.decide(0.05, person)
    assert all(brake.decide(0.05 * frame, []) for frame in range(2, 11))
    assert not brake.decide(0.55, [])
    assert brake.decide(0.60, person)


def test_a_brake_that_is_off_never_brakes() -> None:
    brake = EmergencyBrake.for_picture(1280, 720, enabled=False)
    assert not brake.decide(0.0, [box(600, 300, 680, 600)])
