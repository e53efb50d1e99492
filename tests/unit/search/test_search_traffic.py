"""Traffic participants: repair on a road, kinematic roll-out, and distances between solutions."""

import math
from dataclasses import replace
from itertools import pairwise, permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from brink.search.errors import SpaceError, UnsupportedSpace
from brink.search.space import Component, Real, SearchSpace
from brink.search.traffic.constraint import (
    Box,
    Participants,
    Start,
    ego_box,
    participants_component,
    participants_of,
)
from brink.search.traffic.motion import (
    HORIZON_S,
    STEP_S,
    UNMATCHED_M,
    Distance,
    Rollouts,
    encounter_distances,
    matched_distance,
    matched_distances,
    participant_distances,
    positions,
    roll_out,
    trajectory_distances,
    waypoints,
)
from brink.search.traffic.participants import (
    MAX_DURATION_S,
    MAX_SPEEDS_MPS,
    MIN_ACTIONS,
    MIN_DURATION_S,
    PEDESTRIAN_ACTIONS,
    VEHICLE_ACTIONS,
    Action,
    Gene,
    Kind,
    Participant,
    RoadLimits,
    magnitude_of,
    share_of,
)

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
def test_repaired_participants_are_valid_and_stay(vector: NDArray[np.float64], seed: int, road: int) -> None:
    component, rng = COMPONENTS[road], np.random.default_rng(seed)
    repaired = component.repair(vector, rng)
    assert list(component.problems(repaired)) == []
    assert np.array_equal(component.repair(repaired, rng), repaired)


@given(st.integers(0, 2**32 - 1), roads)
def test_participants_start_in_allowed_places_clear_of_each_other(seed: int, road: int) -> None:
    component, limits = COMPONENTS[road], ROADS[road]
    participants = rule_of(component).decode(component.sample(np.random.default_rng(seed)))
    assert 1 <= len(participants) <= 4
    boxes = [ego_box(limits), *(Box.of(one.kind, start_of(one)) for one in participants)]
    assert not any(a.overlaps(b) for i, a in enumerate(boxes) for b in boxes[:i])
    for one in participants:
        assert len(one.genes) >= MIN_ACTIONS
        assert all(MIN_DURATION_S <= gene.duration_s <= MAX_DURATION_S for gene in one.genes)
        if one.on_foot:
            assert not limits.on_carriageway(one.dd_m)
            assert all(gene.action in PEDESTRIAN_ACTIONS for gene in one.genes)
        else:
            assert all(gene.action in VEHICLE_ACTIONS for gene in one.genes)
            if limits.on_carriageway(one.dd_m):
                assert one.dyaw_rad in (0.0, math.pi)
                assert one.dyaw_rad == 0.0 or one.dd_m > 0.5 * limits.lane_width_m
            else:
                assert limits.streets_m
                assert abs(one.dyaw_rad) == 0.5 * math.pi


def test_vehicle_between_the_lanes_takes_the_nearer_lane_and_its_heading() -> None:
    component = COMPONENTS[0]
    rule = rule_of(component)
    keeps = (Gene(action=Action.KEEP, duration_s=2.0, magnitude=0.0),) * 2
    car = Participant(kind=Kind.CAR, ds_m=30.0, dd_m=2.2, dyaw_rad=-2.0, speed_mps=99.0, genes=keeps)
    (repaired,) = rule.decode(component.repair(rule.encode((car,)), np.random.default_rng(0)))
    assert (repaired.dd_m, repaired.dyaw_rad, repaired.speed_mps) == (2.65, math.pi, 15.0)


def test_overlapping_participants_are_moved_along_the_lane() -> None:
    component = COMPONENTS[0]
    rule = rule_of(component)
    keeps = (Gene(action=Action.KEEP, duration_s=2.0, magnitude=0.0),) * 2
    car = Participant(kind=Kind.CAR, ds_m=2.0, dd_m=0.0, dyaw_rad=0.0, speed_mps=8.0, genes=keeps)
    repaired = rule.decode(component.repair(rule.encode((car, car)), np.random.default_rng(0)))
    assert [one.dd_m for one in repaired] == [0.0, 0.0]
    assert [one.ds_m for one in repaired] == pytest.approx([18.2, -14.2])


def test_action_that_does_not_fit_the_kind_is_replaced() -> None:
    component = COMPONENTS[0]
    rule = rule_of(component)
    cut_in = Gene(action=Action.CUT_IN, duration_s=9.0, magnitude=1.5)
    cross = Gene(action=Action.CROSS, duration_s=0.1, magnitude=1.9)
    person = Participant(
        kind=Kind.PEDESTRIAN, ds_m=20.0, dd_m=-4.0, dyaw_rad=0.0, speed_mps=1.0, genes=(cut_in,)
    )
    car = Participant(kind=Kind.CAR, ds_m=30.0, dd_m=0.0, dyaw_rad=0.0, speed_mps=8.0, genes=(cross, cross))
    walker, driver = rule.decode(component.repair(rule.encode((person, car)), np.random.default_rng(0)))
    assert [gene.action for gene in walker.genes] == [Action.CROSS, Action.KEEP]
    assert walker.genes[0].duration_s == MAX_DURATION_S
    assert [gene.action for gene in driver.genes] == [Action.KEEP, Action.KEEP]
    assert driver.genes[0] == Gene(action=Action.KEEP, duration_s=MIN_DURATION_S, magnitude=0.0)


@given(st.integers(0, 2**32 - 1), roads)
def test_encoding_reverses_decoding(seed: int, road: int) -> None:
    component = COMPONENTS[road]
    rule = rule_of(component)
    vector = component.sample(np.random.default_rng(seed))
    assert rule.encode(rule.decode(vector)) == pytest.approx(vector)


@given(st.sampled_from(Action), st.floats(0, 1))
def test_share_of_reverses_magnitude_of(action: Action, share: float) -> None:
    if action is not Action.KEEP:
        assert share_of(action, magnitude_of(action, share)) == pytest.approx(share)


def test_impossible_participants_are_rejected() -> None:
    keep = Gene(action=Action.KEEP, duration_s=2.0, magnitude=0.0)
    car = Participant(kind=Kind.CAR, ds_m=30.0, dd_m=0.0, dyaw_rad=0.0, speed_mps=8.0, genes=(keep,) * 9)
    rule = rule_of(COMPONENTS[0])
    with pytest.raises(SpaceError, match="at most 8 actions, got 9"):
        rule.encode((car,))
    with pytest.raises(SpaceError, match="at most 4 participants, got 5"):
        rule.encode((car,) * 5)
    with pytest.raises(SpaceError, match="expected a count of 1 to 6, got 7"):
        participants_component("participants", 7, ROADS[0])
    with pytest.raises(SpaceError, match="expected the parameter"):
        Component("participants", (Real("x", 0.0, 1.0),), (Participants(1, ROADS[0]),))
    with pytest.raises(UnsupportedSpace, match="participants with timed actions"):
        participants_of(SearchSpace((Component("x", (Real("x", 0.0, 1.0),)),)))
    with pytest.raises(SpaceError, match=r"lanes of at least 2\.5 m"):
        RoadLimits(lane_width_m=1.0)


def test_inconsistent_value_is_named() -> None:
    component = COMPONENTS[0]
    vector = np.array(component.sample(np.random.default_rng(3)))
    vector[1] = 0.0
    vector[2] = 0.0
    assert any("p1." in problem for problem in component.problems(vector))


ROAD = RoadLimits()
CROSSROAD = RoadLimits(streets_m=(30.0,))


def timed(action: Action, duration_s: float, magnitude: float = 0.0) -> Gene:
    return Gene(action=action, duration_s=duration_s, magnitude=magnitude)


def vehicle(*genes: Gene, ds_m: float = 20.0, dd_m: float = 0.0, speed_mps: float = 8.0) -> Participant:
    heading = 0.0 if dd_m < 1.75 else math.pi
    return Participant(
        kind=Kind.CAR, ds_m=ds_m, dd_m=dd_m, dyaw_rad=heading, speed_mps=speed_mps, genes=genes
    )


def person(*genes: Gene, dd_m: float = -3.0) -> Participant:
    return Participant(kind=Kind.PEDESTRIAN, ds_m=20.0, dd_m=dd_m, dyaw_rad=0.0, speed_mps=1.0, genes=genes)


def test_waypoints_of_a_braking_vehicle() -> None:
    # 8 m/s for 2 s: 16 m. Then 4 m/s2 for 2 s: 8 m, and it stops.
    ends = waypoints(vehicle(timed(Action.KEEP, 2.0), timed(Action.BRAKE, 5.0, 4.0)), ROAD)
    assert ends.tolist() == [[36.0, 0.0], [44.0, 0.0]]


def test_oncoming_vehicle_approaches_and_changes_left_into_the_egos_lane() -> None:
    ends = waypoints(vehicle(timed(Action.CHANGE_LEFT, 2.0, 1.0), ds_m=40.0, dd_m=3.5), ROAD)
    assert ends == pytest.approx(np.array([[24.0, 0.0]]))


def test_pedestrian_crosses_to_the_far_pavement_and_waits() -> None:
    stretches = roll_out(person(timed(Action.CROSS, 6.0, 2.2), timed(Action.CROSS, 6.0, 2.2)), ROAD)
    first = [stretch for stretch in stretches if stretch.gene == 0]
    assert first[-1].end[:2] == pytest.approx((20.0, 7.8))
    assert stretches[-1].end[:2] == pytest.approx((20.0, -4.3))


def test_pedestrian_on_the_carriageway_walks_to_the_other_side() -> None:
    crossing = person(timed(Action.CROSS, 1.0, 1.5), timed(Action.KEEP, 0.5))
    stretches = roll_out(crossing, ROAD, 20.0)
    assert {round(stretch.s_m, 6) for stretch in stretches} == {20.0}
    assert stretches[-1].end[1] == pytest.approx(7.8)
    frozen = roll_out(person(timed(Action.CROSS, 1.5, 2.0), timed(Action.BRAKE, 1.0, 8.0)), ROAD, 20.0)
    assert frozen[-1].end[1] == pytest.approx(0.25)  # 3 m, and .25 m until they stop


def test_vehicle_from_a_side_street_drives_straight_across() -> None:
    comes = Participant(
        kind=Kind.VAN,
        ds_m=31.75,
        dd_m=-20.0,
        dyaw_rad=0.5 * math.pi,
        speed_mps=10.0,
        genes=(timed(Action.KEEP, 1.0), timed(Action.CHANGE_LEFT, 1.0, 1.0)),
    )
    assert waypoints(comes, CROSSROAD) == pytest.approx(np.array([[31.75, -10.0], [31.75, 0.0]]))


@given(st.integers(0, 2**32 - 1), st.booleans())
def test_motion_is_continuous_and_inside_its_limits(seed: int, at_crossroad: bool) -> None:
    road = CROSSROAD if at_crossroad else ROAD
    component = participants_component("participants", 3, road)
    rule = participants_of(SearchSpace((component,)))[1]
    for one in rule.decode(component.sample(np.random.default_rng(seed))):
        stretches = roll_out(one, road, 40.0)
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
                assert -1e-9 <= speed <= MAX_SPEEDS_MPS[one.kind] + 1e-9
                if math.cos(one.dyaw_rad) ** 2 > 0.5:
                    assert road.right_kerb_m - outer_m <= d_m <= road.left_kerb_m + outer_m
                    assert one.on_foot or road.on_carriageway(d_m)


def test_rollouts_are_nan_without_a_participant() -> None:
    solutions = [(vehicle(timed(Action.KEEP, 1.0), timed(Action.KEEP, 1.0)),), ()]
    rollouts = Rollouts.of(solutions, 2, ROAD, Distance.PAPER)
    assert rollouts.counts.tolist() == [[2.0, 0.0], [0.0, 0.0]]
    assert rollouts.points[0, 0, :2].tolist() == [[28.0, 0.0], [36.0, 0.0]]
    assert np.isnan(rollouts.points[0, 0, 2:]).all()
    assert np.isnan(rollouts.points[1]).all()
    at_times = Rollouts.of(solutions, 2, ROAD)
    assert at_times.counts.tolist() == [[HORIZON_S / STEP_S + 1, 0.0], [0.0, 0.0]]
    assert at_times.points[0, 0, :, 0].tolist() == (20.0 + 8.0 * np.arange(0, HORIZON_S + 0.5)).tolist()
    assert np.isnan(at_times.points[0, 1]).all()


def test_positions_are_those_of_each_second() -> None:
    # 8 m/s for 2 s, then 4 m/s2 for 2 s, and it stands.
    brakes = positions(vehicle(timed(Action.KEEP, 2.0), timed(Action.BRAKE, 5.0, 4.0)), ROAD)
    assert brakes[:7, 0].tolist() == [20.0, 28.0, 36.0, 42.0, 44.0, 44.0, 44.0]
    assert brakes[-1].tolist() == [44.0, 0.0]
    # It keeps going after its last action; a smooth step is halfway after half the time.
    changes = positions(vehicle(timed(Action.CHANGE_LEFT, 2.0, 1.0), ds_m=40.0, dd_m=3.5), ROAD)
    assert changes[:4] == pytest.approx(np.array([[40.0, 3.5], [32.0, 1.75], [24.0, 0.0], [16.0, 0.0]]))
    walks = positions(person(timed(Action.CROSS, 1.0, 1.5), timed(Action.KEEP, 0.5)), ROAD)
    assert walks[:3, 1] == pytest.approx([-3.0, -1.5, 0.0])
    assert walks[-1, 1] == pytest.approx(7.8)


@given(st.integers(0, 2**32 - 1), st.booleans())
def test_positions_agree_with_the_stretches_that_begin_at_whole_seconds(
    seed: int, at_crossroad: bool
) -> None:
    road = CROSSROAD if at_crossroad else ROAD
    component = participants_component("participants", 3, road)
    rule = participants_of(SearchSpace((component,)))[1]
    for one in rule.decode(component.sample(np.random.default_rng(seed))):
        whole = replace(
            one, genes=tuple(replace(gene, duration_s=max(1.0, round(gene.duration_s))) for gene in one.genes)
        )
        found = positions(whole, road)
        for stretch in roll_out(whole, road, HORIZON_S):
            second = round(stretch.from_s)
            if second <= HORIZON_S and abs(stretch.from_s - second) < 1e-9:
                assert found[second] == pytest.approx([stretch.s_m, stretch.d_m], abs=1e-6)


def test_distance_at_equal_times_depends_on_what_is_driven_not_on_how_it_is_written() -> None:
    brief = (vehicle(timed(Action.KEEP, 0.5), timed(Action.KEEP, 0.5)),)
    long = (vehicle(*[timed(Action.KEEP, 1.0)] * 8),)
    brakes = (vehicle(timed(Action.KEEP, 1.0), timed(Action.BRAKE, 3.0, 8.0)),)
    timely = Rollouts.of([brief, long, brakes], 1, ROAD)
    distances = encounter_distances(timely, timely)
    assert distances[0, 1] == pytest.approx(0.0)
    assert distances[0, 2] == pytest.approx(distances[1, 2])
    assert matched_distances(timely, timely) == pytest.approx(distances)
    literal = Rollouts.of([brief, long, brakes], 1, ROAD, Distance.PAPER)
    assert encounter_distances(literal, literal)[0, 1] > 0.0


MAX_COUNT = 3


def rollouts_of(*solutions: list[list[tuple[float, float]]], measure: Distance = Distance.PAPER) -> Rollouts:
    """Return roll-outs with the given points."""
    return Rollouts.of_points(solutions, MAX_COUNT, measure)


AHEAD = [(0.0, 0.0), (10.0, 0.0), (20.0, 0.0)]
BESIDE = [(3.0, 4.0), (13.0, 4.0)]


def test_td_of_the_paper_sums_over_the_shared_actions() -> None:
    sums, paired = trajectory_distances(rollouts_of([AHEAD]), rollouts_of([BESIDE]))
    assert sums[0, 0, 0, 0] == 10.0
    assert paired.sum() == 1


def test_td_at_equal_times_is_a_mean() -> None:
    timely = [rollouts_of([points], measure=Distance.TIME) for points in (AHEAD, [*BESIDE, (23.0, 4.0)])]
    means, paired = trajectory_distances(*timely)
    assert means[0, 0, 0, 0] == 5.0
    assert paired.sum() == 1
    assert encounter_distances(*timely).tolist() == [[5.0]]


def test_ed_is_the_mean_over_all_pairs_even_to_itself() -> None:
    both = rollouts_of([AHEAD, BESIDE])
    # Pairs: 0 and 10, 10 and 0.
    assert encounter_distances(both, both).tolist() == [[5.0]]
    assert encounter_distances(both, rollouts_of([AHEAD])).tolist() == [[5.0]]
    assert encounter_distances(rollouts_of([AHEAD]), rollouts_of([AHEAD])).tolist() == [[0.0]]


def test_participant_distance_is_the_mean_to_all_participants() -> None:
    found = participant_distances(rollouts_of([AHEAD, BESIDE]), rollouts_of([AHEAD], [BESIDE, BESIDE]))
    assert found[0, :2] == pytest.approx([20.0 / 3.0, 10.0 / 3.0])
    assert np.isnan(found[0, 2])


def test_matching_ignores_the_order_and_charges_unmatched_participants() -> None:
    assert matched_distance(rollouts_of([AHEAD, BESIDE]), rollouts_of([BESIDE, AHEAD])) == 0.0
    assert matched_distance(rollouts_of([AHEAD]), rollouts_of([BESIDE])) == 5.0
    assert matched_distance(rollouts_of([AHEAD, BESIDE]), rollouts_of([BESIDE])) == pytest.approx(
        UNMATCHED_M / 2
    )


def random_solution(rng: np.random.Generator) -> list[list[tuple[float, float]]]:
    return [
        [tuple(point) for point in rng.uniform(-50, 50, (rng.integers(2, 5), 2)).tolist()]
        for _ in range(rng.integers(1, MAX_COUNT + 1))
    ]


@given(st.integers(0, 2**32 - 1))
def test_distances_are_symmetric_and_the_matching_is_optimal(seed: int) -> None:
    rng = np.random.default_rng(seed)
    solutions = rollouts_of(*(random_solution(rng) for _ in range(3)))
    apart = encounter_distances(solutions, solutions)
    assert apart == pytest.approx(apart.T)
    matched = matched_distances(solutions, solutions)
    assert matched == pytest.approx(matched.T)
    assert np.diag(matched).tolist() == [0.0] * 3
    assert matched[0, 1] == pytest.approx(_by_hand(solutions.take([0]), solutions.take([1])))


def _by_hand(first: Rollouts, second: Rollouts) -> float:
    def present(one: Rollouts) -> list[NDArray[np.float64]]:
        return [one.points[0, p, : int(count)] for p, count in enumerate(one.counts[0]) if count]

    few, many = sorted((present(first), present(second)), key=len)
    totals = []
    for chosen in permutations(many, len(few)):
        costs = []
        for a, b in zip(few, chosen, strict=True):
            shared = min(len(a), len(b))
            costs.append(float(np.linalg.norm(a[:shared] - b[:shared], axis=1).mean()))
        totals.append(sum(costs) + UNMATCHED_M * (len(many) - len(few)))
    return min(totals) / len(many)


def test_cut_in_ends_in_the_egos_lane_at_a_lower_speed() -> None:
    stretches = roll_out(vehicle(timed(Action.CUT_IN, 2.0, 1.0), ds_m=10.0, dd_m=0.6), ROAD)
    s_m, d_m, speed = stretches[-1].end
    assert (s_m, d_m, speed) == pytest.approx((24.0, 0.0, 6.0))


def test_vehicle_keeps_its_top_speed_and_the_carriageway() -> None:
    stretches = roll_out(
        vehicle(timed(Action.ACCELERATE, 6.0, 3.0), timed(Action.CHANGE_RIGHT, 2.0, 1.0), speed_mps=14.0),
        ROAD,
    )
    assert stretches[-1].end[2] == MAX_SPEEDS_MPS[Kind.CAR]
    assert stretches[-1].end[1] == pytest.approx(-0.85)  # half of 3.5 m less half of 1.8 m
