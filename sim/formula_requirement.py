"""Requirements of users in signal temporal logic, over what simulators record of the ego at every control step.

A campaign states one as ``{stl: "always[0:20] (front_gap_m > 1.5)", unit: m}``. `brink.sim.stl` evaluates it at
time 0.
"""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import Any, Final, Self

import numpy as np
from numpy.typing import ArrayLike

from brink.formula import FormulaError
from brink.sim.driving.interface import LightState
from brink.sim.episode import Json, Verdict, nearest
from brink.sim.errors import InvalidEpisode, SimulationCrashed
from brink.sim.requirements import Requirement, WorldSample
from brink.sim.stl import FloatArray, Stl
from brink.sim.trace import Trace

FARTHEST_M: Final = 100.0
"""Value of a distance to something farther away, or that is not there."""
HORIZON: Final = 100.0
MOST_FORMULAS: Final = 16
_FIELDS: Final = ("stl", "unit", "horizon")
_NAME: Final = re.compile(r"[a-z][a-z0-9_-]{0,39}")
_ROUNDING_S: Final = 1e-4
"""Traces have times in single precision."""


def _distance(name: str) -> Callable[[WorldSample], float]:
    def read(sample: WorldSample) -> float:
        distance_m = getattr(sample, name)
        return FARTHEST_M if distance_m is None else min(FARTHEST_M, float(distance_m))

    return read


_FACTS: Final = (
    *("speed_mps", "speed_limit_mps", "closing_speed_mps", "x_m", "y_m", "yaw_rad", "station_m", "offset_m"),
    *("heading_error_rad", "lane_left_m", "lane_right_m", "goal_reached", "may_wait", "in_conflict_area"),
    "brakes_for_nothing",
)
_DISTANCES: Final = ("front_gap_m", "pedestrian_gap_m", "nearest_gap_m", "stop_line_gap_m", "road_edge_gap_m")
RARE_SIGNALS: Final = ("road_edge_gap_m",)
"""Signals that few simulators measure."""
ACCELERATION: Final = "accel_mps2"
SIGNALS: Final[Mapping[str, Callable[[WorldSample], float]]] = {
    **{name: attrgetter(name) for name in _FACTS},
    **{name: _distance(name) for name in _DISTANCES},
    ACCELERATION: lambda sample: 0.0,  # computed from the speeds
    "light_red": lambda sample: sample.light is LightState.RED,
    "light_amber": lambda sample: sample.light is LightState.AMBER,
    "collision": lambda sample: sample.collision is not None,
}
"""What formulas may be about, read from a sample; `WorldSample` and docs/reference/formulas.md have the meanings."""


@dataclass(frozen=True, slots=True)
class StatedFormula:
    """A requirement in signal temporal logic over any recording.

    Attributes:
        formula: The formula.
        unit: Unit of its comparisons.
        horizon: Bound on the absolute value of the robustness.
    """

    formula: Stl
    unit: str
    horizon: float = HORIZON

    @classmethod
    def of(cls, stated: object) -> Self:
        """Return the requirement that a campaign states, such as ``{stl: always gap > 1.5, unit: m}``.

        Raises:
            FormulaError: It is malformed.
        """
        if not isinstance(stated, Mapping) or not {"stl", "unit"} <= set(stated) <= {*_FIELDS}:
            raise FormulaError(
                f"expected {{stl: FORMULA, unit: UNIT}}, and perhaps horizon; got {stated!r:.200}"
            )
        unit, horizon = stated["unit"], stated.get("horizon", HORIZON)
        if not isinstance(unit, str) or not 0 < len(unit) <= 16 or not unit.isprintable():
            raise FormulaError(f"expected a unit such as m, or 1 for numbers without one; got {unit!r:.80}")
        if isinstance(horizon, bool) or not isinstance(horizon, int | float) or not 0 < horizon <= 1e9:
            raise FormulaError(f"expected a horizon above 0, up to 1e9 {unit}; got {horizon!r:.80}")
        return cls(Stl(stated["stl"]), unit, float(horizon))

    @property
    def signals(self) -> tuple[str, ...]:
        """Names of the signals that it needs."""
        return self.formula.names

    def check(self, signals: Sequence[str], duration_s: float) -> None:
        """Check that it can be evaluated.

        Args:
            signals: The signals that are recorded.
            duration_s: Length of a recording.

        Raises:
            FormulaError: A signal is not recorded, or it looks beyond the end.
        """
        for name in self.signals:
            if name not in signals:
                raise FormulaError(
                    f"no signal {name!r} is recorded{nearest(name, tuple(signals))}; there are {', '.join(signals)}"
                )
        if self.formula.begins_s > duration_s:
            raise FormulaError(
                f"looks {self.formula.begins_s:g} s ahead, but episodes end after {duration_s:g} s"
            )

    def verdict(self, times_s: ArrayLike, signals: Mapping[str, ArrayLike]) -> Verdict:
        """Return the robustness, and the time at which a violation is decided.

        Args:
            times_s: Times of the samples, increasing, shape ``(n,)``.
            signals: Numbers, or truth values, of each signal at these times.

        Raises:
            FormulaError: A comparison has no value, such as after 0 / 0, or the recording is malformed.
        """
        found = self.formula.satisfaction(times_s, signals)
        robustness = max(-self.horizon, min(self.horizon, found.robustness))
        return Verdict(robustness=robustness, unit=self.unit, violated_at_s=found.violated_at_s)

    def margins(self, times_s: ArrayLike, signals: Mapping[str, ArrayLike]) -> FloatArray:
        """Return the robustness over time (`Stl.margins`); infinite at the horizon, where it does not apply.

        Args:
            times_s: As for `verdict`.
            signals: As for `verdict`.
        """
        margins = self.formula.margins(times_s, signals)
        return np.where(margins >= self.horizon, math.inf, np.maximum(margins, -self.horizon))


def stated_formulas(
    stated: Mapping[str, object], signals: Sequence[str], duration_s: float = math.inf
) -> dict[str, StatedFormula]:
    """Return the requirements that a campaign or an episode states, by name.

    Args:
        stated: The requirements as JSON, by name.
        signals: The signals that are recorded.
        duration_s: Length of an episode.

    Raises:
        FormulaError: A name or a requirement is malformed, a signal is not recorded, or a formula looks beyond the
            end; the message names it.
    """
    if len(stated) > MOST_FORMULAS:
        raise FormulaError(f"expected at most {MOST_FORMULAS} formulas, got {len(stated)}")
    made = {}
    for name, one in stated.items():
        if not _NAME.fullmatch(name):
            raise FormulaError(
                f"expected a name of lower-case letters, digits and - such as keep-gap, got {name!r:.80}"
            )
        try:
            made[name] = StatedFormula.of(one)
            made[name].check(signals, duration_s)
        except FormulaError as error:
            raise FormulaError(f"{name}: {error}") from error
    return made


class FormulaRequirement:
    """A formula over the signals of a world, in one episode.

    Args:
        stated: The formula, over some of `SIGNALS`.
    """

    def __init__(self, stated: StatedFormula) -> None:
        self.unit, self.horizon = stated.unit, stated.horizon
        self._stated = stated
        self._readers = [(name, SIGNALS[name]) for name in stated.signals]
        self._times_s: list[float] = []
        self._signals: dict[str, list[float]] = {name: [] for name in stated.signals}
        self._speeds_mps: list[float] = []

    def observe(self, sample: WorldSample) -> float:
        """Record a sample; the robustness that a formula has at it depends on later ones, so it is the horizon.

        Args:
            sample: Later than all samples before it.
        """
        for name, read in self._readers:
            self._signals[name].append(read(sample))
        self._times_s.append(sample.time_s)
        self._speeds_mps.append(sample.speed_mps)
        return self.horizon

    def verdict(self) -> Verdict:
        """Return the robustness, and the time at which a violation is decided.

        Raises:
            SimulationCrashed: A comparison has no value, such as after 0 / 0.
        """
        if not self._times_s:
            return Verdict(robustness=self.horizon, unit=self.unit, violated_at_s=None)
        try:
            verdict = self._stated.verdict(*self._recording())
        except FormulaError as error:
            raise SimulationCrashed(str(error)) from error
        at_s = verdict.violated_at_s
        return verdict if at_s is None else replace(verdict, violated_at_s=max(at_s, self._times_s[0]))

    def margins(self, times_s: ArrayLike) -> FloatArray:
        """Return the robustness over time, the least until the next of some times, which increase."""
        margins = self._stated.margins(*self._recording())
        first = np.searchsorted(self._times_s, np.asarray(times_s, np.float64) - _ROUNDING_S)
        least: FloatArray = np.minimum.reduceat(margins, np.minimum(first, len(margins) - 1))
        return least

    def features(self) -> Mapping[str, Json]:
        """Return no further facts."""
        return {}

    def _recording(self) -> tuple[FloatArray, dict[str, Any]]:
        """Return the times, of which the first stands for the beginning of the episode, and the signals."""
        times_s = np.array(self._times_s)
        signals: dict[str, Any] = dict(self._signals)
        if ACCELERATION in signals:
            steps_s = np.diff(times_s, prepend=times_s[0] - 1.0)
            signals[ACCELERATION] = np.diff(self._speeds_mps, prepend=self._speeds_mps[0]) / steps_s
        times_s[0] = min(times_s[0], 0.0)
        return times_s, signals


def formula_requirements(stated: Mapping[str, object]) -> dict[str, FormulaRequirement]:
    """Return new requirements for one episode that states them.

    Raises:
        InvalidEpisode: A formula is wrong, or about something that is not among `SIGNALS`.
    """
    try:
        formulas = stated_formulas(stated, tuple(SIGNALS))
    except FormulaError as error:
        raise InvalidEpisode(f"formulas: {error}") from error
    return {name: FormulaRequirement(one) for name, one in formulas.items()}


def with_margins(trace: Trace, requirements: Mapping[str, Requirement]) -> Trace:
    """Return a trace with the robustness over time of the formulas among some requirements."""
    found = {
        name: one.margins(trace.time_s).astype(np.float32)
        for name, one in requirements.items()
        if isinstance(one, FormulaRequirement)
    }
    return replace(trace, robustness={**trace.robustness, **found}) if found else trace
