"""What a search is judged by: types, how soon, how dense, how different.

Source: Tian et al., Tables 3 and 4.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from brink.bench.mumoea.runs import Found, SearchRun
from brink.search.traffic.motion import Rollouts, encounter_distances
from brink.search.traffic.participants import MAX_ACTIONS, MAX_PARTICIPANTS


@dataclass(frozen=True, slots=True, kw_only=True)
class Measures:
    """Figures of one search.

    Attributes:
        types: Distinct types of violations.
        fault_types: Those of them in which the ego was at fault.
        per_violation: Simulations for each solution that violated something; all of them if none did.
        first: Simulations up to and with the first violation; all of them if there was none.
        last_type: Simulations up to and with the first solution of the last new type.
        between_types_m: Mean ED between the first solutions of different types; NaN with fewer than two.
    """

    types: int
    fault_types: int
    per_violation: float
    first: int
    last_type: int
    between_types_m: float


def measured(run: SearchRun) -> Measures:
    """Return the figures of a search."""
    firsts = first_of_each_type(run.found)
    return Measures(
        types=len(firsts),
        fault_types=sum(", at fault" in name for name in firsts),
        per_violation=run.simulations / max(1, len(run.found)),
        first=run.found[0].number + 1 if run.found else run.simulations,
        last_type=max((found.number + 1 for found in firsts.values()), default=run.simulations),
        between_types_m=_between(list(firsts.values())),
    )


def first_of_each_type(found: Sequence[Found]) -> dict[str, Found]:
    """Return the first solution of each type, by the type's words, in the order of finding."""
    firsts: dict[str, Found] = {}
    for solution in found:
        for name in sorted(solution.types):
            firsts.setdefault(name, solution)
    return firsts


def types_over(run: SearchRun, simulations: Sequence[int]) -> list[int]:
    """Return how many types were known after so many simulations each."""
    numbers = sorted(found.number for found in first_of_each_type(run.found).values())
    return [sum(number < count for number in numbers) for count in simulations]


def _between(solutions: Sequence[Found]) -> float:
    if len(solutions) < 2:
        return float("nan")
    rolled = rolled_out(solutions)
    apart = encounter_distances(rolled, rolled)
    return float(apart[np.triu_indices(len(solutions), 1)].mean())


def rolled_out(solutions: Sequence[Found]) -> Rollouts:
    """Return the waypoints of solutions as arrays."""
    points = np.full((len(solutions), MAX_PARTICIPANTS, MAX_ACTIONS, 2), np.nan)
    actions = np.zeros((len(solutions), MAX_PARTICIPANTS))
    for row, solution in enumerate(solutions):
        for column, ends in enumerate(solution.waypoints):
            points[row, column, : len(ends)] = ends
            actions[row, column] = len(ends)
    return Rollouts(points=points, actions=actions)
