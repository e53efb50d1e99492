"""Counts from the simulations of a search for tolerances: drives and caused violations by cell and severity."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from brink.search.algorithms.tolerance.layout import DriveKey, Layout
from brink.search.curves import LEVELS, Counts, Curve, Screening, curves_of
from brink.search.space import BoolArray, FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tally:
    """Counts from the simulations of a search.

    Attributes:
        counts: Drives with an error and violations caused by it, by cell and level; of screened cells, those of
            vulnerable drives.
        screenings: The screening of each group.
        vulnerable: The vulnerable drives of each group, by `Layout.drive_keys`, in the order of their simulation.
        immune: The drives of each group that held with the grossest error, in the same form.
        baseline: Of the first drives of each population, those that violate without an error, and all.
        open_numbers: Numbers of the violations of which it is not known yet whether the error caused them.
        caused: Cell, level and number of the violations that the error is known to have caused, by severity.
    """

    counts: Counts
    screenings: tuple[Screening, ...]
    vulnerable: tuple[tuple[DriveKey, ...], ...]
    immune: tuple[tuple[DriveKey, ...], ...]
    baseline: tuple[tuple[int, int], ...]
    open_numbers: tuple[int, ...]
    caused: tuple[tuple[int, int, int], ...]

    def curves(self, layout: Layout, *, limit: float, confidence: float) -> list[Curve]:
        """Return the curve of each cell.

        Args:
            layout: The cells.
            limit: Share of caused violations whose severity is wanted.
            confidence: Probability that an interval covers the truth.
        """
        screenings = [None if cell.group is None else self.screenings[cell.group] for cell in layout.cells]
        grossest = [layout.is_grossest(cell) for cell in layout.cells]
        return curves_of(self.counts, screenings, grossest, limit=limit, confidence=confidence)


def tally(
    layout: Layout, rows: FloatArray, numbers: Sequence[int], unsafe: BoolArray, seeds: Sequence[int]
) -> Tally:
    """Count the drives of a search.

    Violations of which it is not known yet whether the error caused them count as caused, but a drive is only
    simulated as a vulnerable one once that is known.

    Args:
        layout: The cells.
        rows: Simulated solutions, shape ``(n, d)``, in the order of their numbers.
        numbers: Their numbers.
        unsafe: Their verdicts, shape ``(n,)``.
        seeds: For each, its episode seed or anything else that is the same exactly for the same seed.
    """
    cells, levels, groups = layout.cells_of(rows), layout.levels_of(rows), layout.groups_of(rows)
    keys = layout.drive_keys(rows, seeds)
    baseline = [(0, 0) for _ in layout.populations]
    without: dict[DriveKey, bool] = {}
    for place in np.flatnonzero(layout.without_error(rows)).tolist():
        without[keys[place]] = bool(unsafe[place])
        population = layout.population_of(numbers[place])
        if population is not None:
            violating, drives = baseline[population]
            baseline[population] = violating + int(unsafe[place]), drives + 1
    open_numbers: list[int] = []
    vulnerable: list[dict[DriveKey, int]] = [{} for _ in layout.groups]
    immune: list[dict[DriveKey, None]] = [{} for _ in layout.groups]
    screened, unexplained = [0 for _ in layout.groups], [0 for _ in layout.groups]
    caused: list[tuple[int, int, int]] = []
    for place in np.flatnonzero(groups >= 0).tolist():
        group, key = int(groups[place]), keys[place]
        truth = without.get(key)
        screened[group] += 1
        if not unsafe[place]:
            immune[group][key] = None
        elif truth is None:
            open_numbers.append(numbers[place])
            unexplained[group] += 1
        elif not truth:
            vulnerable[group][key] = numbers[place]
    counts = Counts.empty(len(layout.cells))
    audited = Counts.empty(len(layout.groups))
    for place in np.flatnonzero((cells >= 0) & (groups < 0)).tolist():
        cell, level, key, verdict = int(cells[place]), int(levels[place]), keys[place], bool(unsafe[place])
        own = layout.cells[cell].group
        truth = without.get(key)
        if verdict and truth is None:
            open_numbers.append(numbers[place])
        if own is None or key in vulnerable[own]:
            counts.drives[cell, level - 1] += 1
            counts.caused[cell, level - 1] += int(verdict and not truth)
            if verdict and truth is False:
                caused.append((cell, level, numbers[place]))
        elif key in immune[own]:
            audited.drives[own, level - 1] += 1
            audited.caused[own, level - 1] += int(verdict and not truth)
    for place, one in enumerate(layout.cells):
        if one.group is not None and layout.is_grossest(one):
            caused += [(place, LEVELS, number) for number in vulnerable[one.group].values()]
    return Tally(
        counts=counts,
        screenings=tuple(
            Screening(
                vulnerable=len(vulnerable[group]) + unexplained[group],
                screened=screened[group],
                audits=audited.drives[group] if layout.audits else None,
                leaks=audited.caused[group] if layout.audits else None,
            )
            for group in range(len(layout.groups))
        ),
        vulnerable=tuple(tuple(found) for found in vulnerable),
        immune=tuple(tuple(found) for found in immune),
        baseline=tuple(baseline),
        open_numbers=tuple(sorted(open_numbers)),
        caused=tuple(sorted(caused, key=lambda one: (one[1], one[2]))),
    )
