"""Threads that check submissions; checks that run user code have threads of their own."""

import asyncio
import logging
from collections.abc import Callable, Collection
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Final, TypeAlias, TypeVar

from brink.server.errors import InvalidInput, ServerError
from brink.server.problems.base import BaseProblem
from brink.server.problems.catalogue import problem_type, uses_user_code
from brink.server.user_code import AT_ONCE, USER_CODE

SLOW_AT_ONCE: Final = 2
"""Maximum number of submissions checked, and of pictures drawn, at the same time."""
PLUGIN_CHECKS_AT_ONCE: Final = 8
"""Maximum number of submissions checked at the same time that run code which a user brought. They mostly wait."""

T = TypeVar("T")
Choice: TypeAlias = tuple[str, str]
"""Ids of a problem and an algorithm."""

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class CheckThreads:
    """Threads for checks of submissions, which may load a neural network."""

    _own: ThreadPoolExecutor = field(
        default_factory=lambda: ThreadPoolExecutor(SLOW_AT_ONCE, thread_name_prefix="brink-check")
    )
    _beside: ThreadPoolExecutor = field(
        default_factory=lambda: ThreadPoolExecutor(
            PLUGIN_CHECKS_AT_ONCE, thread_name_prefix="brink-plugin-check"
        )
    )

    async def run(self, choices: Collection[Choice], check: Callable[[], T]) -> T:
        """Run a check in a thread and return its result.

        Args:
            choices: What is checked.
            check: Does it.

        Raises:
            CodeStalled: Code of users did not return in time, or is busy with other submissions.
            InvalidInput: The check says so, or such code raised an error.
        """
        loop = asyncio.get_running_loop()
        brought = await loop.run_in_executor(None, _with_user_code, choices)
        if not brought:
            return await loop.run_in_executor(self._own, check)

        def check_beside() -> T:
            names = ", ".join(sorted({name for choice in brought for name in choice}))
            try:
                with USER_CODE.on_behalf(f"submission: {names}", at_once=AT_ONCE):
                    return check()
            except ServerError:
                raise
            except Exception as error:
                log.exception("plug-in fails", extra={"plugins": names})
                message = f"a plug-in of {' and '.join(brought[0])} fails: {type(error).__name__}: {error}"
                raise InvalidInput.at("/problem/id", message) from error

        return await loop.run_in_executor(self._beside, check_beside)

    def close(self) -> None:
        """Finish the running checks, and start no more."""
        for threads in (self._own, self._beside):
            threads.shutdown(wait=True, cancel_futures=True)


def _with_user_code(choices: Collection[Choice]) -> list[Choice]:
    """Return the choices that run user code, or load what their parameters name."""
    return [
        (problem, algorithm)
        for problem, algorithm in choices
        if uses_user_code(problem, algorithm)
        or problem_type(problem).wrong_inputs is not BaseProblem.wrong_inputs
    ]
