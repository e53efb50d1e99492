"""The problem `function@1`: a user's Python function, with its search space and verdicts.

The coordinator knows its space, not its code: the workers that `brink.search` starts have the function, and announce
its digest as their capability. So no other worker is ever asked to run it.
"""

from dataclasses import dataclass, field
from typing import Any, ClassVar, Final

from brink.search.errors import ConfigError, SpaceError
from brink.search.parameters import Real
from brink.search.settings import check_settings, setting
from brink.search.shorthand import space_from
from brink.search.space import Component, SearchSpace
from brink.server.problems.plain_values import PlainValues
from brink.sim.adapters.function import FUNCTION, simulator_of

_EXAMPLE: Final = SearchSpace((Component("parameters", (Real("x", 0.0, 1.0),)),))


@dataclass(frozen=True, slots=True, kw_only=True)
class FunctionParams:
    """Parameters of the problem; `brink.search` fills them in."""

    function: str = setting("", help="Name of the function; brink.search() submits it from Python.")
    digest: str = setting("", help="SHA-256 of its code.")
    takes_seed: bool = setting(False, help="Whether it depends on chance: it then takes a seed.")
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


class Function(PlainValues):
    """A user's function that returns how far it is from a violation."""

    id: ClassVar[str] = "function@1"
    summary: ClassVar[str] = "A Python function of your own, submitted by brink.search()."
    params_type: ClassVar[type[Any]] = FunctionParams
    python_only = True
    records_traces = False
    requirements = (FUNCTION,)

    def __init__(self, params: FunctionParams) -> None:
        self.params = params
        self.space = space_from(params.space)
        self.needs = simulator_of(params.digest)
        self.timeout_s = self.duration_s = params.timeout_s
        self.ignores_seeds = not params.takes_seed

    def wrong_inputs(self) -> list[tuple[str, str]]:
        """Return an error if the campaign was not submitted from Python, as its function is then missing."""
        if self.params.digest:
            return []
        return [("function", "expected a function: call brink.search(function, space) in Python")]
