"""The roll-out: motion by actions alone, inside the road's edges and the kinds' speeds."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from brink.search.actions.participants import FASTEST_MPS, Action, Gene, Kind, Participant
from brink.search.actions.road import RoadLimits
from brink.search.actions.rollout import padded_waypoints, rolled_out, waypoints
from brink.search.actions.rule import participants_component, participants_of
from brink.search.space import SearchSpace

ROAD = RoadLimits()
CROSSROAD = RoadLimits(streets_m=(30.0,))


def gene(action: Action, duration_s: float, magnitude: float = 0.0) -> Gene:
    return Gene(action=action, duration_s=duration_s, magnitude=magnitude)


def car(*genes: Gene, ds_m: float = 20.0, dd_m: float = 0.0, speed_mps: float = 8.0) -> Participant:
    heading = 0.0 if dd_m < 1.75 else math.pi
    return Participant(
        kind=Kind.CAR, ds_m=ds_m, dd_m=dd_m, dyaw_rad=heading, speed_mps=speed_mps, genes=genes
    )


def person(*genes: Gene, dd_m: float = -3.0) -> Participant:
    return Participant(kind=Kind.PEDESTRIAN, ds_m=20.0, dd_m=dd_m, dyaw_rad=0.0, speed_mps=1.0, genes=genes)


def test_waypoints_of_a_vehicle_that_slows_down_and_stops() -> None:
    # 8 m/s for 2 s: 16 m. Then 4 m/s2 for 2 s: 8 m, and it stands.
    ends = waypoints(car(gene(Action.KEEP, 2.0), gene(Action.BRAKE, 5.0, 4.0)), ROAD)
    assert ends.tolist() == [[36.0, 0.0], [44.0, 0.0]]


def test_an_oncoming_vehicle_comes_nearer_and_its_left_is_the_egos_lane() -> None:
    ends = waypoints(car(gene(Action.CHANGE_LEFT, 2.0, 1.0), ds_m=40.0, dd_m=3.5), ROAD)
    assert ends == pytest.approx(np.array([[24.0, 0.0]]))


def test_a_cut_in_ends_in_the_egos_lane_and_is_slower() -> None:
    stretches = rolled_out(car(gene(Action.CUT_IN, 2.0, 1.0), ds_m=10.0, dd_m=0.6), ROAD)
    s_m, d_m, speed = stretches[-1].end
    assert (s_m, d_m, speed) == pytest.approx((24.0, 0.0, 6.0))


def test_nobody_is_faster_than_its_kind_nor_leaves_the_carriageway() -> None:
    stretches = rolled_out(
        car(gene(Action.ACCELERATE, 6.0, 3.0), gene(Action.CHANGE_RIGHT, 2.0, 1.0), speed_mps=14.0), ROAD
    )
    assert stretches[-1].end[2] == FASTEST_MPS[Kind.CAR]
    assert stretches[-1].end[1] == pytest.approx(-0.85)  # half of 3.5 m less half of 1.8 m


def test_a_person_crosses_to_the_far_pavement_and_waits_there() -> None:
    stretches = rolled_out(person(gene(Action.CROSS, 6.0, 2.2), gene(Action.CROSS, 6.0, 2.2)), ROAD)
    first = [stretch for stretch in stretches if stretch.gene == 0]
    assert first[-1].end[:2] == pytest.approx((20.0, 7.8))
    assert stretches[-1].end[:2] == pytest.approx((20.0, -4.3))


def test_a_person_on_the_carriageway_walks_on_to_the_other_side() -> None:
    crossing = person(gene(Action.CROSS, 1.0, 1.5), gene(Action.KEEP, 0.5))
    stretches = rolled_out(crossing, ROAD, 20.0)
    assert {round(stretch.s_m, 6) for stretch in stretches} == {20.0}
    assert stretches[-1].end[1] == pytest.approx(7.8)
    frozen = rolled_out(person(gene(Action.CROSS, 1.5, 2.0), gene(Action.BRAKE, 1.0, 8.0)), ROAD, 20.0)
    assert frozen[-1].end[1] == pytest.approx(0.25)  # 3 m, and .25 m until it stands


def test_who_comes_out_of_a_street_crosses_straight() -> None:
    comes = Participant(
        kind=Kind.VAN, ds_m=31.75, dd_m=-20.0, dyaw_rad=0.5 * math.pi, speed_mps=10.0,
        genes=(gene(Action.KEEP, 1.0), gene(Action.CHANGE_LEFT, 1.0, 1.0)),
    )  # fmt: skip
    assert waypoints(comes, CROSSROAD) == pytest.approx(np.array([[31.75, -10.0], [31.75, 0.0]]))


@given(st.integers(0, 2**32 - 1), st.booleans())
def test_motion_is_continuous_and_inside_its_limits(seed: int, at_crossroad: bool) -> None:
    road = CROSSROAD if at_crossroad else ROAD
    component = participants_component("participants", 3, road)
    rule = participants_of(SearchSpace((component,)))[1]
    for one in rule.read(component.sample(np.random.default_rng(seed))):
        stretches = rolled_out(one, road, 40.0)
        assert stretches[0].from_s == 0.0
        assert stretches[-1].from_s + stretches[-1].lasts_s >= 40.0 - 1e-6
        assert {stretch.gene for stretch in stretches} == set(range(len(one.genes)))
        for before, after in pairwise(stretches):
            assert after.from_s == pytest.approx(before.from_s + before.lasts_s)
            assert (after.s_m, after.d_m) == pytest.approx(before.end[:2])
            if not one.on_foot:
                assert after.speed_mps == pytest.approx(before.end[2], abs=1e-6)
        outer_m = road.pavement_m + 1e-6
        for stretch in stretches:
            for d_m, speed in ((stretch.d_m, stretch.speed_mps), stretch.end[1:]):
                assert -1e-9 <= speed <= FASTEST_MPS[one.kind] + 1e-9
                if math.cos(one.dyaw_rad) ** 2 > 0.5:
                    assert road.right_kerb_m - outer_m <= d_m <= road.left_kerb_m + outer_m
                    assert one.on_foot or road.on_carriageway(d_m)


def test_padded_waypoints_say_where_nobody_is() -> None:
    points, actions = padded_waypoints([[car(gene(Action.KEEP, 1.0), gene(Action.KEEP, 1.0))], []], 2, ROAD)
    assert actions.tolist() == [[2.0, 0.0], [0.0, 0.0]]
    assert points[0, 0, :2].tolist() == [[28.0, 0.0], [36.0, 0.0]]
    assert np.isnan(points[0, 0, 2:]).all()
    assert np.isnan(points[1]).all()
