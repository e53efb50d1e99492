"""What came of running a command."""

from collections.abc import Mapping
from dataclasses import dataclass

from brink.sim.adapters.command.requirement import Requirement
from brink.sim.adapters.command.signals import FloatArray, SignalSource
from brink.sim.episode import Verdict
from brink.sim.programs import Ending


@dataclass(frozen=True, slots=True, kw_only=True)
class Attempt:
    """An episode that has a verdict.

    Attributes:
        command: Program and arguments.
        ending: How the program ended.
        output: The end of what it printed.
        source: Where its signals stand.
        time_s: Times of the log, shape ``(n,)``.
        signals: Signals that were asked for, shape ``(n,)`` each.
        requirements: The requirements, by name.
        verdicts: Their verdicts.
    """

    command: tuple[str, ...]
    ending: Ending
    output: str
    source: SignalSource
    time_s: FloatArray
    signals: Mapping[str, FloatArray]
    requirements: Mapping[str, Requirement]
    verdicts: Mapping[str, Verdict]
