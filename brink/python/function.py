"""Searching the boundary of a user's Python function."""

import inspect
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from brink.api.follow_ups import OPEN
from brink.api.live import failures_of
from brink.python.campaign import Start, started
from brink.python.connection import environment_with
from brink.python.local import run_body
from brink.python.result import AsyncResult, CampaignUnfinished, Result, check_finished
from brink.python.synchronous import synchronous
from brink.search.errors import SpaceError
from brink.search.shorthand import DeclaredSpace, space_of
from brink.search.space import SearchSpace
from brink.server.api.schemas import Progress
from brink.server.campaigns.body import parse_body
from brink.server.campaigns.plan import check_submission
from brink.server.errors import InvalidInput
from brink.server.problems.catalogue import make_algorithm
from brink.server.problems.function import Function
from brink.server.states import CampaignStatus
from brink.sim.adapters import function as simulator


async def search_async(
    function: Callable[..., float | Mapping[str, float]],
    space: DeclaredSpace,
    *,
    constraints: Sequence[str] = (),
    algorithm: str = "edge@2",
    simulations: int = 500,
    params: Mapping[str, Any] | None = None,
    seed: int = 1,
    name: str | None = None,
    workers: int = 2,
    timeout_s: float = 60.0,
    start_from: Start = None,
    database: str | None = None,
    resume: bool = True,
    progress: bool = True,
) -> AsyncResult:
    """Find where your own function changes its sign: the boundary between safe and unsafe.

    The function is called in worker processes, and every result is stored. Ctrl-C, or cancelling the task,
    pauses the search, and the same call continues it, as long as the function is the same.

    Args:
        function: Called with the values of the parameters by name. It returns a number, negative if the requirement
            is violated, in whatever unit; or a mapping with that number as ``robustness`` and objectives to minimise.
            If it depends on chance, give it an argument ``seed`` and draw from a generator with that seed.
        space: Its parameters by name, such as ``{"speed": (5.0, 30.0, "m/s"), "lanes": range(2, 5), "road": ["dry",
            "wet"]}``, or such mappings by component; ``mlcshe@1`` needs two components. Steps, log scales and more:
            docs/reference/search-space.md.
        constraints: Conditions that every call meets, such as ``distance > 2 * speed / 3.6``.
        algorithm: Id of the algorithm.
        simulations: Number of calls.
        params: Parameters of the algorithm that differ from their defaults.
        seed: Seed of the search.
        name: Name of the campaign; by default that of the function.
        workers: Number of worker processes.
        timeout_s: Wall-clock limit of a call.
        start_from: Prior knowledge: an earlier search, its result or id, or a data frame with a column for each
            parameter and one for ``robustness``.
        database: URL of the database, or the path of a SQLite file; by default ``BRINK_DATABASE``, else ``brink.db``.
        resume: Whether to continue an unfinished search with the same function and settings.
        progress: Whether to show the progress.

    Raises:
        SpaceError: A parameter is not written as expected, or is not an argument of the function.
        InvalidInput: Another setting is invalid.
        CampaignUnfinished: More than a fifth of the calls failed, or all of the first five; the message says how
            many, and why the first one did.

    Example:
        >>> import brink
        >>> def gap(speed, distance):
        ...     return distance - speed**2 / (2 * 8.0)
        >>> space = {"speed": (0.0, 40.0, "m/s"), "distance": (0.0, 100.0, "m")}
        >>> result = brink.search(gap, space, simulations=100, progress=False)
        >>> result.evaluated
        100
    """
    declared = space_of(space, constraints)
    check_call(function, declared)
    digest = simulator.digest_of(function)
    with environment_with(function) as environment:
        title = name or getattr(function, "__name__", type(function).__name__)
        document: dict[str, Any] = {
            "name": title,
            "problem": {
                "id": Function.id,
                "params": {
                    "function": title,
                    "digest": digest,
                    "space": declared.describe(),
                    "timeout_s": timeout_s,
                    "takes_seed": simulator.takes_seed(function),
                },
            },
            "algorithm": {"id": algorithm, "params": {**_defaults(function, algorithm), **(params or {})}},
            "budget": {"simulations": simulations},
            "seed": seed,
            # What the function calls elsewhere may have changed since an earlier search.
            "execution": {"cache": False, "keep_traces": 0},
        }
        body = started(parse_body(document), start_from)
        check_submission(body)
        result = await run_body(
            body,
            workers=workers,
            database=database,
            statuses=OPEN if resume else (),
            progress=progress,
            environment=environment,
            check=_check_calls,
        )
    result.function = function
    return result


search = synchronous(search_async, Result)


def _check_calls(progress: Progress) -> None:
    """Check that a search has finished.

    Raises:
        CampaignUnfinished: It was cancelled, or paused by a user or after too many failed calls, or all calls failed.
    """
    failed = failures_of(progress)
    given_up = {CampaignStatus.PAUSED: "was paused", CampaignStatus.FAILED: "has no result"}
    if progress.status not in given_up or not progress.status_reason or not failed:
        check_finished(progress)
        return
    first = (progress.failure or progress.status_reason).removeprefix("invalid: ")
    raise CampaignUnfinished(
        f"{progress.name}: {failed:,} of {progress.simulations:,} calls failed, so the search "
        f"{given_up[progress.status]}. The first: "
        f"{first}. Correct the function and call brink.search() again. A failed call is neither safe nor unsafe: "
        "where the function has no result, leave such values out by constraints, or "
        f"return what counts as safe or unsafe there. (campaign {progress.id})"
    )


def _defaults(function: Callable[..., Any], algorithm: str) -> dict[str, Any]:
    """Return algorithm settings that suit a deterministic function, whose boundary is sharp."""
    if simulator.takes_seed(function):
        return {}
    return dict(getattr(make_algorithm(algorithm), "without_chance", {}))


def check_call(function: Callable[..., Any], space: SearchSpace) -> None:
    """Check that a function can be called with the parameters of a space.

    Raises:
        SpaceError: Two parameters have the same name, or the function lacks an argument or has one too many.
        InvalidInput: It cannot be called.
    """
    if not callable(function):
        raise InvalidInput.at("function", f"expected something that can be called, got {function!r}")
    names = [one.name for component in space.components for one in component.parameters]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise SpaceError(f"{twice[0]}: expected different names, as they are arguments of the function")
    try:
        signature = inspect.signature(function)
    except ValueError:
        return  # some built-in functions have none
    given = dict.fromkeys(names)
    if simulator.takes_seed(function):
        given.setdefault(simulator.SEED)
    at_times = {one.name for component in space.components for one in component.parameters if one.when}
    try:
        signature.bind(**given)
        signature.bind(**{name: one for name, one in given.items() if name not in at_times})
    except TypeError as error:
        shown = getattr(function, "__name__", "the function")
        raise SpaceError(
            f"expected {shown}{signature} to take the parameters {', '.join(names)}: {error}"
        ) from None
