"""The problem `function@1`: the search space and the verdicts of a function that somebody wrote in Python.

The coordinator knows its space, not its code: the workers that `brink.search` starts have the function, and announce
its digest as their capability. So no other worker is ever asked to run it.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Final

from brink.search.algorithm import Evaluation, Scored
from brink.search.errors import ConfigError, SpaceError
from brink.search.parameters import Categorical, Real
from brink.search.settings import check_settings, setting
from brink.search.shorthand import flat_values, space_from
from brink.search.space import Component, SearchSpace
from brink.server.problems.base import SimulatedSolution, Vectors
from brink.server.problems.changes import different
from brink.sim.adapters.function import FUNCTION, simulator_of
from brink.sim.episode import EpisodeSpec
from brink.worker.wire import Completed

_EXAMPLE: Final = SearchSpace((Component("parameters", (Real("x", 0.0, 1.0),)),))


@dataclass(frozen=True, slots=True, kw_only=True)
class FunctionParams:
    """Parameters of the problem; `brink.search` fills them in."""

    function: str = setting("", help="Name of the function; brink.search() submits it from Python.")
    digest: str = setting("", help="SHA-256 of its code.")
    takes_seed: bool = setting(False, help="Whether chance has a part in it: it then takes a seed.")
    space: dict[str, Any] = field(
        default_factory=_EXAMPLE.describe,
        metadata={"help": "Its search space, as brink.search() describes it."},
    )
    timeout_s: float = setting(60.0, help="Wall-clock limit of a call.", gt=0.0, le=86_400.0, unit="s")

    def __post_init__(self) -> None:
        check_settings(self)
        try:
            space_from(self.space)
        except SpaceError as error:
            raise ConfigError("space", str(error)) from None


class Function:
    """A function of one's own that returns how far it is from a violation."""

    id: ClassVar[str] = "function@1"
    summary: ClassVar[str] = "A Python function of your own, submitted by brink.search()."
    params_type: ClassVar[type[Any]] = FunctionParams
    python_only: ClassVar[bool] = True

    def __init__(self, params: FunctionParams) -> None:
        self.params = params
        self.space = space_from(params.space)
        self.algorithm_defaults: Mapping[str, Any] = {}
        self.needs = simulator_of(params.digest)
        self.timeout_s = params.timeout_s
        self.requirements = (FUNCTION,)
        self.ignores_seeds = not params.takes_seed
        self.records_traces = False

    def wrong_inputs(self) -> list[tuple[str, str]]:
        """Return that the function is missing, if the campaign was not submitted from Python."""
        if self.params.digest:
            return []
        return [("function", "expected a function: call brink.search(function, space) in Python")]

    def words(self, vectors: Vectors) -> str:
        """Return the values of a candidate."""
        values = flat_values(self.space.decode(tuple(vectors)))
        return ", ".join(
            f"{name} {value:.4g}{self._unit(name)}" if isinstance(value, float) else f"{name} {value}"
            for name, value in values.items()
        )

    def words_of_change(
        self, safe: SimulatedSolution, unsafe: SimulatedSolution, changed: Collection[str]
    ) -> str:
        """Return the values that differ, the unsafe one last."""
        words = []
        sides = [flat_values(self.space.decode(tuple(side.vectors))) for side in (safe, unsafe)]
        for name in sides[0]:
            if any(one.rpartition(".")[2] == name for one in changed):
                old, new = different(sides[0][name], sides[1][name])
                words.append(f"{name} {new}{self._unit(name)} instead of {old}{self._unit(name)}")
        return ", ".join(words)

    def _unit(self, name: str) -> str:
        for component in self.space.components:
            for one in component.parameters:
                if one.name == name and not isinstance(one, Categorical) and one.unit:
                    return f" {one.unit}"
        return ""

    def episode(self, vectors: Vectors, seed: int) -> EpisodeSpec:
        """Return the call that evaluates a candidate."""
        values = self.space.decode(tuple(vectors))
        return EpisodeSpec(
            simulator=self.needs,
            scenario={name: dict(part) for name, part in values.items()},
            behaviour={},
            requirements=(FUNCTION,),
            seed=seed,
            duration_s=self.timeout_s,
        )

    def evaluation(self, outcome: Completed) -> Evaluation:
        """Return the verdict that the function gave."""
        verdict = outcome.verdicts[FUNCTION]
        return Scored(
            unsafe=verdict.robustness < 0, robustness=verdict.robustness, objectives=outcome.objectives
        )
