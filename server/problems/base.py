"""What a problem is: it ties a search space to a verdict.

A *simulated* problem turns a candidate into an `EpisodeSpec` for the workers and reads the evaluation from what
came back. An *in-process* problem is a formula that the coordinator evaluates itself. Plug-ins of the group
``brink.problems`` are classes of either kind, made from their `params_type`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol, TypeAlias, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from brink.search.algorithm import Evaluation, Measured
from brink.search.space import SearchSpace
from brink.search.traffic.participants import RoadLimits
from brink.sim.episode import EpisodeSpec
from brink.worker.wire import Completed

Vectors: TypeAlias = Sequence[NDArray[np.float64]]


@dataclass(frozen=True, slots=True, kw_only=True)
class NoParams:
    """The parameters of a problem that has none."""


class _Problem(Protocol):
    """What both kinds of problem have.

    Attributes:
        id: Versioned plug-in id.
        summary: One line for catalogues.
        params_type: Frozen dataclass of its parameters, with fields from `brink.search.settings.setting`.
        space: Where to search.
        algorithm_defaults: Settings of algorithms that this problem suggests, such as the radius.
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
        needs: What a worker must be capable of: the simulator's id.
        timeout_s: Wall-clock time after which an episode is given up.
    """

    needs: str
    timeout_s: float

    def episode(self, vectors: Vectors, seed: int) -> EpisodeSpec:
        """Return the episode that evaluates a candidate."""
        ...

    def evaluation(self, outcome: Completed) -> Evaluation:
        """Return what a completed episode says of its candidate."""
        ...


@runtime_checkable
class MeasuresOnData(Protocol):
    """What a simulated problem may do besides: measure a candidate on a data set, which gives no verdict.

    Attributes:
        dataset_needs: What a worker must be capable of: the id of the evaluator, run as a simulator is.
        dataset_timeout_s: Wall-clock time after which an evaluation is given up.
    """

    dataset_needs: str
    dataset_timeout_s: float

    def dataset_evaluation(self, vectors: Vectors) -> EpisodeSpec:
        """Return what measures a candidate."""
        ...

    def measurement(self, outcome: Completed) -> Measured:
        """Return what a completed evaluation says of its candidate."""
        ...


@runtime_checkable
class InProcessProblem(_Problem, Protocol):
    """A problem whose candidates the coordinator evaluates itself."""

    def evaluate(self, vectors: Vectors) -> Evaluation:
        """Return the evaluation of a candidate."""
        ...


@runtime_checkable
class ChecksInputs(Protocol):
    """A problem that uses files or plug-ins that may be missing or broken; may be left out."""

    def wrong_inputs(self) -> list[tuple[str, str]]:
        """Return what is wrong with what its parameters name: the parameter and a message each."""
        ...


@runtime_checkable
class NeedsExtra(Protocol):
    """A problem that only machines with an optional part of Brink can simulate; may be left out.

    Attributes:
        extra: Name of the extra.
        modules: Modules that it brings.
    """

    extra: str
    modules: tuple[str, ...]


@runtime_checkable
class InWords(Protocol):
    """A problem that can say what a candidate is; may be left out."""

    def words(self, vectors: Vectors) -> str:
        """Return a candidate in a line of words."""
        ...


@runtime_checkable
class TellsViolations(Protocol):
    """A simulated problem whose simulator tells the circumstances of violations; may be left out."""

    def violations(self, outcome: Completed) -> list[dict[str, Any]]:
        """Return the circumstances of those violations of an episode that count."""
        ...


@runtime_checkable
class Describes(Protocol):
    """A problem that language models can be asked about; optional.

    Attributes:
        road: The road that participants use.
        max_participants: Maximum number of participants in a candidate.
        system: Short description of the system under test.
    """

    road: RoadLimits
    max_participants: int
    system: str


Problem: TypeAlias = SimulatedProblem | InProcessProblem


def words_of(problem: Problem, vectors: Vectors) -> str:
    """Return a candidate in words: the problem's own, or else its categories, and all of it if it has none."""
    if isinstance(problem, InWords):
        return problem.words(vectors)
    words = []
    for values in problem.space.decode(tuple(vectors)).values():
        chosen = {name: value for name, value in values.items() if isinstance(value, str)}
        words += [f"{name} {value}" for name, value in chosen.items()]
        if not chosen:
            words += [f"{name} {value:.3g}" for name, value in values.items()]
    return ", ".join(words)
