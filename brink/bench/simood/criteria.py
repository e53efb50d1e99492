"""The criteria A0 to A8, by name."""

import contextlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Final

from brink.bench.figures import Row
from brink.bench.simood.costs import Costs
from brink.bench.simood.hazards import Hazards
from brink.bench.simood.searches import Searches
from brink.bench.telling import Told
from brink.bench.trials import Records, code_fingerprint

CRITERIA: Final = ("A0", "A1", "A2", "A3", "A4", "A5", "A6", "A7", "A8")
DECIDING: Final = (
    "sim/aeb", "sim/bullet", "sim/perception", "sim/perturbations", "sim/rendering", "sim/requirements.py",
    "sim/world",
)  # fmt: skip
"""Parts of the simulator that decide what comes out: outcomes of other code are not taken for this one's."""


def measure_simood(wanted: Sequence[str], folder: Path, *, processes: int, told: Told) -> list[Row]:
    """Measure criteria and return their figures; what was run is kept in the folder.

    Args:
        wanted: Some of `CRITERIA`. A3 and A4 are one measurement.
        folder: Where tables, figures and outcomes go.
        processes: In how many processes episodes are run.
        told: Told how far it is.
    """
    file = folder / f"records-{code_fingerprint(DECIDING)}.jsonl"
    with contextlib.closing(Records(file, processes=processes)) as records:
        hazards, searches, costs = (
            Hazards(records, folder, told),
            Searches(records, folder, told),
            Costs(records, told),
        )
        measures: Mapping[str, Callable[[], list[Row]]] = {
            "A0": hazards.baseline,
            "A1": hazards.catalogue,
            "A2": hazards.sweep,
            "A3": hazards.pairs,
            "A4": hazards.pairs,
            "A5": searches.against_random,
            "A6": searches.tables,
            "A7": costs.time_claim,
            "A8": costs.perturbing,
        }
        chosen = dict.fromkeys(measures[name] for name in CRITERIA if name in wanted)
        return [row for measure in chosen for row in measure()]
