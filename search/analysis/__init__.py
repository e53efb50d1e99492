"""Analysis of archives: boundaries, statistics, comparisons, monitors and maps. Pure functions of plain values."""
