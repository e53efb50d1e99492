"""`tolerance@1`: how severe an error may be before it makes a given share of drives violate the requirement.

The search space has a parameter for the *severity* of an error, and others, such as its type and target, whose
choices are the *cells*. In each cell and under each *condition* the search estimates a curve, the share of violations
that the error causes, and the severity at which it reaches a limit (`brink.search.curves`).

All cells share one list of drives: drive number i has the same scenario, onset and episode seed in all of them, apart
from what a cell or condition prescribes. The first drives are simulated without any error as well, and so is every
later drive that violates with one: only a violation that goes away with the error was caused by it.

Drives are screened with the grossest error, where there is one, and milder errors are simulated in vulnerable drives
alone (`brink.search.curves`). Within a cell every drive is simulated once, at one severity: another drive tells more
about the share than the same drive at another severity.

Simulations go to the cells whose intervals they are expected to narrow most for what they cost, screening included,
and there to the severities that tell most about where the limit is reached.

Source: ours; see docs/explanation/tolerance.md.
"""

from brink.search.algorithms.tolerance.counting import Tally, tally
from brink.search.algorithms.tolerance.layout import Layout
from brink.search.algorithms.tolerance.planning import FIRST_SCREENED
from brink.search.algorithms.tolerance.search import Tolerance
from brink.search.algorithms.tolerance.settings import ToleranceConfig
from brink.search.algorithms.tolerance.state import Purpose, ToleranceState

__all__ = [
    "FIRST_SCREENED",
    "Layout",
    "Purpose",
    "Tally",
    "Tolerance",
    "ToleranceConfig",
    "ToleranceState",
    "tally",
]
