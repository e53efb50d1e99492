"""Fitting and judging guards, the runtime monitors of `brink.sim.guard`."""

from brink.guard.drives import Drive, campaign_specs, random_specs, record
from brink.guard.evaluation import GuardEvaluation, evaluate
from brink.guard.fitting import fit

__all__ = ["Drive", "GuardEvaluation", "campaign_specs", "evaluate", "fit", "random_specs", "record"]
