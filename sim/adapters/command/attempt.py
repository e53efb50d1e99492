"""What an episode recorded, and what came of running a command for it."""

from collections.abc import Mapping
from dataclasses import dataclass

from brink.sim.adapters.command.requirement import Requirement
from brink.sim.adapters.command.signals import FloatArray, Signals
from brink.sim.episode import Verdict
from brink.sim.programs import Ending


@dataclass(frozen=True, slots=True, kw_only=True)
class Judged:
    """The signals of an episode with their verdicts.

    Attributes:
        source: Which signals are derived, and which are positions.
        time_s: Times of the log, shape ``(n,)``.
        signals: Signals that were asked for, shape ``(n,)`` each.
        requirements: The requirements, by name.
        verdicts: Their verdicts.
    """

    source: Signals
    time_s: FloatArray
    signals: Mapping[str, FloatArray]
    requirements: Mapping[str, Requirement]
    verdicts: Mapping[str, Verdict]


@dataclass(frozen=True, slots=True, kw_only=True)
class Attempt(Judged):
    """An episode of a command that has a verdict.

    Attributes:
        command: Program and arguments.
        ending: How the program ended.
        output: The end of what it printed.
    """

    command: tuple[str, ...]
    ending: Ending
    output: str
