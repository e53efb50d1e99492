"""The comparison of searches on traffic: violations that reference drivers avoid, and searches for them."""

from typing import Any

from support.circumstances import violation

from benchmarks.mumoea import MAP_ELITES, Found, Measures, SearchRun


def found(number: int, *violations: dict[str, Any]) -> Found:
    points = [[[0.0, 0.0]] * 2]
    return Found(
        number=number, violations=list(violations), waypoints=points, positions=points, cpu_s=float(number)
    )


def search(*solutions: Found) -> SearchRun:
    return SearchRun(
        method=MAP_ELITES, seed=1, simulations=100, failed=0, origins={}, found=list(solutions), cpu_s=20.0
    )


def judged(avoidable: str, *, ego: dict[str, Any] | None = None, **other: Any) -> dict[str, Any]:
    return violation(ego=ego, other=other) | {"avoidable": avoidable}


def test_a_type_counts_as_avoidable_if_one_of_its_violations_is() -> None:
    measures = Measures.of(
        search(
            found(1, judged("no")),
            found(2, judged("careful")),
            found(3, judged("ideal", bearing_rad=1.6)),
            found(4, judged("no", bearing_rad=3.1)),
        )
    )
    assert (measures.types, measures.careful_types, measures.ideal_types) == (3, 1, 2)


def test_types_that_a_careful_driver_avoids_by_braking_are_counted_apart() -> None:
    braking, driving_on = ({"avoided_by": how} for how in ("braking", "driving on"))
    measures = Measures.of(
        search(
            found(1, judged("careful") | driving_on, judged("careful") | braking),
            found(2, judged("careful", bearing_rad=1.6) | driving_on),
            found(3, judged("ideal", bearing_rad=3.1) | braking),
        )
    )
    assert (measures.careful_types, measures.braking_types) == (2, 1)
