"""Requirements over the signals of an episode."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Self, TypeAlias

import numpy as np

from brink.formula import FormulaError
from brink.sim.adapters.command.signals import FloatArray
from brink.sim.episode import Json, Verdict
from brink.sim.formula_requirement import StatedFormula

_FIELDS: Final = ("signal", "above", "below", "unit")
MAX_UNIT_CHARS: Final = 16


Requirement: TypeAlias = "SignalRequirement | StatedFormula"


class RequirementError(ValueError):
    """A requirement is malformed; the message says what was expected and what came."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SignalRequirement:
    """A signal that must stay above or below a threshold, or between two, at all times.

    Attributes:
        signal: The signal.
        above: Values below this violate the requirement; None for no such limit.
        below: Values above this violate it; None for no such limit.
        unit: Unit of both, and of the robustness.
    """

    signal: str
    above: float | None
    below: float | None
    unit: str

    @classmethod
    def of(cls, document: Json) -> Self:
        """Return the requirement that a campaign states, such as ``{signal: gap_m, above: 1.5, unit: m}``.

        Raises:
            RequirementError: It is malformed.
        """
        if not isinstance(document, Mapping) or set(document) - set(_FIELDS):
            raise RequirementError(f"expected an object with {', '.join(_FIELDS)}; got {document!r:.80}")
        signal, unit = document.get("signal"), document.get("unit", "")
        limits = [document.get(name) for name in ("above", "below")]
        if not isinstance(signal, str) or not signal:
            raise RequirementError(f"signal: expected the name of a signal, got {signal!r:.80}")
        if not isinstance(unit, str) or len(unit) > MAX_UNIT_CHARS or not unit.isprintable():
            raise RequirementError(f"unit: expected at most {MAX_UNIT_CHARS} characters, got {unit!r:.80}")
        if limits == [None, None] or not all(
            limit is None
            or (isinstance(limit, int | float) and not isinstance(limit, bool) and abs(limit) < 1e15)
            for limit in limits
        ):
            raise RequirementError(f"expected a number above, below or both; got {dict(document)!r:.80}")
        above, below = (float(limit) if isinstance(limit, int | float) else None for limit in limits)
        return cls(signal=signal, above=above, below=below, unit=unit)

    @property
    def signals(self) -> tuple[str, ...]:
        """Names of the signals that it needs."""
        return (self.signal,)

    def margins(self, time_s: FloatArray, signals: Mapping[str, FloatArray]) -> FloatArray:
        """Return how far each sample is from a violation, negative if it is one, shape ``(n,)``."""
        values = signals[self.signal]
        margins = np.full(len(time_s), np.inf)
        if self.above is not None:
            margins = np.minimum(margins, values - self.above)
        return margins if self.below is None else np.minimum(margins, self.below - values)

    def verdict(self, time_s: FloatArray, signals: Mapping[str, FloatArray]) -> Verdict:
        """Return the verdict on an episode: the smallest margin, and the time of the first violation."""
        margins = self.margins(time_s, signals)
        violated = np.flatnonzero(margins < 0)
        return Verdict(
            robustness=float(margins.min()),
            unit=self.unit,
            violated_at_s=max(0.0, float(time_s[violated[0]])) if violated.size else None,
        )


def requirement_of(document: Json) -> Requirement:
    """Return the requirement that a campaign states: limits on a signal, or a formula over several.

    Raises:
        RequirementError: It is malformed.
    """
    if not isinstance(document, Mapping) or "stl" not in document:
        return SignalRequirement.of(document)
    try:
        return StatedFormula.of(document)
    except FormulaError as error:
        raise RequirementError(str(error)) from None
