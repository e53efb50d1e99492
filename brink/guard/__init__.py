"""Guards, the runtime monitors of driving systems: fallbacks, fitting, evaluation, and drives with them.

`brink.sim.guard` has the interface that a drive needs. Everything is imported when it is first used, since a guard
in a car needs nothing of what fits it.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from brink.guard.drives import Drive as Drive
    from brink.guard.drives import random_specs as random_specs
    from brink.guard.drives import record as record
    from brink.guard.drives import solution_specs as solution_specs
    from brink.guard.evaluation import GuardEvaluation as GuardEvaluation
    from brink.guard.evaluation import evaluate as evaluate
    from brink.guard.fitting import fit as fit
    from brink.guard.loop import GuardedLoop as GuardedLoop
    from brink.guard.loop import drive_with_guard as drive_with_guard

_HOMES = {
    "Drive": "drives",
    "random_specs": "drives",
    "record": "drives",
    "solution_specs": "drives",
    "GuardEvaluation": "evaluation",
    "evaluate": "evaluation",
    "fit": "fitting",
    "GuardedLoop": "loop",
    "drive_with_guard": "loop",
}
"""Module of each public name."""

__all__ = sorted(_HOMES)


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'brink.guard' has no attribute {name!r}")
    return getattr(import_module(f"brink.guard.{_HOMES[name]}"), name)
