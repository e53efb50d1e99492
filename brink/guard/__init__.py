"""Fitting and judging guards, the runtime monitors of `brink.sim.guard`."""

from brink.guard.drives import Drive, random_specs, record, solution_specs
from brink.guard.evaluation import GuardEvaluation, evaluate
from brink.guard.fitting import fit

__all__ = ["Drive", "GuardEvaluation", "evaluate", "fit", "random_specs", "record", "solution_specs"]
