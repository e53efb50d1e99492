"""A plug-in that stalls on demand, for `benchmarks.stalls`, which copies it to a folder of its own.

There, it is what a user's plug-in is to the coordinator: a module outside Brink, named in ``BRINK_PLUGINS``. A fault
happens only while the file that the campaign names exists: so a campaign can be submitted before its code stalls.
Episodes are those of ``load@1``.
"""

import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from benchmarks.load import Load, LoadParams
from brink.search.algorithm import Candidate, Evaluation
from brink.search.algorithms.random_search import RandomSearch, RandomSearchConfig, RandomSearchState
from brink.search.settings import check_settings, setting
from brink.server.problems.base import Vectors
from brink.server.problems.catalogue import ALGORITHMS, PROBLEMS
from brink.sim.catalogue import register
from brink.sim.episode import EpisodeSpec
from brink.worker.wire import Completed

PLUGIN = "stalling"
"""Name under which a coordinator imports the copy."""
PROBLEM = "stall@1"
ALGORITHM = "stall-random@1"
PLACES = ("none", "construction", "episode", "evaluation", "words", "ask", "tell")
FAULTS = ("sleep", "hang", "loop", "raise")
SLEEP_S = 15.0
HANG_S = 86_400.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Stall:
    """Where and how code stalls.

    Attributes:
        place: The method.
        fault: What happens there: it sleeps, hangs, computes without end, or raises an error.
        armed: File that must exist for it to happen.
    """

    place: str
    fault: str
    armed: str

    def at(self, place: str) -> None:
        """Stall if this is the place, and the fault is armed.

        Raises:
            RuntimeError: The fault is an error.
        """
        if place != self.place or not Path(self.armed).exists():
            return
        if self.fault == "raise":
            raise RuntimeError(f"{place} fails")
        if self.fault == "loop":
            until_s = time.monotonic() + HANG_S
            while time.monotonic() < until_s:
                pass
        time.sleep(SLEEP_S if self.fault == "sleep" else HANG_S)


@dataclass(frozen=True, slots=True, kw_only=True)
class StallParams:
    """Where and how the problem stalls."""

    place: str = setting("none", help="Where it stalls.", choices=PLACES)
    fault: str = setting("sleep", help="How it stalls.", choices=FAULTS)
    armed: str = setting("", help="File that must exist for it to happen.")

    def __post_init__(self) -> None:
        check_settings(self)


class StallingProblem(Load):
    """The unit disc, as in ``load@1``."""

    id: ClassVar[str] = PROBLEM
    summary: ClassVar[str] = "Stalls on demand."
    params_type: ClassVar[type[Any]] = StallParams

    def __init__(self, params: StallParams) -> None:
        self.stall = Stall(place=params.place, fault=params.fault, armed=params.armed)
        self.stall.at("construction")
        super().__init__(LoadParams())

    def episode(self, vectors: Vectors, seed: int) -> EpisodeSpec:
        """Return the episode of a candidate."""
        self.stall.at("episode")
        return super().episode(vectors, seed)

    def evaluation(self, outcome: Completed) -> Evaluation:
        """Return the evaluation of an episode's outcome."""
        self.stall.at("evaluation")
        return super().evaluation(outcome)

    def words(self, vectors: Vectors) -> str:
        """Describe a candidate."""
        self.stall.at("words")
        return f"at {vectors[0][0]:.1f}, {vectors[1][0]:.1f}"


@dataclass(frozen=True, slots=True, kw_only=True)
class StallingConfig(RandomSearchConfig):
    """Settings of random search, and where it stalls."""

    place: str = setting("none", help="Where it stalls.", choices=PLACES)
    fault: str = setting("sleep", help="How it stalls.", choices=FAULTS)
    armed: str = setting("", help="File that must exist for it to happen.")

    @property
    def stall(self) -> Stall:
        """Where and how it stalls."""
        return Stall(place=self.place, fault=self.fault, armed=self.armed)


class StallingSearch(RandomSearch):
    """Random search that stalls."""

    id = ALGORITHM
    summary = "Random search that stalls on demand."
    config_type = StallingConfig

    def ask(self, state: RandomSearchState) -> tuple[RandomSearchState, tuple[Candidate, ...]]:
        """Return the state with one more generation in flight, and that generation."""
        if isinstance(state.config, StallingConfig):
            state.config.stall.at("ask")
        return super().ask(state)

    def tell(self, state: RandomSearchState, evaluations: Mapping[int, Evaluation]) -> RandomSearchState:
        """Return the state after the pending generation was evaluated."""
        if isinstance(state.config, StallingConfig):
            state.config.stall.at("tell")
        return super().tell(state, evaluations)


if __name__ == PLUGIN:  # in the copy alone: who imports this module only wants its names
    register(PROBLEMS, PROBLEM, StallingProblem)
    register(ALGORITHMS, ALGORITHM, StallingSearch)
