from benchmarks.search import TARGETS_MS, measure_monitor, measure_steps


def test_measurement_has_a_row_for_each_size_with_its_target() -> None:
    rows = measure_steps((50, 1_300), repeats=3)
    assert [row.solutions for row in rows] == [50, 1_300]
    assert [row.target_ms for row in rows] == [None, TARGETS_MS[1_300]]
    assert all(0 < row.min_ms <= row.median_ms for row in rows)
    assert rows[0].met is None
    assert rows[1].met == (rows[1].median_ms <= TARGETS_MS[1_300])


def test_monitor_query_has_a_row_for_each_number_of_solutions() -> None:
    rows = measure_monitor((50, 100), repeats=3)
    assert [(row.solutions, row.new, row.met) for row in rows] == [(50, 0, None), (100, 0, None)]
    assert all(0 < row.min_ms <= row.median_ms for row in rows)
