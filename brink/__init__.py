"""Find where a driving system with a machine-learned component stops being safe.

`run` runs a campaign on this machine, `connect` reaches a coordinator, `search` takes a function of your own, and
`Study` a loop of your own. Everything is imported when it is first used.
"""

from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

__version__ = "1.0.0"

if TYPE_CHECKING:
    from brink.python.campaign import Campaign as Campaign
    from brink.python.client import AsyncClient as AsyncClient
    from brink.python.client import Client as Client
    from brink.python.client import connect as connect
    from brink.python.client import connect_async as connect_async
    from brink.python.function import search as search
    from brink.python.function import search_async as search_async
    from brink.python.local import run as run
    from brink.python.local import run_async as run_async
    from brink.python.result import AsyncResult as AsyncResult
    from brink.python.result import Result as Result
    from brink.python.study import Study as Study
    from brink.python.study import Trial as Trial
    from brink.python.suite import Suite as Suite
    from brink.search.parameters import Categorical as Categorical
    from brink.search.parameters import Integer as Integer
    from brink.search.parameters import Real as Real

_HOMES = {
    "Campaign": "python.campaign",
    "AsyncClient": "python.client",
    "Client": "python.client",
    "connect": "python.client",
    "connect_async": "python.client",
    "search_async": "python.function",
    "run": "python.local",
    "run_async": "python.local",
    "AsyncResult": "python.result",
    "Result": "python.result",
    "Study": "python.study",
    "Trial": "python.study",
    "Suite": "python.suite",
    "Categorical": "search.parameters",
    "Integer": "search.parameters",
    "Real": "search.parameters",
}
"""Module of each public name, without that of `search`."""

__all__ = sorted([*_HOMES, "search"])


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'brink' has no attribute {name!r}")
    return getattr(import_module(f"brink.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return [*globals(), *__all__]


class _Search(ModuleType):
    """The package `brink.search`, which can also be called: ``brink.search(function, space)``."""

    def __call__(self, *arguments: Any, **options: Any) -> Any:
        return import_module("brink.python.function").search(*arguments, **options)


# The package of the algorithms and the function that searches have the same name: docs/adr/0044.
import_module("brink.search").__class__ = _Search
