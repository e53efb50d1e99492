"""The check of the reference drivers: what is counted, and that it runs."""

from benchmarks.drivers import EMPTY_ROADS, Outcome, drive, rows_of, specs
from brink.sim.encounter.reference import Driver


def outcome(*hit: Driver, safe: bool = True, weather: str = "clear") -> Outcome:
    return Outcome(weather=weather, safe=safe, hit=frozenset(hit))


def test_collisions_are_counted_where_the_system_is_safe() -> None:
    rows = rows_of(
        [outcome()] * EMPTY_ROADS + [outcome(Driver.CAREFUL), outcome(), outcome(safe=False), outcome()],
        ["clear"],
    )
    values = {row.what: (row.value, row.met) for row in rows}
    assert values == {
        "collisions on empty roads, careful, clear": (0, True),
        "collisions on empty roads, ideal, clear": (0, True),
        "share of drives with a collision, careful, clear": (1 / 3, False),
        "share of drives with a collision, ideal, clear": (0.0, True),
    }


def test_every_weather_has_the_same_candidates_and_empty_roads() -> None:
    drawn = specs(6, ["clear", "hard_rain"], seed=1)
    clear, rain = drawn[: len(drawn) // 2], drawn[len(drawn) // 2 :]
    assert [one.scenario["weather"] for one in rain] == ["hard_rain"] * (EMPTY_ROADS + 6)
    users = [[one.scenario["road_users"] for one in part] for part in (clear, rain)]
    assert users[0] == users[1]
    assert users[0][:EMPTY_ROADS] == [[]] * EMPTY_ROADS
    assert all(users[0][EMPTY_ROADS:])
    assert drive(clear[0]) == outcome(weather="clear")
