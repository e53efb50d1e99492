from benchmarks.search import measure_searches, measure_steps


def test_measurement_has_a_row_for_each_size_with_its_target() -> None:
    rows = list(measure_steps((50, 1_300), repeats=3))
    assert [row.target for row in rows] == ["", "at most 5"]
    assert [row.met for row in rows] == [None, rows[1].value <= 5]
    assert all(row.value > 0 for row in rows)


def test_whole_searches_are_measured_without_their_simulations() -> None:
    rows = list(measure_searches(("random@1", "nearest-opposite@1"), budget=80, drives=2))
    assert [row.what for row in rows] == [
        "% of the CPU time of 80 simulations: random@1",
        "% of the CPU time of 80 simulations: nearest-opposite@1",
    ]
    assert all(row.value > 0 for row in rows)
    assert " s in 2 generations; " in rows[0].note
    assert rows[0].note.endswith(" ms a drive")
