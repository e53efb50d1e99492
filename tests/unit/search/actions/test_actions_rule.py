"""Participants on a road: whatever comes in, what comes out can be driven."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from brink.search.actions.participants import (
    LEAST_ACTIONS,
    LONGEST_S,
    OF_PEDESTRIANS,
    OF_VEHICLES,
    SHORTEST_S,
    Action,
    Gene,
    Kind,
    Participant,
    magnitude_of,
    share_of,
)
from brink.search.actions.placing import Box, Start, ego_box
from brink.search.actions.road import RoadLimits
from brink.search.actions.rule import Participants, participants_component, participants_of
from brink.search.errors import SpaceError, UnsupportedSpace
from brink.search.space import Component, Real, SearchSpace

ROADS = (
    RoadLimits(),
    RoadLimits(lane_width_m=3.2, strip_m=2.1, pavement_m=2.0),
    RoadLimits(streets_m=(30.0,), clear_ahead_m=20.0),
)
COMPONENTS = [participants_component("participants", 4, road) for road in ROADS]

roads = st.integers(0, len(ROADS) - 1)
vectors = arrays(
    np.float64,
    COMPONENTS[0].dimension,
    elements=st.floats(allow_nan=True, allow_infinity=True, width=64) | st.floats(-60, 60),
)


def rule_of(component: Component) -> Participants:
    return participants_of(SearchSpace((component,)))[1]


def start_of(one: Participant) -> Start:
    return Start(one.ds_m, one.dd_m, one.dyaw_rad)


@given(vectors, st.integers(0, 2**32 - 1), roads)
def test_whatever_is_repaired_complies_and_then_stays(
    vector: NDArray[np.float64], seed: int, road: int
) -> None:
    component, rng = COMPONENTS[road], np.random.default_rng(seed)
    mended = component.repair(vector, rng)
    assert list(component.problems(mended)) == []
    assert np.array_equal(component.repair(mended, rng), mended)


@given(st.integers(0, 2**32 - 1), roads)
def test_everybody_starts_where_it_belongs_and_on_nobody(seed: int, road: int) -> None:
    component, limits = COMPONENTS[road], ROADS[road]
    somebody = rule_of(component).read(component.sample(np.random.default_rng(seed)))
    assert 1 <= len(somebody) <= 4
    boxes = [ego_box(limits), *(Box.of(one.kind, start_of(one)) for one in somebody)]
    assert not any(a.meets(b) for i, a in enumerate(boxes) for b in boxes[:i])
    for one in somebody:
        assert len(one.genes) >= LEAST_ACTIONS
        assert all(SHORTEST_S <= gene.duration_s <= LONGEST_S for gene in one.genes)
        if one.on_foot:
            assert not limits.on_carriageway(one.dd_m)
            assert all(gene.action in OF_PEDESTRIANS for gene in one.genes)
        else:
            assert all(gene.action in OF_VEHICLES for gene in one.genes)
            if limits.on_carriageway(one.dd_m):
                assert one.dyaw_rad in (0.0, math.pi)
                assert one.dyaw_rad == 0.0 or one.dd_m > 0.5 * limits.lane_width_m
            else:
                assert limits.streets_m
                assert abs(one.dyaw_rad) == 0.5 * math.pi


def test_a_vehicle_between_the_lanes_takes_the_nearer_lane_and_heading() -> None:
    component = COMPONENTS[0]
    rule = rule_of(component)
    keeps = (Gene(action=Action.KEEP, duration_s=2.0, magnitude=0.0),) * 2
    car = Participant(kind=Kind.CAR, ds_m=30.0, dd_m=2.2, dyaw_rad=-2.0, speed_mps=99.0, genes=keeps)
    (mended,) = rule.read(component.repair(rule.written((car,)), np.random.default_rng(0)))
    assert (mended.dd_m, mended.dyaw_rad, mended.speed_mps) == (2.65, math.pi, 15.0)


def test_who_starts_on_the_ego_or_on_another_is_moved_along_the_lane() -> None:
    component = COMPONENTS[0]
    rule = rule_of(component)
    keeps = (Gene(action=Action.KEEP, duration_s=2.0, magnitude=0.0),) * 2
    car = Participant(kind=Kind.CAR, ds_m=2.0, dd_m=0.0, dyaw_rad=0.0, speed_mps=8.0, genes=keeps)
    mended = rule.read(component.repair(rule.written((car, car)), np.random.default_rng(0)))
    assert [one.dd_m for one in mended] == [0.0, 0.0]
    assert [one.ds_m for one in mended] == pytest.approx([18.2, -14.2])


def test_an_action_that_does_not_fit_its_kind_is_replaced() -> None:
    component = COMPONENTS[0]
    rule = rule_of(component)
    cut_in = Gene(action=Action.CUT_IN, duration_s=9.0, magnitude=1.5)
    cross = Gene(action=Action.CROSS, duration_s=0.1, magnitude=1.9)
    person = Participant(
        kind=Kind.PEDESTRIAN, ds_m=20.0, dd_m=-4.0, dyaw_rad=0.0, speed_mps=1.0, genes=(cut_in,)
    )
    car = Participant(kind=Kind.CAR, ds_m=30.0, dd_m=0.0, dyaw_rad=0.0, speed_mps=8.0, genes=(cross, cross))
    walker, driver = rule.read(component.repair(rule.written((person, car)), np.random.default_rng(0)))
    assert [gene.action for gene in walker.genes] == [Action.CROSS, Action.KEEP]
    assert walker.genes[0].duration_s == LONGEST_S
    assert [gene.action for gene in driver.genes] == [Action.KEEP, Action.KEEP]
    assert driver.genes[0] == Gene(action=Action.KEEP, duration_s=SHORTEST_S, magnitude=0.0)


@given(st.integers(0, 2**32 - 1), roads)
def test_what_is_read_can_be_written_again(seed: int, road: int) -> None:
    component = COMPONENTS[road]
    rule = rule_of(component)
    vector = component.sample(np.random.default_rng(seed))
    assert rule.written(rule.read(vector)) == pytest.approx(vector)


@given(st.sampled_from(Action), st.floats(0, 1))
def test_magnitudes_and_shares_are_each_others_inverse(action: Action, share: float) -> None:
    if action is not Action.KEEP:
        assert share_of(action, magnitude_of(action, share)) == pytest.approx(share)


def test_what_cannot_be_is_refused() -> None:
    keep = Gene(action=Action.KEEP, duration_s=2.0, magnitude=0.0)
    car = Participant(kind=Kind.CAR, ds_m=30.0, dd_m=0.0, dyaw_rad=0.0, speed_mps=8.0, genes=(keep,) * 9)
    rule = rule_of(COMPONENTS[0])
    with pytest.raises(SpaceError, match="at most 8 actions, got 9"):
        rule.written((car,))
    with pytest.raises(SpaceError, match="at most 4 participants, got 5"):
        rule.written((car,) * 5)
    with pytest.raises(SpaceError, match="expected 1 to 6, got 7"):
        participants_component("participants", 7, ROADS[0])
    with pytest.raises(SpaceError, match="expected the parameter"):
        Component("participants", (Real("x", 0.0, 1.0),), (Participants(1, ROADS[0]),))
    with pytest.raises(UnsupportedSpace, match="participants with timed actions"):
        participants_of(SearchSpace((Component("x", (Real("x", 0.0, 1.0),)),)))
    with pytest.raises(SpaceError, match=r"lanes of 2\.5 m or more"):
        RoadLimits(lane_width_m=1.0)


def test_a_value_that_does_not_go_with_the_rest_is_named() -> None:
    component = COMPONENTS[0]
    vector = np.array(component.sample(np.random.default_rng(3)))
    vector[1] = 0.0
    vector[2] = 0.0
    assert any("p1." in problem for problem in component.problems(vector))
