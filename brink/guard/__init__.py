"""Fitting and judging guards, the runtime monitors of `brink.sim.guard`, and driving with them."""

from brink.guard.drives import Drive, random_specs, record, solution_specs
from brink.guard.evaluation import GuardEvaluation, evaluate
from brink.guard.fitting import fit
from brink.guard.loop import GuardedLoop, drive_with_guard

__all__ = [
    "Drive",
    "GuardEvaluation",
    "GuardedLoop",
    "drive_with_guard",
    "evaluate",
    "fit",
    "random_specs",
    "record",
    "solution_specs",
]
