"""Seeds from outside: an algorithm may ask somebody else for solutions, such as a language model.

An algorithm that does is asked `Seeded.wanted` before every `ask`. While something is wanted it has no generation to
hand out; `Seeded.seeded` tells it what came, which may be nothing at all. Proposals are never trusted: the space's
constraints mend them, and the algorithm decides which it takes.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Protocol, runtime_checkable

from brink.search.actions.variation import Solution


class Origin(StrEnum):
    """Where a solution comes from."""

    RANDOM = "random"
    HEURISTIC = "heuristic"
    MUTATION = "mutation"
    CROSSOVER = "crossover"
    LLM = "llm"
    LLM_REPAIR = "llm_repair"


@dataclass(frozen=True, slots=True, kw_only=True)
class SeedRequest:
    """What is wanted.

    Attributes:
        number: Counts the requests of a campaign from 0, so that an answer is known again.
        count: How many solutions.
        exposed: Solutions that exposed a violation, the latest first; none at the start of a search.
        silent: Solutions that exposed none, the latest first.
        rejected: Proposals of the round before that were not different enough.
        round: 0, or how many times the request was sent back.
    """

    number: int
    count: int
    exposed: tuple[Solution, ...] = ()
    silent: tuple[Solution, ...] = ()
    rejected: tuple[Solution, ...] = ()
    round: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Proposal:
    """A solution that somebody proposes.

    Attributes:
        solution: The participants.
        origin: Who made it, and whether it had to be mended.
    """

    solution: Solution
    origin: Origin


@runtime_checkable
class Seeded(Protocol):
    """An algorithm that may want seeds from outside."""

    def wanted(self, state: Any) -> SeedRequest | None:
        """Return what is wanted before the next generation can be asked, or None."""
        ...

    def seeded(self, state: Any, proposals: Sequence[Proposal]) -> Any:
        """Return the state after proposals came, perhaps none.

        Raises:
            OrderError: Nothing is wanted.
        """
        ...
