"""Synchronous forms of asynchronous functions and methods, derived from them: same signature, same docstring.

The docstring of an asynchronous function describes both forms.
"""

import functools
import inspect
from collections.abc import Awaitable, Callable, Coroutine
from typing import Any, Concatenate, Generic, ParamSpec, TypeVar, overload

from anyio.from_thread import start_blocking_portal

A = TypeVar("A")
P = ParamSpec("P")
R = TypeVar("R")
T = TypeVar("T")


def wait_for(work: Callable[[], Awaitable[T]]) -> T:
    """Run asynchronous work to its end, and return its result.

    It runs in an event loop on a thread of its own, because a notebook has one running already. Ctrl-C cancels it.

    Args:
        work: Called without arguments on that thread.
    """
    with start_blocking_portal() as portal:
        future = portal.start_task_soon(work)
        try:
            return future.result()
        except KeyboardInterrupt:
            future.cancel()
            raise


class Synchronous(Generic[A]):
    """Base of the synchronous form of a class, whose methods are made with `synchronous_method`."""

    def __init__(self, asynchronous: A) -> None:
        self._async = asynchronous

    def __repr__(self) -> str:
        return repr(self._async)


@overload
def synchronous(work: Callable[P, Coroutine[Any, Any, R]]) -> Callable[P, R]: ...
@overload
def synchronous(work: Callable[P, Coroutine[Any, Any, R]], form: Callable[[R], T]) -> Callable[P, T]: ...
def synchronous(work: Callable[..., Any], form: Callable[[Any], Any] | None = None) -> Callable[..., Any]:
    """Return the synchronous form of an asynchronous function.

    Args:
        work: The function; its name ends in ``_async``.
        form: Returns the synchronous form of its result; None if the result has no methods to await.
    """

    def call(*arguments: Any, **options: Any) -> Any:
        result = wait_for(functools.partial(work, *arguments, **options))
        return result if form is None else form(result)

    return _described(call, work, form)


@overload
def synchronous_method(
    work: Callable[Concatenate[Any, P], Coroutine[Any, Any, R]],
) -> Callable[Concatenate[Any, P], R]: ...
@overload
def synchronous_method(
    work: Callable[Concatenate[Any, P], Coroutine[Any, Any, R]], form: Callable[[R], T]
) -> Callable[Concatenate[Any, P], T]: ...
def synchronous_method(
    work: Callable[..., Any], form: Callable[[Any], Any] | None = None
) -> Callable[..., Any]:
    """Return the synchronous form of an asynchronous method, for a class derived from `Synchronous`.

    Args:
        work: The method.
        form: As for `synchronous`.
    """
    of_any = synchronous(work) if form is None else synchronous(work, form)

    def call(self: Synchronous[Any], *arguments: Any, **options: Any) -> Any:
        return of_any(self._async, *arguments, **options)

    return _described(call, work, form)


def _described(
    call: Callable[..., Any], work: Callable[..., Any], form: Callable[[Any], Any] | None
) -> Callable[..., Any]:
    """Return a function with the name, signature and docstring of an asynchronous one."""
    functools.update_wrapper(call, work)
    call.__name__ = work.__name__.removesuffix("_async")
    call.__qualname__ = work.__qualname__.removeprefix("Async").removesuffix("_async")
    signature = inspect.signature(work)
    if form is not None:
        returned = form if isinstance(form, type) else inspect.signature(form).return_annotation
        signature = signature.replace(return_annotation=returned)
    call.__signature__ = signature  # type: ignore[attr-defined]
    return call
