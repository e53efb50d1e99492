"""Problems connect a search space to a verdict.

A *simulated* problem turns a candidate into an `EpisodeSpec` for the workers and evaluates the outcome. The
coordinator itself evaluates an *in-process* problem, such as a formula. Plug-ins of the group ``brink.problems`` are
subclasses of one of the two, constructed from their `params_type`. What a problem may say besides has a default. The
protocols are for what only some problems can do.
"""

import copy
import math
from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar, Final, NamedTuple, Protocol, Self, TypeAlias, TypeGuard, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from brink.search.algorithm import Evaluation, Measure, Measured, Scored
from brink.search.parameters import Value
from brink.search.space import SearchSpace
from brink.search.traffic.participants import RoadLimits
from brink.sim.catalogue import plugin_ids
from brink.sim.episode import EpisodeSpec, Json, nearest
from brink.sim.perception.user_files import KINDS, DetectorError, check_loads
from brink.worker.wire import Completed

Vectors: TypeAlias = Sequence[NDArray[np.float64]]


@dataclass(frozen=True, slots=True, kw_only=True)
class NoParams:
    """The parameters of a problem that has none."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Activity:
    """Which parameters of a solution were active in its episode, and the values that they had there.

    A parameter is inactive if its value cannot have influenced the episode: for example, the box of an injected
    trajectory that begins after the episode ended. Arrays have one entry for each parameter, in the order of
    `SearchSpace.column_names`. Distances, and DBS with them, ignore all of this and compare solutions as stored.

    Attributes:
        active: Whether the parameter was active in the episode, shape ``(d,)``.
        effective: The solution as the episode had it, shape ``(d,)``. Where it differs from the stored solution, its
            episode with the same seed would be the same: a time window that the episode's end cut off ends there, and
            a trajectory that was never delivered has the label for none. A window may be shorter than the space
            allows, so these values are for people and for comparisons, not for simulation.
        idle: Components that had no part in the episode, such as ``behaviour``.
    """

    active: NDArray[np.bool_]
    effective: NDArray[np.float64]
    idle: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SimulatedSolution:
    """A solution and what its simulation recorded.

    Attributes:
        vectors: The solution.
        activity: The parameters that were active in its episode; None if that was not recorded.
        result: The stored result of its episode (`brink.worker.wire.Completed` as JSON); None if there is none.
    """

    vectors: Vectors
    activity: Activity | None = None
    result: Mapping[str, Any] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class SeverityScale:
    """The physical magnitudes of severities from 0 to 1, which are proportional to them.

    Attributes:
        unit: The unit in which people are shown magnitudes, such as ``s`` or ``%``.
        none: Magnitude without effect, at severity 0.
        most: Magnitude at severity 1.
        meaning: What it measures, such as ``how long the target is not reported``.
        decimals: Decimal places that matter.
    """

    unit: str
    none: float
    most: float
    meaning: str
    decimals: int = 1

    def at(self, severity: float) -> float:
        """Return the magnitude of a severity."""
        return self.none + severity * (self.most - self.none)

    def number(self, severity: float) -> str:
        """Return the magnitude of a severity in digits, without its unit."""
        return f"{self.at(severity):.{self.decimals}f}"

    def words(self, severity: float) -> str:
        """Return the magnitude of a severity with its unit, such as ``1.3 s`` or ``18%``."""
        return self.number(severity) + (self.unit if self.unit == "%" else f" {self.unit}".rstrip())


def is_number(value: object) -> TypeGuard[float]:
    """Return whether a feature of a worker's result is a finite number."""
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


class BaseProblem(ABC):
    """Base class of all problems; attributes with a default are optional.

    Attributes:
        id: Versioned plug-in id.
        summary: One-line description.
        params_type: Frozen dataclass of its parameters, with fields from `brink.search.settings.setting`.
        space: The search space.
        algorithm_defaults: Suggested parameters of algorithms, such as the radius.
        extra: Name of the optional extra without which it cannot be simulated; see `modules`.
        modules: Modules that the extra installs.
        python_only: Whether part of the problem is code that a campaign file cannot have.
        requirements: Ids of the requirements that give the verdict: a solution is unsafe if it violates any of them.
        ignores_seeds: Whether chance has no part in the verdicts, so that every seed gives the same one.
        records_traces: Whether there are drives to replay.
        records_signals: Whether traces have signals, which pairs are drawn with if there are no drives to replay.
        records_activity: Whether `activity` is implemented.
        has_component: Whether it has a machine-learned component that ground truth can replace.
        terms_of_changes: What a term in descriptions of changes means that a reader may not know, such as
            ``reported: what the detector tells the driving system``.
        about_component: What a finding shows about a user's own component and what not, and how to check that, in
            sentences.
        errors_problem: Id of the problem that simulates errors of this problem's detector, for tolerances.
        usual_cells: The errors to begin with: parameters and those of their choices to study in combination.
        measures: Measures of what a candidate does; an episode has their values among its features.
        names_niches: Whether evaluations have niches of their own, for which no measures are needed.
        measured_detector: Name of the detector whose errors the episodes measure, to check it against tolerances.
    """

    id: ClassVar[str]
    summary: ClassVar[str]
    params_type: ClassVar[type[Any]]
    space: SearchSpace
    algorithm_defaults: Mapping[str, Any] = MappingProxyType({})
    extra: str = ""
    modules: tuple[str, ...] = ()
    python_only: bool = False
    requirements: tuple[str, ...] = ()
    ignores_seeds: bool = False
    records_traces: bool = True
    records_signals: bool = False
    records_activity: bool = False
    has_component: bool = False
    terms_of_changes: str = ""
    about_component: str = ""
    errors_problem: str = ""
    usual_cells: ClassVar[Mapping[str, list[str]]] = MappingProxyType({})
    measured_detector: str = ""
    measures: tuple[Measure, ...] = ()
    names_niches: bool = False

    def install(self) -> None:  # noqa: B027  (most problems need nothing)
        """Allow the workers of this machine to run what only its user may allow."""

    def wrong_inputs(self) -> list[tuple[str, str]]:
        """Return errors in files and plug-ins that parameters name, as pairs of a parameter's name and a message."""
        return []

    def wrong_criticality(self) -> tuple[str, str] | None:
        """Return the parameter that keeps criticality from measuring the requirement, and a message; or None."""
        return None

    def words(self, vectors: Vectors) -> str:
        """Describe a candidate on one line; empty to have its values listed."""
        return ""

    def words_of_change(
        self, safe: SimulatedSolution, unsafe: SimulatedSolution, changed: Collection[str]
    ) -> str:
        """Describe what differs in the unsafe one, such as ``a person is reported from 4.1 s instead of 4.3 s``.

        Args:
            safe: The safe solution.
            unsafe: The unsafe solution.
            changed: The parameters in which they differ, as component.parameter, without those that had no part in
                either episode; at least one.

        Returns:
            Empty to have the values listed.
        """
        return ""

    def activity(self, vectors: Vectors, features: Mapping[str, Any]) -> Activity | None:
        """Return which parameters of a candidate were active in its episode; None if that was not recorded.

        Args:
            vectors: The candidate.
            features: Features of the episode's result, which any worker may have sent.
        """
        return None

    def severity_scale(self, choices: Mapping[str, str]) -> SeverityScale | None:
        """Return the scale of severities, given other choices, such as the type of error; None if it is unknown.

        Args:
            choices: Choices of other parameters, by component.parameter.
        """
        return None

    def scale_of(self, name: str, values: Mapping[str, Mapping[str, Value]]) -> SeverityScale | None:
        """Return the physical scale of a number in a solution, if that is not the number itself; None if it is.

        Args:
            name: The number, as component.parameter.
            values: The decoded solution.
        """
        return None

    def traits(self, name: str, values: Mapping[str, Mapping[str, Value]]) -> tuple[str, ...]:
        """Return what makes a solution in which a number decides one of a kind, such as the error and the road.

        Args:
            name: The number, as component.parameter.
            values: The decoded solution.
        """
        return (name,)

    def error_words(self, choices: Mapping[str, str], magnitude: str) -> str:
        """Describe an error that has a `severity_scale`, such as ``not reporting the lead for 1.3 s``.

        Args:
            choices: Choices of other parameters, by component.parameter.
            magnitude: The magnitude with its unit.
        """
        return magnitude


class SimulatedProblem(BaseProblem):
    """A problem whose candidates are simulated by workers.

    Attributes:
        needs: Required capability of workers: the id of the simulator.
        timeout_s: Wall-clock limit of an episode.
        recorded: Requirements that every episode evaluates besides those that give the verdict.
        is_true: Whether ground truth takes the place of the component.
        formulas: Those of `requirements` that the campaign states, by name; see `brink.sim.formula_requirement`.
    """

    needs: str
    timeout_s: float
    recorded: ClassVar[tuple[str, ...]] = ()
    is_true: bool = False
    formulas: Mapping[str, Json] = MappingProxyType({})

    @abstractmethod
    def episode(self, vectors: Vectors, seed: int) -> EpisodeSpec:
        """Return the episode that evaluates a candidate."""

    @property
    def evaluated(self) -> tuple[str, ...]:
        """The requirements that episodes evaluate."""
        return tuple(dict.fromkeys((*self.recorded, *self.requirements)))

    def evaluation(self, outcome: Completed) -> Evaluation:
        """Return the evaluation of a candidate: the smallest robustness of `requirements`, and what was measured."""
        robustness = min(outcome.verdicts[name].robustness for name in self.requirements)
        return Scored(
            unsafe=robustness < 0,
            robustness=robustness,
            objectives=outcome.objectives,
            measures=self.measured(outcome),
        )

    def measured(self, outcome: Completed) -> dict[Measure, float]:
        """Return the values of the measures among the features of an episode, without those that it lacks."""
        values = {measure: outcome.features.get(measure.name) for measure in self.measures}
        return {measure: float(value) for measure, value in values.items() if is_number(value)}

    def with_truth(self) -> Self | None:
        """Return the problem with ground truth in place of the component; None if it has none or already uses it.

        Solutions are those of the same space, although some of their parameters then have no part in the episode.
        """
        if not self.has_component or self.is_true:
            return None
        truth = copy.copy(self)
        truth.is_true = True
        return truth

    def replicate(self, seed: int) -> int:
        """Return the replicate of an uncertain model that the episode with a seed draws."""
        return 0


@runtime_checkable
class MeasuresOnData(Protocol):
    """A simulated problem that can also measure candidates on a data set, which gives no verdict.

    Attributes:
        dataset_needs: Required capability of workers: the id of the evaluator, which runs like a simulator.
        dataset_timeout_s: Wall-clock limit of a measurement.
    """

    dataset_needs: str
    dataset_timeout_s: float

    def dataset_evaluation(self, vectors: Vectors) -> EpisodeSpec:
        """Return the specification that measures a candidate."""

    def measurement(self, outcome: Completed) -> Measured:
        """Return the measurement of a candidate from its outcome."""


class InProcessProblem(BaseProblem):
    """A problem whose candidates the coordinator evaluates itself."""

    ignores_seeds = True
    records_traces = False

    @abstractmethod
    def evaluate(self, vectors: Vectors) -> Evaluation:
        """Return the evaluation of a candidate."""


Problem: TypeAlias = SimulatedProblem | InProcessProblem


class MeasuredSeverity(NamedTuple):
    """The severity of a measured error.

    Attributes:
        severity: On the scale of the error; above 1 beyond it.
        is_bound: Whether the severity is a lower bound.
    """

    severity: float
    is_bound: bool


@runtime_checkable
class RatesMeasuredErrors(Protocol):
    """A problem that can rate the measured errors of a component on the scale of its severity."""

    def measures_errors(self, choices: Mapping[str, str]) -> bool:
        """Return whether errors of a kind are measured.

        Args:
            choices: Which error, as choices of parameters by component.parameter.
        """

    def measured_severity(
        self,
        choices: Mapping[str, str],
        measures: Mapping[str, Mapping[str, float]],
        at_least: Mapping[str, Collection[str]],
    ) -> MeasuredSeverity | None:
        """Return the severity of an error in a drive; None if the drive does not show it.

        Args:
            choices: Which error, as choices of parameters by component.parameter.
            measures: The magnitude of each type of error in the drive, by target; what it does not show is missing.
            at_least: Types whose magnitude is a lower bound, by target. Such a bound of no error is uninformative.
        """


@runtime_checkable
class ReportsViolations(Protocol):
    """A simulated problem whose simulator reports the circumstances of violations."""

    def violations(self, outcome: Completed) -> list[dict[str, Any]]:
        """Return the circumstances of the violations of an episode that count."""


@runtime_checkable
class SupportsSeeds(Protocol):
    """A problem that language models can propose seeds for.

    Attributes:
        road: The road that participants use.
        max_participants: Maximum number of participants in a candidate.
        system: Short description of the system under test.
    """

    road: RoadLimits
    max_participants: int
    system: str


def activity_of(problem: Problem, vectors: Vectors, result: Mapping[str, Any] | None) -> Activity | None:
    """Return which parameters of a solution were active in its episode, and the values that they had there.

    This is the only place that decides so. Words, tables, plots, rules and the differences between two drives use
    it. Where a parameter is active in either of two drives, compare its values as chosen, not `Activity.effective`:
    two boxes that the end of the drive cuts off end at the same step, but move at different speeds.

    Args:
        problem: The solution's problem.
        vectors: The solution.
        result: The stored result of its episode (`brink.worker.wire.Completed` as JSON); None if there is none.

    Returns:
        None if it was not recorded: the result is missing or older than the record, or the problem, such as a
        plug-in, does not show it. Then every parameter may have been active.
    """
    features = (result or {}).get("features")
    return problem.activity(vectors, features) if isinstance(features, Mapping) else None


BEHAVIOUR: Final = "behaviour"
"""Name of the component that stands for the machine-learned component, in problems that have one."""
NO_PART: Final = "the injected behaviour had no part in this drive"
"""Not "the component": one that reports nothing may well be the reason why a drive is unsafe."""


def describe_candidate(problem: Problem, vectors: Vectors, activity: Activity | None = None) -> str:
    """Describe a candidate in the problem's own words or, without these, by its categories, or else by all values.

    Args:
        problem: The problem.
        vectors: The candidate.
        activity: What had a part in its episode, if that is known: only this is described.
    """
    if activity is not None:
        vectors = problem.space.split(activity.effective)
    words = problem.words(vectors) or _values_in_words(problem, vectors, activity)
    return f"{words}; {NO_PART}" if activity is not None and BEHAVIOUR in activity.idle else words


def _values_in_words(problem: Problem, vectors: Vectors, activity: Activity | None) -> str:
    names = problem.space.column_names()
    inactive = (
        set()
        if activity is None
        else {name for name, on in zip(names, activity.active, strict=True) if not on}
    )
    words = []
    for component, values in problem.space.decode(tuple(vectors)).items():
        shown = {name: value for name, value in values.items() if f"{component}.{name}" not in inactive}
        chosen = {name: value for name, value in shown.items() if isinstance(value, str)}
        words += [f"{name} {value}" for name, value in chosen.items()]
        if not chosen:
            words += [f"{name} {value:.3g}" for name, value in shown.items()]
    return ", ".join(words)


DETECTORS: Final = "brink.detectors"


def wrong_detector(name: str) -> list[tuple[str, str]]:
    """Return the errors in the parameter ``detector``, as pairs of a parameter's name and a message."""
    known = plugin_ids(DETECTORS)
    if ":" not in name and name not in known:
        expected = ", ".join([*known, *(f"{kind}:FILE" for kind in KINDS)])
        return [("detector", f"expected one of {expected}; got {name!r}{nearest(name, known)}")]
    try:
        check_loads(name)
    except DetectorError as error:
        return [("detector", str(error).removeprefix("detector: "))]
    return []
