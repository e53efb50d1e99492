"""Problems connect a search space to a verdict.

A *simulated* problem turns a candidate into an `EpisodeSpec` for the workers and evaluates the outcome. The
coordinator itself evaluates an *in-process* problem, such as a formula. Plug-ins of the group ``brink.problems`` are
classes of either kind, constructed from their `params_type`. The other protocols are optional.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Final, NamedTuple, Protocol, TypeAlias, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from brink.search.algorithm import Evaluation, Measured
from brink.search.space import SearchSpace
from brink.search.traffic.participants import RoadLimits
from brink.sim.catalogue import plugin_ids
from brink.sim.episode import EpisodeSpec, nearest
from brink.sim.perception.user_files import KINDS, DetectorError, check_loads
from brink.worker.wire import Completed

Vectors: TypeAlias = Sequence[NDArray[np.float64]]


@dataclass(frozen=True, slots=True, kw_only=True)
class NoParams:
    """The parameters of a problem that has none."""


class _Problem(Protocol):
    """Attributes that all problems share.

    Attributes:
        id: Versioned plug-in id.
        summary: One-line description.
        params_type: Frozen dataclass of its parameters, with fields from `brink.search.settings.setting`.
        space: The search space.
        algorithm_defaults: Suggested parameters of algorithms, such as the radius.
    """

    id: ClassVar[str]
    summary: ClassVar[str]
    params_type: ClassVar[type[Any]]
    space: SearchSpace
    algorithm_defaults: Mapping[str, Any]

    def __init__(self, params: Any) -> None: ...


@runtime_checkable
class SimulatedProblem(_Problem, Protocol):
    """A problem whose candidates are simulated by workers.

    Attributes:
        needs: Required capability of workers: the id of the simulator.
        timeout_s: Wall-clock limit of an episode.
    """

    needs: str
    timeout_s: float

    def episode(self, vectors: Vectors, seed: int) -> EpisodeSpec:
        """Return the episode that evaluates a candidate."""
        ...

    def evaluation(self, outcome: Completed) -> Evaluation:
        """Return the evaluation of a candidate from the outcome of its episode."""
        ...


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
        ...

    def measurement(self, outcome: Completed) -> Measured:
        """Return the measurement of a candidate from its outcome."""
        ...


@runtime_checkable
class InProcessProblem(_Problem, Protocol):
    """A problem whose candidates the coordinator evaluates itself."""

    def evaluate(self, vectors: Vectors) -> Evaluation:
        """Return the evaluation of a candidate."""
        ...


@runtime_checkable
class ChecksInputs(Protocol):
    """A problem with parameters that name files or plug-ins, which may be missing or broken."""

    def wrong_inputs(self) -> list[tuple[str, str]]:
        """Return errors as pairs of a parameter's name and a message."""
        ...


@runtime_checkable
class ChecksCriticality(Protocol):
    """A problem whose criticality may be measured by something that says nothing about its requirement."""

    def wrong_criticality(self) -> tuple[str, str] | None:
        """Return the parameter that is to blame and a message; None if a search may minimise the criticality."""
        ...


@runtime_checkable
class NeedsExtra(Protocol):
    """A problem that can only be simulated with an optional extra installed.

    Attributes:
        extra: Name of the extra.
        modules: Modules that the extra installs.
    """

    extra: str
    modules: tuple[str, ...]


@runtime_checkable
class IgnoresSeeds(Protocol):
    """A simulated problem that says whether chance has a part in its verdicts.

    Attributes:
        ignores_seeds: Whether every seed gives the same verdict.
    """

    ignores_seeds: bool


@runtime_checkable
class NeedsPython(Protocol):
    """A problem that says whether its campaigns can be started from Python only.

    Attributes:
        python_only: Whether part of the problem is code that a campaign file cannot have.
    """

    python_only: bool


@runtime_checkable
class RecordsTraces(Protocol):
    """A simulated problem that says whether its simulator records traces; any other's does.

    Attributes:
        records_traces: Whether there are drives to replay.
    """

    records_traces: bool


@runtime_checkable
class DescribesCandidates(Protocol):
    """A problem that can describe its candidates."""

    def words(self, vectors: Vectors) -> str:
        """Describe a candidate on one line."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Activity:
    """Which parameters of a solution had a part in its episode, and the values that they had there.

    A parameter is inactive if its value cannot have influenced the episode: for example, the box of an injected
    trajectory that begins after the episode ended. Arrays have one entry for each parameter, in the order of
    `SearchSpace.column_names`. Distances, and DBS with them, ignore all of this and compare solutions as stored.

    Attributes:
        active: Whether the parameter had a part in the episode, shape ``(d,)``.
        effective: The solution as the episode had it, shape ``(d,)``. Where it differs from the stored solution, its
            episode with the same seed would be the same: a time window that the episode's end cut off ends there, and
            a trajectory that was never delivered has the label for none. A window may be shorter than the space
            allows, so these values are for people and for comparisons, not for simulation.
        idle: Components that had no part in the episode, such as ``behaviour``.
    """

    active: NDArray[np.bool_]
    effective: NDArray[np.float64]
    idle: tuple[str, ...] = ()


@runtime_checkable
class RecordsActivity(Protocol):
    """A simulated problem whose episodes tell which parameters had a part in them."""

    def activity(self, vectors: Vectors, features: Mapping[str, Any]) -> Activity | None:
        """Return which parameters of a candidate had a part in its episode; None if that was not recorded.

        Args:
            vectors: The candidate.
            features: Features of the episode's result, which any worker may have sent.
        """
        ...


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SimulatedSolution:
    """A solution and what its simulation recorded.

    Attributes:
        vectors: The solution.
        activity: What had a part in its episode; None if that was not recorded.
        result: The stored result of its episode (`brink.worker.wire.Completed` as JSON); None if there is none.
    """

    vectors: Vectors
    activity: Activity | None = None
    result: Mapping[str, Any] | None = None


@runtime_checkable
class DescribesChanges(Protocol):
    """A problem that can describe the change from one candidate to a neighbouring one."""

    def words_of_change(
        self, safe: SimulatedSolution, unsafe: SimulatedSolution, changed: Collection[str]
    ) -> str:
        """Describe what is different in the unsafe one, such as ``a person is reported from 4.1 s instead of 4.3 s``.

        Args:
            safe: The safe solution.
            unsafe: The unsafe solution.
            changed: The parameters in which they differ, as component.parameter, without those that had no part in
                either episode; at least one.
        """
        ...


@runtime_checkable
class ExplainsChanges(Protocol):
    """A problem whose descriptions of changes use a term that a reader may not know.

    Attributes:
        terms_of_changes: What the term means, such as ``reported: what the detector tells the driving system``.
    """

    terms_of_changes: ClassVar[str]


@runtime_checkable
class QualifiesComponent(Protocol):
    """A problem whose findings do not speak of a component of the user's own as they stand.

    Attributes:
        about_component: What a finding says of the component and what not, and how to check that, in sentences.
    """

    about_component: ClassVar[str]


@dataclass(frozen=True, slots=True, kw_only=True)
class SeverityScale:
    """What severities from 0 to 1 mean in a physical unit; the two are proportional.

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


@runtime_checkable
class ScalesSeverity(Protocol):
    """A problem with an error whose severity is a parameter."""

    def severity_scale(self, choices: Mapping[str, str]) -> SeverityScale | None:
        """Return what severities mean, given other choices, such as the type of error; None if that is unknown.

        Args:
            choices: Choices of other parameters, by component.parameter.
        """
        ...

    def error_words(self, choices: Mapping[str, str], magnitude: str) -> str:
        """Describe an error as an activity, such as ``not reporting the lead for 1.3 s``.

        Args:
            choices: Choices of other parameters, by component.parameter.
            magnitude: The magnitude with its unit.
        """
        ...


class MeasuredSeverity(NamedTuple):
    """How gross a measured error was.

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
        ...

    def measured_severity(
        self,
        choices: Mapping[str, str],
        measures: Mapping[str, Mapping[str, float]],
        at_least: Mapping[str, Collection[str]],
    ) -> MeasuredSeverity | None:
        """Return how severe an error was in a drive; None if the drive does not tell.

        Args:
            choices: Which error, as choices of parameters by component.parameter.
            measures: The magnitude of each type of error in the drive, by target; what it cannot tell is missing.
            at_least: Types whose magnitude is a lower bound, by target. Such a bound of no error tells nothing.
        """
        ...


@runtime_checkable
class NamesRequirements(Protocol):
    """A simulated problem whose verdict depends on requirements of the episode.

    Attributes:
        requirements: Ids of the requirements; a solution is unsafe if it violates any of them.
    """

    requirements: tuple[str, ...]


@runtime_checkable
class ReplacesComponent(Protocol):
    """A simulated problem whose machine-learned component can be replaced by the ground truth."""

    def with_truth(self) -> "SimulatedProblem | None":
        """Return the same problem with ground truth in place of the component; None if it has that already.

        Solutions are those of the same space, although some of their parameters then have no part in the episode.
        """
        ...


@runtime_checkable
class HasDetector(Protocol):
    """A problem with an obstacle detector, for which tolerances can be found.

    Attributes:
        errors_problem: Id of the problem that simulates errors of this detector.
    """

    errors_problem: str


@runtime_checkable
class MeasuresDetector(Protocol):
    """A problem whose episodes measure the errors of a detector in the loop, to hold it against tolerances.

    Attributes:
        measured_detector: Name of the detector.
    """

    measured_detector: str


@runtime_checkable
class StudiesErrors(Protocol):
    """A problem that simulates errors of a component, for tolerances.

    Attributes:
        usual_cells: The errors to begin with: parameters and those of their choices to study in combination.
    """

    usual_cells: Mapping[str, list[str]]


@runtime_checkable
class DrawsReplicates(Protocol):
    """A problem with an uncertain model, of which each episode draws a replicate."""

    def replicate(self, seed: int) -> int:
        """Return the number of the replicate that the episode with a seed draws."""
        ...


@runtime_checkable
class ReportsViolations(Protocol):
    """A simulated problem whose simulator reports the circumstances of violations."""

    def violations(self, outcome: Completed) -> list[dict[str, Any]]:
        """Return the circumstances of the violations of an episode that count."""
        ...


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


Problem: TypeAlias = SimulatedProblem | InProcessProblem


def ignores_seeds(problem: Problem) -> bool:
    """Return whether chance has no part in the verdicts of a problem."""
    return isinstance(problem, InProcessProblem) or (
        isinstance(problem, IgnoresSeeds) and problem.ignores_seeds
    )


def records_traces(problem: Problem) -> bool:
    """Return whether episodes of a problem can be replayed."""
    if isinstance(problem, InProcessProblem):
        return False
    return problem.records_traces if isinstance(problem, RecordsTraces) else True


def activity_of(problem: Problem, vectors: Vectors, result: Mapping[str, Any] | None) -> Activity | None:
    """Return which parameters of a solution had a part in its episode, and the values that they had there.

    This is the only place that decides so. Words, tables, plots, rules and the differences between two drives use
    it. Where a parameter is active in either of two drives, compare its values as chosen, not `Activity.effective`:
    two boxes that the end of the drive cuts off end at the same step, but move at different speeds.

    Args:
        problem: The solution's problem.
        vectors: The solution.
        result: The stored result of its episode (`brink.worker.wire.Completed` as JSON); None if there is none.

    Returns:
        None if it was not recorded: the result is missing or older than the record, or the problem, such as a
        plug-in, does not implement `RecordsActivity`. Then every parameter may have had a part.
    """
    features = (result or {}).get("features")
    if not isinstance(problem, RecordsActivity) or not isinstance(features, Mapping):
        return None
    return problem.activity(vectors, features)


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
    words = _words_of(problem, vectors, activity)
    return f"{words}; {NO_PART}" if activity is not None and BEHAVIOUR in activity.idle else words


def _words_of(problem: Problem, vectors: Vectors, activity: Activity | None) -> str:
    if isinstance(problem, DescribesCandidates):
        return problem.words(vectors)
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
