"""The results so far of a search for tolerances, and the choice of the most informative drives."""

import math
from collections import Counter
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from brink.search.algorithms.tolerance.counting import Tally, tally
from brink.search.algorithms.tolerance.layout import Layout
from brink.search.algorithms.tolerance.plan import Plan
from brink.search.algorithms.tolerance.state import Purpose, ToleranceState
from brink.search.curves import (
    BEYOND,
    LEVELS,
    Counts,
    Screening,
    library,
    quantiles_of_sorted,
    scaled,
    severity_at,
    weights,
)
from brink.search.space import FloatArray

MOST_TRIES: Final = 3
"""Simulations of a drive without an error, if they fail."""

_CURVES: Final = 20_000
"""Curves of the library that the search uses."""

_NARROW: Final = 1e-3
"""Width of an interval below which a narrower one is no better."""

_QUANTILES: Final = np.array([0.05, 0.2, 0.35, 0.5, 0.65, 0.8, 0.95])
"""Where the shares of vulnerable and of leaking drives are looked up; the middle one is the median."""

_SHUFFLED: Final = np.array([4, 1, 6, 3, 0, 5, 2])
"""Order of the quantiles of the leaking share, nearly uncorrelated with that of the vulnerable share."""


class Results:
    """The results with which a search plans a generation."""

    def __init__(self, state: ToleranceState, layout: Layout) -> None:
        self._state = state
        self._layout = layout
        archive = state.ledger.archive
        drives = state.drives
        self._tally = tally(
            layout,
            archive.vectors,
            archive.numbers.tolist(),
            archive.unsafe,
            [drives[number] for number in archive.numbers.tolist()],
        )

    def plan_truth(self, plan: Plan) -> None:
        """Plan error-free drives, which show whether the error caused a violation."""
        state, layout, jobs = self._state, self._layout, self._state.jobs
        tried = Counter(map(tuple, jobs[jobs[:, 0] == Purpose.TRUTH][:, 1:].tolist()))
        flying = [c.number for generation in state.ledger.flight for c in generation]
        alive = jobs[[*state.ledger.archive.numbers.tolist(), *flying]]
        known = set(map(tuple, alive[alive[:, 0] == Purpose.TRUTH][:, 1:].tolist()))
        known |= {drive for drive, count in tried.items() if count >= MOST_TRIES}
        for number in self._tally.open_numbers:
            if not plan.room:
                return
            purpose, of, drive = jobs[number].tolist()
            owner = layout.groups[of] if purpose == Purpose.SCREENING else layout.cells[of]
            if (owner.population, drive) not in known:
                known.add((owner.population, drive))
                plan.add_truth(owner.population, drive)
        # What is left must suffice to tell the cause of the violations that are still to come.
        archive = state.ledger.archive
        share = (float(archive.unsafe.sum()) + 1.0) / (len(archive) + 10.0)
        spare = state.ledger.left - len(plan.rows) - math.ceil(share * (len(flying) + plan.room))
        if flying or plan.rows:
            plan.room = min(plan.room, max(int(spare), 0))

    def is_done(self) -> bool:
        """Return whether all intervals are as narrow as wanted."""
        config = self._state.config
        if not config.width or not (self._estimates.widths < config.width).all():
            return False
        curves = self._tally.curves(self._layout, limit=config.limit, confidence=config.confidence)
        return all(curve.tolerated.width < config.width for curve in curves)

    @cached_property
    def _estimates(self) -> "_Estimates":
        """How well the tolerated severity of each cell is known, and how informative a drive would be."""
        layout, config = self._layout, self._state.config
        tail = 0.5 * (1.0 - config.confidence)
        widths, gains = np.empty(len(layout.cells)), np.empty((len(layout.cells), LEVELS))
        kinds = {(cell.group, layout.is_grossest(cell)) for cell in layout.cells}
        for group, is_grossest in sorted(kinds, key=str):
            curves = scaled(library(_CURVES)) if is_grossest else library(_CURVES)
            places = [
                place
                for place, cell in enumerate(layout.cells)
                if (cell.group, layout.is_grossest(cell)) == (group, is_grossest)
            ]
            counts = self._tally.counts
            likely = weights(Counts(drives=counts.drives[places], caused=counts.caused[places]), curves)
            severity, middle = self._severities(group, curves)
            order = np.argsort(severity.ravel(), kind="stable")
            for place, chances in zip(places, likely, strict=True):
                pooled = np.tile(chances, len(severity))[order]
                low, high = quantiles_of_sorted(severity.ravel()[order], pooled, (tail, 1.0 - tail))
                widths[place] = high - low
            shares = curves[:, 1:].astype(np.float64)
            mean, unsafe = likely @ middle, np.clip(likely @ shares, 1e-9, 1.0 - 1e-9)
            common = (likely * middle) @ shares - mean[:, None] * unsafe
            gains[places] = np.maximum(common**2 / (unsafe * (1.0 - unsafe)), 1e-15)
        return _Estimates(widths, gains)

    def _severities(self, group: int | None, curves: NDArray[np.floating]) -> tuple[FloatArray, FloatArray]:
        """Return where curves of vulnerable drives reach the limit among all drives.

        Args:
            group: The group that they are screened in; None if they are those of all drives.
            curves: The curves, shape ``(n, LEVELS + 1)``.

        Returns:
            The severities for several shares of vulnerable and of leaking drives, shape ``(m, n)``; and those for the
            most likely shares, shape ``(n,)``.
        """
        limit = self._state.config.limit
        if group is None:
            reached = np.minimum(severity_at(curves, limit), BEYOND)
            return reached[None], reached
        screening = self._tally.screenings[group]
        vulnerable = screening.vulnerable_share(_QUANTILES)
        leak = screening.leak(_QUANTILES[_SHUFFLED])
        return (
            np.stack([self._reached(curves, *shares) for shares in zip(vulnerable, leak, strict=True)]),
            self._reached(curves, vulnerable[len(_QUANTILES) // 2], screening.likeliest_leak),
        )

    def _reached(self, curves: NDArray[np.floating], vulnerable: float, leak: float) -> FloatArray:
        shares = Screening.all_drives(curves, np.array([vulnerable]), np.array([leak]))
        return np.minimum(severity_at(shares, self._state.config.limit), BEYOND)

    def _vulnerable(self, group: int) -> float:
        """Return the estimated share of vulnerable drives of a group."""
        screening = self._tally.screenings[group]
        return (screening.vulnerable + 0.5) / (screening.screened + 1.0)

    def plan_adaptively(self, plan: Plan, rng: np.random.Generator) -> None:
        """Plan drives where they narrow the intervals of tolerated severities most for their cost."""
        config, layout = self._state.config, self._layout
        if not plan.room:
            return
        groups = [-1 if cell.group is None else cell.group for cell in layout.cells]
        unused = [_Unused(self._state, layout, self._tally, cell) for cell in range(len(groups))]
        cost = np.array([1.0 if group < 0 else 2.0 + 1.0 / self._vulnerable(group) for group in groups])
        drives = plan.planned.astype(np.float64)
        while plan.room:
            free = np.array(
                [group < 0 or bool(one.vulnerable) for group, one in zip(groups, unused, strict=True)]
            )
            # An interval narrows with the root of the number of drives.
            worth = np.maximum(self._estimates.widths, _NARROW) / (drives + 1.0)
            cell = int(np.argmax(worth / np.where(free, 1.0, cost)))
            level = int(rng.integers(1, LEVELS, endpoint=True))
            if rng.random() >= config.explore:
                chances = self._estimates.gains[cell] ** 2
                level = 1 + int(rng.choice(LEVELS, p=chances / chances.sum()))
            if groups[cell] < 0:
                plan.add_error(cell, level)
                drives[cell] += 1.0
                continue
            if layout.is_grossest(layout.cells[cell]):
                level = min(level, LEVELS - 1)  # the last level is that of the screening
            if unused[cell].immune and rng.random() < config.audit:
                plan.add_error(cell, level, unused[cell].immune.pop(), audit=True)
            elif free[cell]:
                plan.add_error(cell, level, unused[cell].vulnerable.pop())
                drives[cell] += 1.0
            else:
                plan.add_screening(groups[cell])
                drives[cell] += self._vulnerable(groups[cell])


class _Estimates(NamedTuple):
    """Estimates of the tolerated severities.

    Attributes:
        widths: Widths of the intervals, shape ``(cells,)``.
        gains: By how much a drive at each level is expected to reduce the variance, shape ``(cells, LEVELS)``.
    """

    widths: FloatArray
    gains: FloatArray


class _Unused:
    """The screened drives that a cell has not used yet.

    Attributes:
        vulnerable: Vulnerable ones, the latest first.
        immune: Those that hold with the grossest error, the latest first.
    """

    def __init__(self, state: ToleranceState, layout: Layout, known: Tally, cell: int) -> None:
        group, jobs = layout.cells[cell].group, state.jobs
        self.vulnerable: list[int] = []
        self.immune: list[int] = []
        if group is not None:
            mine = jobs[(jobs[:, 0] >= Purpose.ERROR) & (jobs[:, 1] == cell)]
            used = set(mine[:, 2].tolist())
            self.vulnerable = [drive for drive, _ in known.vulnerable[group] if drive not in used][::-1]
            self.immune = [drive for drive, _ in known.immune[group] if drive not in used][::-1]
