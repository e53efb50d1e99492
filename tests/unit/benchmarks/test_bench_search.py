from benchmarks.search import measure_steps


def test_measurement_has_a_row_for_each_size_with_its_target() -> None:
    rows = list(measure_steps((50, 1_300), repeats=3))
    assert [row.target for row in rows] == ["", "at most 5"]
    assert [row.met for row in rows] == [None, rows[1].value <= 5]
    assert all(row.value > 0 for row in rows)
