"""`edge@2`: thresholds, where exactly a drive turns from safe to unsafe along one unit, everything else held.

The search explores at random and as a surrogate of robustness proposes, then *hunts* near such solutions. Under the
seed of an *anchor*, it first drives the scenario without any error: if the verdict stays, nothing is to be learnt
of the errors there. Errors are then dropped one by one while the verdict stays. Of what is left, units are moved,
each alone, so that the verdict most probably changes. Each that changes it gives a *line* from a safe to an unsafe
end. Fresh seeds tell whether chance decides at either end; then the verdict is bisected under the common seed, and
the line simulated with fresh seeds at places that the estimate of the curve chooses (`brink.search.thresholds`).
Without chance, bisection to the resolution is all.

All stages of many hunts interleave. Kinds of errors that were not seen yet come first. What a finding needs stands in
the archive alone: the simulations of a line differ in its unit and in nothing else, those with a common episode seed
are the bracket, and those with a seed of their own are trials.

Source: ours; see docs/explanation/thresholds.md.
"""

from brink.search.algorithms.thresholds.search import ThresholdSearch
from brink.search.algorithms.thresholds.state import (
    Hunt,
    Job,
    Purpose,
    Stage,
    ThresholdConfig,
    ThresholdState,
)

__all__ = ["Hunt", "Job", "Purpose", "Stage", "ThresholdConfig", "ThresholdSearch", "ThresholdState"]
