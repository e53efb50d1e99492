"""The generation that `tolerance@1` is planning."""

from collections.abc import Sequence

import numpy as np

from brink.search.algorithms.tolerance.layout import Layout
from brink.search.algorithms.tolerance.state import Purpose, ToleranceState
from brink.search.curves import LEVELS
from brink.search.space import FloatArray, IntArray


class Plan:
    """A generation that is being planned."""

    def __init__(self, state: ToleranceState, layout: Layout, room: int) -> None:
        self._layout = layout
        self._seed = state.ledger.seed
        self._known_jobs = state.jobs
        self._new_jobs: list[tuple[int, int, int]] = []
        self.room = room
        self.roots = list(state.roots)
        self.rows: list[FloatArray] = []
        self.seeds: list[int | None] = []
        errors = state.jobs[state.jobs[:, 0] >= Purpose.ERROR]
        self.planned = np.bincount(errors[:, 1], minlength=len(layout.cells))
        screens = state.jobs[state.jobs[:, 0] == Purpose.SCREENING]
        self.screened = np.bincount(screens[:, 1], minlength=len(layout.groups))

    @property
    def jobs(self) -> IntArray:
        """The jobs of all candidates, with those that were planned."""
        return np.concatenate([self._known_jobs, np.array(self._new_jobs, np.int64).reshape(-1, 3)])

    def _add(
        self,
        purpose: Purpose,
        of: int,
        population: int,
        drive: int,
        choices: Sequence[str] | None,
        level: int,
    ) -> None:
        number = len(self._known_jobs) + len(self._new_jobs)
        known = drive < len(self.roots)
        if not known:
            self.roots.append(number)
        self.rows.append(self._layout.row(self._seed, population, drive, choices, level))
        self.seeds.append(self.roots[drive] if known else None)
        self._new_jobs.append((int(purpose), of, drive))
        self.room -= 1

    def add_truth(self, population: int, drive: int) -> None:
        """Plan a drive without an error."""
        self._add(Purpose.TRUTH, population, population, drive, None, 0)

    def add_screening(self, group: int) -> None:
        """Plan the next drive of a group with the most severe error."""
        scenario_group, drive = self._layout.groups[group], int(self.screened[group])
        self.screened[group] += 1
        self._add(Purpose.SCREENING, group, scenario_group.population, drive, scenario_group.choices, LEVELS)

    def add_error(self, cell: int, level: int, drive: int | None = None, *, audit: bool = False) -> None:
        """Plan a drive of a cell, by default the next one."""
        owner = self._layout.cells[cell]
        number = int(self.planned[cell]) if drive is None else drive
        self.planned[cell] += 1
        purpose = Purpose.AUDIT if audit else Purpose.ERROR
        self._add(purpose, cell, owner.population, number, owner.choices, level)
