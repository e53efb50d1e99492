"""The contract of a search algorithm: pure functions over a frozen state.

`start` makes a state, `ask` proposes a generation, `tell` takes its evaluations. Nothing is changed in place,
nothing is global, every random draw comes from a generator addressed by position (`brink.search.streams`), so equal
calls give equal states, bit for bit. The coordinator stores a state between `tell` and the next `ask` as a
`Document`; evaluated complete solutions are stored apart, as an `Archive`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from brink.search.archive import Archive
from brink.search.document import Document
from brink.search.space import SearchSpace

FloatArray: TypeAlias = NDArray[np.float64]


class Question(StrEnum):
    """What is asked about a candidate."""

    EPISODE = "episode"
    """Simulate it and give a verdict: the answer is `Scored`."""
    DATASET = "dataset-evaluation"
    """Measure it on a data set, without a simulation and without a verdict: the answer is `Measured`."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Candidate:
    """A complete solution to evaluate.

    Attributes:
        number: Stable in its campaign, counting from 0 in the order of asking.
        vectors: One read-only float64 vector a component, in the space's order.
        question: What is to be found out.
        seed_number: Whose episode seed it has, its own if None; candidates that share one meet the same chance.
    """

    number: int
    vectors: tuple[FloatArray, ...]
    question: Question = Question.EPISODE
    seed_number: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Scored:
    """The evaluation of a candidate that was simulated.

    Attributes:
        unsafe: Whether the campaign's requirement is violated.
        robustness: Distance to violation, negative if violated.
        objectives: Measures to search on, all minimised, by name.
        kinds: Of failure that it showed, by the rules of a problem that tells them apart.
    """

    unsafe: bool
    robustness: float
    objectives: Mapping[str, float] = field(default_factory=dict)
    kinds: frozenset[str] = frozenset()


@dataclass(frozen=True, slots=True, kw_only=True)
class Measured:
    """The evaluation of a candidate that was measured on a data set: neither safe nor unsafe, so not archived.

    Attributes:
        objectives: Measures to search on, all minimised, by name.
    """

    objectives: Mapping[str, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Failed:
    """The evaluation of a candidate of which no verdict could be had: neither safe nor unsafe."""

    reason: str


Evaluation: TypeAlias = Scored | Measured | Failed


class State(Protocol):
    """What every algorithm's state shows."""

    @property
    def generation(self) -> int:
        """Generations told so far."""
        ...

    @property
    def archive(self) -> Archive:
        """All complete solutions that were simulated and did not fail."""
        ...

    @property
    def fitness(self) -> FloatArray:
        """What the search minimises, of those that it looks at now, shape ``(n,)``; for progress."""
        ...

    @property
    def pending(self) -> tuple[Candidate, ...]:
        """Candidates asked and not yet told, ascending by number."""
        ...


class Algorithm(Protocol):
    """A search algorithm. Instances hold no state and cost nothing to make.

    Attributes:
        id: Versioned plug-in id, such as ``mlcshe@1``.
        summary: One line for catalogues.
        config_type: Frozen dataclass whose fields come from `brink.search.settings.setting`.
    """

    id: str
    summary: str
    config_type: type[Any]

    def check(self, space: SearchSpace, config: Any, *, budget: int) -> None:
        """Raise what is wrong with this combination.

        Raises:
            UnsupportedSpace: The algorithm cannot work on that space.
            ConfigError: A setting does not go with the space or with the budget.
        """
        ...

    def start(self, space: SearchSpace, config: Any, *, seed: int, budget: int) -> Any:
        """Return the first state, with nothing asked yet."""
        ...

    def ask(self, state: Any) -> tuple[Any, tuple[Candidate, ...]]:
        """Return a state with a pending generation, and that generation.

        Raises:
            OrderError: The last generation has not been told yet, or the search is finished.
        """
        ...

    def tell(self, state: Any, evaluations: Mapping[int, Evaluation]) -> Any:
        """Return the state after the pending generation was evaluated.

        Args:
            state: The state that `ask` returned.
            evaluations: One for each pending candidate, by number, in any order.

        Raises:
            OrderError: Nothing is pending, or the numbers are not the pending ones.
        """
        ...

    def finished(self, state: Any) -> bool:
        """Return whether the search is over: its budget is spent, or nothing new can be asked."""
        ...

    def dump(self, state: Any) -> Document:
        """Return the state without its archive, as a versioned document."""
        ...

    def load(self, space: SearchSpace, config: Any, document: Document, archive: Archive) -> Any:
        """Return the state that `dump` wrote, with the archive that it had then.

        Raises:
            DocumentError: The document is broken, of another algorithm, or of an unknown version.
        """
        ...
