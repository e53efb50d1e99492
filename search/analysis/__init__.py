"""Analysis of archives: boundaries, tables, statistics, comparisons, monitors and maps, as pure functions."""
