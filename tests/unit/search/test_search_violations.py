"""Types of violations, and their distinct instances."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray
from support.circumstances import violation

from brink.search.analysis.avoidable import Avoidable, AvoidedBy, avoidable_of
from brink.search.analysis.violations import (
    SECTORS,
    FoundViolation,
    by_type,
    dbscan,
    instances,
    is_at_fault,
    kinds_of,
    niche_of,
    sector_of,
    signature_of,
)


def test_signature_has_six_words() -> None:
    found = signature_of(violation())
    assert found.to_json() == {
        "requirement": "no-collision@1",
        "counterpart": "vehicle",
        "sector": "front",
        "ego": "driving",
        "other": "same way, cut in",
        "place": "straight",
    }
    assert str(found) == "collision with a vehicle at the front (same way, cut in), ego driving, straight"
    assert niche_of(violation()) == ("front", "same way, cut in", "driving", "straight")


def test_a_type_is_as_avoidable_as_its_most_avoidable_violation() -> None:
    def found(number: int, **circumstances: Any) -> FoundViolation:
        told = {**violation(), **circumstances}
        return FoundViolation(number=number, circumstances=told, signature=signature_of(told), name=None)

    assert [avoidable_of(one) for one in ({"avoidable": "ideal"}, {"avoidable": "perhaps"}, {})] == [
        Avoidable.IDEAL,
        None,
        None,
    ]
    (kind,) = by_type([found(1, avoidable="no"), found(2, avoidable="careful"), found(3)])
    assert kind.avoidable is Avoidable.CAREFUL
    (old,) = by_type([found(1), found(2)])
    assert (old.avoidable, old.avoided_by) == (None, None)
    told = {"avoidable": "careful", "avoided_by": "driving on"}
    (kind,) = by_type([found(1, **told), found(2, avoidable="ideal", avoided_by="braking")])
    assert kind.avoided_by is AvoidedBy.DRIVING_ON
    (kind,) = by_type([found(1, **told), found(2, avoidable="careful", avoided_by="braking")])
    assert kind.avoided_by is AvoidedBy.BRAKING


@pytest.mark.parametrize(
    ("changes", "at_fault"),
    [
        ({}, True),
        ({"other": {"in_way_s": 0.4}}, False),
        ({"other": {"in_way_s": 0.4}, "ego": {"plan": "overtake"}}, True),
        ({"ego": {"speed_mps": 0.1}}, False),
        ({"other": {"bearing_rad": 3.0}}, False),
        ({"other": {"bearing_rad": -2.4}, "ego": {"plan": "nudge"}}, False),
        ({"requirement": "front-gap@1", "collision": None, "other": {"in_way_s": 1.2}}, False),
        ({"requirement": "front-gap@2", "collision": None, "other": {"in_way_s": 2.0}}, True),
        ({"requirement": "red-light@1", "collision": None, "other": {"in_way_s": 0.0}}, True),
        ({"requirement": "lane-keeping@1", "collision": None, "other": {"in_way_s": 0.0}}, True),
        ({"requirement": "progress@1", "collision": None}, False),
        ({"requirement": "progress@1", "collision": None, "nobody": True}, True),
        ({"nobody": True, "collision": "object"}, True),
    ],
)
def test_fault_is_assigned_by_the_rules(changes: dict[str, Any], at_fault: bool) -> None:
    assert is_at_fault(violation(**changes)) is at_fault


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"speed_mps": 0.0, "plan": "overtake"}, "standing"),
        ({"plan": "nudge"}, "nudging around"),
        ({"accel_mps2": -3.0, "yaw_rate_radps": 0.4}, "braking"),
        ({"yaw_rate_radps": 0.4}, "turning left"),
        ({"yaw_rate_radps": -0.4, "accel_mps2": 2.0}, "turning right"),
        ({"accel_mps2": 2.0}, "accelerating"),
    ],
)
def test_manoeuvre_of_the_ego(changes: dict[str, Any], words: str) -> None:
    assert signature_of(violation(ego=changes)).ego == words


def test_manoeuvre_of_the_counterpart() -> None:
    assert signature_of(violation(other={"heading_rad": math.pi})).other == "oncoming, cut in"
    assert signature_of(violation(other={"heading_rad": 1.5})).other == "across, cut in"
    assert signature_of(violation(other={"speed_mps": 0.0})).other == "standing"
    crossing = signature_of(violation(other={"kind": "pedestrian", "action": "cross", "heading_rad": 1.5}))
    assert (crossing.counterpart, crossing.other) == ("pedestrian", "cross")
    alone = signature_of(violation("speed-limit@1", collision=None))
    assert (alone.counterpart, alone.sector, alone.other) == ("nothing", "nothing", "nothing")
    assert str(alone) == "too fast, ego driving, straight"
    assert signature_of(violation(nobody=True, collision="object")).counterpart == "object"


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({}, "collision with a vehicle at the front (same way, cut in)"),
        ({"nobody": True, "collision": "object"}, "collision with an object"),
        (
            {"requirement": "front-gap@2", "collision": None},
            "too close to a vehicle at the front (same way, cut in)",
        ),
        (
            {"requirement": "lane-keeping@1", "collision": None},
            "lane left beside a vehicle at the front (same way, cut in)",
        ),
        ({"requirement": "lane-keeping@1", "collision": None, "nobody": True}, "lane left"),
        (
            {"requirement": "progress@1", "collision": None},
            "blocked by a vehicle at the front (same way, cut in)",
        ),
        ({"requirement": "progress@1", "collision": None, "nobody": True}, "stuck"),
        ({"requirement": "red-light@1", "collision": None}, "red light run"),
        ({"requirement": "own@1", "collision": None, "nobody": True}, "own violated"),
    ],
)
def test_a_type_names_what_happened_not_what_was_required(changes: dict[str, Any], words: str) -> None:
    assert str(signature_of(violation(**changes))) == f"{words}, ego driving, straight"


def test_sectors_surround_the_ego() -> None:
    assert [sector_of(math.radians(degrees)) for degrees in range(0, 360, 45)] == list(SECTORS)
    assert sector_of(-math.pi) == sector_of(math.pi) == "rear"
    assert sector_of(math.radians(-22.0)) == "front"
    assert sector_of(math.radians(-23.0)) == "front right"


def by_definition(points: NDArray[np.float64], reach: float, neighbours: int) -> list[set[int]]:
    """Return the core points of each cluster, grown one point at a time."""
    apart = np.linalg.norm(points[:, None] - points[None], axis=2) <= reach
    cores = {int(p) for p in np.flatnonzero(apart.sum(axis=1) >= neighbours)}
    clusters = []
    while cores:
        cluster, fresh = set(), {min(cores)}
        while fresh:
            cluster |= fresh
            fresh = {q for p in fresh for q in cores if apart[p, q]} - cluster
        clusters.append(cluster)
        cores -= cluster
    return clusters


@given(arrays(np.float64, st.tuples(st.integers(0, 25), st.just(2)), elements=st.integers(0, 9).map(float)))
def test_clusters_follow_the_definition(points: NDArray[np.float64]) -> None:
    labels = dbscan(points, 1.5, 3)
    clusters = by_definition(points, 1.5, 3)
    assert int(labels.max(initial=-1)) + 1 == len(clusters)
    for number, cluster in enumerate(clusters):
        assert {int(labels[core]) for core in cluster} == {number}
    inner = {core for cluster in clusters for core in cluster}
    for point in set(range(len(points))) - inner:
        near = {int(labels[core]) for core in inner if np.linalg.norm(points[point] - points[core]) <= 1.5}
        assert int(labels[point]) in (near or {-1})


def test_instances_are_clusters_and_single_violations() -> None:
    slow = [violation(ego={"speed_mps": 2.0 + 0.1 * i}) for i in range(4)]
    fast = [violation(ego={"speed_mps": 8.0 + 0.1 * i}) for i in range(4)]
    alone = [violation(other={"bearing_rad": 2.0})]
    assert instances(slow) == 1
    assert instances([*slow, *fast]) == 2
    assert instances([*slow, *fast, *alone]) == 3
    assert instances([violation(nobody=True, collision="object")]) == 1


def test_invalid_violations_are_ignored() -> None:
    broken = {key: value for key, value in violation().items() if key != "place"}
    assert kinds_of([broken, violation(), {**violation(), "ego": None}]) == {str(signature_of(violation()))}
    assert niche_of(broken) is None
