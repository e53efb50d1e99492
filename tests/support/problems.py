"""Small problems for tests: a ball in the plane, simulated by ``faulty@1``, and a line with one component."""

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, ClassVar

import pytest

from brink.search.algorithm import Evaluation, Measured, Scored
from brink.search.settings import check_settings, setting
from brink.search.space import Component, Real, SearchSpace
from brink.search.testing import example_spaces
from brink.server.campaigns import result_check
from brink.server.problems.base import InProcessProblem, NoParams, SimulatedProblem, Vectors
from brink.server.problems.catalogue import PROBLEMS
from brink.sim import catalogue
from brink.sim.catalogue import register
from brink.sim.episode import EpisodeSpec, Json
from brink.worker.wire import Completed, WireVerdict

SIMULATOR = "faulty@1"
REQUIREMENT = "distance@1"


@dataclass(frozen=True, slots=True, kw_only=True)
class BallParams:
    """Parameters of the ball."""

    limit: float = setting(1.0, help="Radius of the unsafe ball.", gt=0.0, le=4.0, unit="m")
    fault: str = setting("none", help="What goes wrong east of `fault_from`.")
    fault_from: float = setting(
        2.0, help="East of here the simulator breaks down.", ge=-2.0, le=2.0, unit="m"
    )
    once_in: str = setting("", help="Folder that remembers faults: each episode then fails once alone.")
    slow_s: float = setting(0.0, help="How long an episode takes.", ge=0.0, le=10.0, unit="s")
    timeout_s: float = setting(20.0, help="Wall-clock limit of an episode.", gt=0.0, le=100.0, unit="s")
    needs: str = setting(SIMULATOR, help="Simulator.", choices=(SIMULATOR, "nobody-has-it@1"))

    def __post_init__(self) -> None:
        check_settings(self)


class Ball(SimulatedProblem):
    """Unsafe inside a ball around the origin."""

    id: ClassVar[str] = "ball@1"
    summary: ClassVar[str] = "A ball in the plane."
    params_type: ClassVar[type[Any]] = BallParams

    def __init__(self, params: BallParams) -> None:
        self.params = params
        self.space = SearchSpace(
            (
                Component("where", (Real("x", -2.0, 2.0, "m"),)),
                Component("what", (Real("y", -2.0, 2.0, "m"),)),
            )
        )
        self.algorithm_defaults = {"radius": 0.2}
        self.needs = params.needs
        self.timeout_s = params.timeout_s

    def episode(self, vectors: Vectors, seed: int) -> EpisodeSpec:
        """Return the episode at a point."""
        x, y = float(vectors[0][0]), float(vectors[1][0])
        scenario: dict[str, Json] = {"x": x, "limit": self.params.limit}
        if x > self.params.fault_from:
            scenario["fault"] = self.params.fault
            if self.params.once_in:
                scenario["once"] = f"{self.params.once_in}/{seed}"
        elif self.params.slow_s:
            scenario |= {"fault": "wait", "slow_s": self.params.slow_s}
        return EpisodeSpec(
            simulator=self.params.needs,
            scenario=scenario,
            behaviour={"y": y},
            requirements=(REQUIREMENT,),
            seed=seed,
            duration_s=1.0,
        )

    def evaluation(self, outcome: Completed) -> Evaluation:
        """Return the verdict at a point."""
        robustness = outcome.verdicts[REQUIREMENT].robustness
        return Scored(unsafe=robustness < 0, robustness=robustness, objectives=outcome.objectives)


def simulated(spec: Mapping[str, Any]) -> Completed:
    """Return what ``faulty@1`` makes of an episode of the ball, without a simulator."""
    distance = math.hypot(spec["behaviour"]["y"], spec["scenario"]["x"])
    robustness = distance - spec["scenario"]["limit"]
    return Completed(
        verdicts={REQUIREMENT: WireVerdict(robustness=robustness, unit="m", violated_at_s=None)},
        objectives={"distance": distance},
    )


class Line(InProcessProblem):
    """Unsafe on the left half of a line: a space of one component."""

    id: ClassVar[str] = "line@1"
    summary: ClassVar[str] = "A line."
    params_type: ClassVar[type[Any]] = NoParams

    def __init__(self, params: NoParams) -> None:
        self.space = SearchSpace((Component("where", (Real("x", 0.0, 1.0),)),))

    def evaluate(self, vectors: Vectors) -> Evaluation:
        """Return the verdict at a point."""
        x = float(vectors[0][0])
        return Scored(unsafe=x < 0.5, robustness=x - 0.5)


class SlottedBlind(SimulatedProblem):
    """Two perturbations in order: strong ones that come first are unsafe."""

    id: ClassVar[str] = "slotted-blind@1"
    summary: ClassVar[str] = "Two perturbations in order, without data."
    params_type: ClassVar[type[Any]] = NoParams

    def __init__(self, params: NoParams) -> None:
        self.space = example_spaces()["slots"]
        self.needs = SIMULATOR
        self.timeout_s = 20.0

    def episode(self, vectors: Vectors, seed: int) -> EpisodeSpec:
        """Return the episode of a scenario and its perturbations."""
        decoded = self.space.decode(tuple(vectors))
        return EpisodeSpec(
            simulator=SIMULATOR,
            scenario={"gap": float(decoded["scenario"]["gap"]) / 60.0, "limit": 1.2},
            behaviour={"strong": decoded["perturbation"]["intensity_1"]},
            requirements=(REQUIREMENT,),
            seed=seed,
            duration_s=1.0,
        )

    def evaluation(self, outcome: Completed) -> Evaluation:
        """Return the verdict."""
        robustness = outcome.verdicts[REQUIREMENT].robustness
        return Scored(unsafe=robustness < 0, robustness=robustness, objectives=outcome.objectives)


class Slotted(SlottedBlind):
    """The same, which can be measured on data, too."""

    id: ClassVar[str] = "slotted@1"
    summary: ClassVar[str] = "Two perturbations in order."
    dataset_needs = SIMULATOR
    dataset_timeout_s = 20.0

    def dataset_evaluation(self, vectors: Vectors) -> EpisodeSpec:
        """Return what measures the perturbations: they alone decide it, whatever the seed."""
        first, strong, second, weak = (float(value) for value in vectors[1])
        return EpisodeSpec(
            simulator=SIMULATOR,
            scenario={},
            behaviour={"first": first, "strong": strong, "weak": weak},
            requirements=(),
            seed=0,
            duration_s=1.0,
            options={"second": second},
        )

    def measurement(self, outcome: Completed) -> Measured:
        """Return alpha."""
        return Measured(objectives={"alpha": 1.0 / (1.0 + outcome.objectives["distance"])})


PLUGINS: dict[str, type[Any]] = {
    Ball.id: Ball,
    Line.id: Line,
    Slotted.id: Slotted,
    SlottedBlind.id: SlottedBlind,
}


def register_all() -> None:
    """Register the problems, for processes that import this through ``BRINK_PLUGINS``."""
    for plugin_id, plugin in PLUGINS.items():
        register(PROBLEMS, plugin_id, plugin)


@contextmanager
def small_problems() -> Iterator[None]:
    """Have this process know the ball and the line until the end of the block."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(catalogue._registered, PROBLEMS, dict(PLUGINS))
        patch.setattr(
            result_check, "CHECK_S", 60.0
        )  # on a busy machine, a result must not be stored unchecked
        yield
