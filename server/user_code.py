"""Calls user code, on threads of its own and for a limited time.

Such code may sleep, hang or compute without end. While a coordinator serves, each call of it runs on a daemon thread,
and its caller waits no longer than its time limit. A call that takes longer is abandoned: the caller gets
`CodeStalled`. After the coordinator's time limit, an exception is raised in the thread again and again, which ends a
loop in Python; but never in an import, which would leave modules half loaded. Until the call has ended, it counts as
stalled. Few calls may be stalled for one caller: after that, its calls are refused at once.
So code that hangs costs a few idle threads and nothing else. The end of the process waits for none of them.

`guarded` makes all methods of a plug-in such calls, so that whoever calls them needs to know nothing of this. Brink's
own plug-ins are called directly: they have no time limit, since a slow machine must not stop a healthy campaign.

The calls are those of the process, as plug-ins are. What this cannot stop is native code that keeps the interpreter's
lock: docs/adr/0063.
"""

import ctypes
import functools
import logging
import queue
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, InvalidStateError
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from types import FunctionType
from typing import Any, ClassVar, Final, ParamSpec, TypeVar, cast

from brink.server.errors import Unavailable

T = TypeVar("T")
P = ParamSpec("P")

DEFAULT_LIMIT_S: Final = 60.0
VIEW_LIMIT_S: Final = 3.0
"""Time limit for a caller that set none: a request that waits for an answer."""
VIEW_CONSTRUCTION_LIMIT_S: Final = 20.0
"""The same for an import and a construction, which may load a library or a network. They go on if nobody waits."""
IMPORT: Final = "import"
CONSTRUCTION: Final = "construction"
LOOP_LIMIT_S: Final = 0.25
"""Time limit on the thread of an event loop. User code does not belong there, and all requests wait for it."""
LINE_S: Final = 2.0
"""How long a request waits for calls of the same plug-in before it, which are expected to take milliseconds."""
AT_ONCE: Final = 2
"""Maximum number of calls of one plug-in for requests at a time, so that a slow one does not take all threads; if so
many are stalled, further ones are refused at once."""
MOST_STALLED: Final = 4
"""The same for other callers, such as the steps of one campaign."""
MOST_STALLED_IN_ALL: Final = 64
KEPT_THREADS: Final = 8
"""Maximum number of idle threads."""
_END_EVERY_S: Final = 5.0

log = logging.getLogger(__name__)


class CodeStalled(Unavailable):
    """User code did not return in time, or is refused because earlier calls have not returned."""


class CodeExited(Exception):
    """User code tried to end the process."""


class _Abandoned(BaseException):
    """Raised in the thread of a call that nobody waits for any more."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Caller:
    """The caller on whose behalf code is called.

    Attributes:
        name: Whom stalled calls are counted for: a campaign, or the plug-in for requests.
        limit_s: Time limit of each call.
        at_once: Maximum number of its calls at a time; None if its calls need no limit.
    """

    name: str
    limit_s: float
    at_once: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class StalledCall:
    """A call that was abandoned.

    Attributes:
        caller: Name of its caller.
        what: What was called.
        since_s: Monotonic time of the call, in seconds.
        thread: Where it runs.
    """

    caller: str
    what: str
    since_s: float
    thread: threading.Thread


@dataclass(slots=True, eq=False)
class Serving:
    """A coordinator in this process, from its start to its end.

    Attributes:
        limit_s: Time limit of a call.
        loop_thread: Identifier of the thread of its event loop.
        patient: Whether its requests wait as long as that, because it serves a single command.
        stopping: Whether it is stopping: nobody waits for user code any more.
    """

    limit_s: float
    loop_thread: int
    patient: bool = False
    stopping: bool = False


class _Call:
    """One call, and its result for whoever waits.

    Attributes:
        answer: What it returned or raised, or why nobody waits any more.
        interruptible: Whether an exception may be raised in its thread.
        began_s: Monotonic time of its beginning, in seconds.
    """

    def __init__(self, function: Callable[[], Any], *, interruptible: bool) -> None:
        self._function = function
        self.interruptible = interruptible
        self.answer: Future[Any] = Future()
        self.began_s = time.monotonic()

    def wait(self, limit_s: float) -> Any:
        """Wait for the answer and return it.

        Raises:
            TimeoutError: It took longer than the limit.
            Exception: What the function raised.
        """
        return self.answer.result(limit_s)

    def run(self) -> None:
        """Call the function, even if nobody waits for its result any more."""
        with suppress(InvalidStateError):
            try:
                result = self._function()
            except _Abandoned:
                raise
            except Exception as error:  # noqa: BLE001  (passed on to the caller)
                self.answer.set_exception(error)
            except BaseException as error:  # noqa: BLE001  (sys.exit() in a plug-in must not end this thread alone)
                self.answer.set_exception(CodeExited(f"it raised {type(error).__name__}: {error}"))
            else:
                self.answer.set_result(result)


class _CallThread(threading.Thread):
    """Runs calls, one at a time, until one is abandoned."""

    def __init__(self, calls: "UserCode") -> None:
        super().__init__(name="brink-user-code", daemon=True)
        self._calls = calls
        self.inbox: queue.SimpleQueue[_Call] = queue.SimpleQueue()
        self.abandoned = False

    def run(self) -> None:
        with suppress(_Abandoned):
            while True:
                self.inbox.get().run()
                if not self._calls.keep(self):
                    return


@dataclass(slots=True)
class UserCode:
    """The calls of user code in this process."""

    _lock: threading.Lock = field(default_factory=threading.Lock)
    _caller: threading.local = field(default_factory=threading.local)
    _serving: list[Serving] = field(default_factory=list)
    _idle: list[_CallThread] = field(default_factory=list)
    _waiting: dict[_Call, _CallThread] = field(default_factory=dict)
    _stalled: list[StalledCall] = field(default_factory=list)
    _lines: dict[str, threading.BoundedSemaphore] = field(default_factory=dict)
    timeouts: int = 0

    def begin(self, limit_s: float, *, patient: bool = False) -> Serving:
        """Limit calls from now on, because a coordinator serves; called on the thread of its event loop.

        Args:
            limit_s: Time limit of a call.
            patient: Whether its requests wait as long as that.
        """
        serving = Serving(limit_s=limit_s, loop_thread=threading.get_ident(), patient=patient)
        with self._lock:
            self._serving.append(serving)
        return serving

    def stop(self, serving: Serving) -> None:
        """Stop waiting for user code, because a coordinator is stopping."""
        with self._lock:
            serving.stopping = True
            waiting = list(self._waiting.items())
        for call, thread in waiting:
            self._abandon(call, thread, Unavailable("the coordinator is stopping"), 0.0)

    def end(self, serving: Serving) -> None:
        """Forget a coordinator that has stopped."""
        with self._lock:
            self._serving.remove(serving)

    @contextmanager
    def on_behalf(self, name: str, *, at_once: int | None = None) -> Iterator[None]:
        """Limit the calls of this thread by the coordinator's time limit, until the end of the block.

        Args:
            name: Whom stalled calls are counted for.
            at_once: Maximum number of calls with this name at a time; None for no limit.
        """
        before = getattr(self._caller, "value", None)
        self._caller.value = Caller(name=name, limit_s=self.limit_s, at_once=at_once)
        try:
            yield
        finally:
            self._caller.value = before

    @property
    def limit_s(self) -> float:
        """The time limit of a call."""
        with self._lock:
            return self._serving[-1].limit_s if self._serving else DEFAULT_LIMIT_S

    def call(self, plugin: str, what: str, function: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        """Call user code and return its result.

        Args:
            plugin: Id of the plug-in.
            what: What is called, for messages, such as ``evaluation``.
            function: The code; it may call this method again.
            args: Its arguments.
            kwargs: Its keyword arguments.

        Raises:
            CodeStalled: It did not return in time, or earlier calls have not returned.
            Unavailable: The coordinator is stopping.
            Exception: What it raised.
        """
        if not self._serving or isinstance(threading.current_thread(), _CallThread):
            return function(*args, **kwargs)
        caller = self._caller_of(plugin, what)
        with self._line(caller, plugin):
            self._check_stalled(caller, plugin)
            call = _Call(functools.partial(function, *args, **kwargs), interruptible=what != IMPORT)
            thread = self._start(call)
            try:
                return cast(T, call.wait(caller.limit_s))
            except TimeoutError:
                error = CodeStalled(f"{what} of {plugin} did not return within {caller.limit_s:g} s")
                if self._abandon(call, thread, error, self.limit_s - caller.limit_s):
                    self._note_stalled(
                        StalledCall(
                            caller=caller.name,
                            what=f"{what} of {plugin}",
                            since_s=call.began_s,
                            thread=thread,
                        )
                    )
                return cast(T, call.answer.result())  # raises it, or what the code raised at the last moment
            finally:
                with self._lock:
                    self._waiting.pop(call, None)

    def stalled(self, caller: str | None = None) -> list[StalledCall]:
        """Return the calls that were abandoned and have not ended: all, or those of one caller."""
        with self._lock:
            self._stalled = [one for one in self._stalled if one.thread.is_alive()]
            return [one for one in self._stalled if caller in (None, one.caller)]

    @property
    def is_full(self) -> bool:
        """Whether too many calls are stalled to make another one."""
        return len(self.stalled()) >= MOST_STALLED_IN_ALL

    def keep(self, thread: _CallThread) -> bool:
        """Return whether to keep a thread that has finished its call for another one."""
        with self._lock:
            if thread.abandoned or len(self._idle) >= KEPT_THREADS:
                return False
            self._idle.append(thread)
            return True

    def _caller_of(self, plugin: str, what: str) -> Caller:
        caller: Caller | None = getattr(self._caller, "value", None)
        if caller is not None:
            return caller
        here = threading.get_ident()
        if any(one.loop_thread == here for one in self._serving):
            return Caller(name=plugin, limit_s=min(LOOP_LIMIT_S, self.limit_s))
        limit_s = VIEW_CONSTRUCTION_LIMIT_S if what in (IMPORT, CONSTRUCTION) else VIEW_LIMIT_S
        if all(one.patient for one in self._serving):
            limit_s = self.limit_s
        return Caller(name=plugin, limit_s=min(limit_s, self.limit_s), at_once=AT_ONCE)

    @contextmanager
    def _line(self, caller: Caller, plugin: str) -> Iterator[None]:
        """Wait until the caller may call the plug-in.

        Raises:
            CodeStalled: Calls before it take too long.
        """
        if caller.at_once is None:
            yield
            return
        line = self._lines.setdefault(caller.name, threading.BoundedSemaphore(caller.at_once))
        if not line.acquire(timeout=LINE_S):
            raise CodeStalled(f"{plugin} is busy with earlier calls; try again soon", retry_after_s=2)
        try:
            yield
        finally:
            line.release()

    def _check_stalled(self, caller: Caller, plugin: str) -> None:
        if not self._stalled:
            return
        mine = self.stalled(caller.name)
        if len(mine) >= (caller.at_once or MOST_STALLED):
            raise CodeStalled(
                f"{plugin}: {len(mine)} earlier calls have not returned, the last of them {mine[-1].what}; correct "
                "the plug-in and restart the coordinator",
                retry_after_s=30,
            )
        if self.is_full:
            message = f"{MOST_STALLED_IN_ALL} calls of plug-ins have not returned; restart the coordinator"
            raise CodeStalled(message, retry_after_s=30)

    def _start(self, call: _Call) -> _CallThread:
        """Have a thread make a call.

        Raises:
            Unavailable: The coordinator is stopping.
        """
        with self._lock:
            if any(one.stopping for one in self._serving):
                raise Unavailable("the coordinator is stopping")
            thread = self._idle.pop() if self._idle else _CallThread(self)
            self._waiting[call] = thread
            if not thread.ident:
                thread.start()  # before anybody else sees the call: a thread that has not started cannot be joined
        thread.inbox.put(call)
        return thread

    def _abandon(self, call: _Call, thread: _CallThread, error: Exception, left_s: float) -> bool:
        """Resolve a call with an error, unless it has just returned; return whether it was abandoned.

        Args:
            call: The call.
            thread: Its thread.
            error: The error.
            left_s: How long it may still run before it is interrupted.
        """
        with self._lock:
            if call.answer.done():
                return False
            thread.abandoned = True
            with suppress(InvalidStateError):
                call.answer.set_exception(error)
        if call.interruptible:
            ending = threading.Thread(
                target=_end, args=(thread, left_s), name="brink-end-user-code", daemon=True
            )
            ending.start()
        return True

    def _note_stalled(self, call: StalledCall) -> None:
        with self._lock:
            self._stalled.append(call)
            self.timeouts += 1
        log.error(
            "%s does not return; nobody is waiting for it any more", call.what, extra={"caller": call.caller}
        )


def _end(thread: _CallThread, left_s: float) -> None:
    """Raise an exception in a thread until it has ended: a thread in a system call sees it only afterwards.

    Args:
        thread: The thread.
        left_s: How long it may still run.
    """
    began = time.monotonic()
    thread.join(left_s)
    while thread.is_alive() and thread.ident is not None:
        ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(thread.ident), ctypes.py_object(_Abandoned))
        thread.join(_END_EVERY_S)
    log.info("a call of user code has ended", extra={"after_s": round(time.monotonic() - began, 1)})


USER_CODE: Final = UserCode()
"""The calls of this process."""


def guarded(plugin: str, thing: T) -> T:
    """Wrap a plug-in's object so that its methods and properties become calls of user code; return it.

    It gets a subclass of its own class, so it is still an instance of every class and protocol that it was before.

    Args:
        plugin: Id of the plug-in.
        thing: The object.

    Raises:
        TypeError: Its class does not allow subclasses.
    """
    if not isinstance(thing, _Guarded):
        object.__setattr__(thing, "__class__", _guarded_class(cast(Any, type(thing)), plugin))
    return thing


def is_guarded(thing: object) -> bool:
    """Return whether an object is a plug-in's, wrapped by `guarded`."""
    return isinstance(thing, _Guarded)


def guarded_like(other: object, thing: T) -> T:
    """Guard an object that a guarded one returned and that belongs to the same plug-in; return it."""
    return guarded(other.guarded_by, thing) if isinstance(other, _Guarded) else thing


class _Guarded:
    """Marks the classes that `guarded` makes.

    Attributes:
        guarded_by: Id of the plug-in.
    """

    __slots__ = ()
    guarded_by: ClassVar[str]


@functools.lru_cache(maxsize=1024)
def _guarded_class(kind: type[Any], plugin: str) -> type[Any]:
    own = {
        name: made
        for name in dir(kind)
        if not name.startswith("_") and (made := _limited_attribute(kind, name, plugin)) is not None
    }
    about = {
        "__slots__": (),
        "__module__": kind.__module__,
        "__qualname__": kind.__qualname__,
        "__doc__": kind.__doc__,
    }
    metaclass: Any = type(kind)
    return cast(type[Any], metaclass(kind.__name__, (kind, _Guarded), {**about, **own}))


def _limited_attribute(kind: type[Any], name: str, plugin: str) -> Any:
    """Return the replacement for an attribute of a class; None if it is not code."""
    found = next(one.__dict__[name] for one in kind.__mro__ if name in one.__dict__)
    if isinstance(found, FunctionType):

        @functools.wraps(found)
        def limited(*args: Any, **kwargs: Any) -> Any:
            return _call(plugin, name, getattr(kind, name), *args, **kwargs)

        return limited
    if isinstance(found, staticmethod | classmethod):
        function = cast(FunctionType, found.__func__)
        return type(found)(functools.wraps(function)(functools.partial(_call, plugin, name, function)))
    if isinstance(found, property) and found.fget is not None:
        get = functools.partial(_call, plugin, name, found.fget)
        return property(get, found.fset, found.fdel, found.__doc__)
    if isinstance(found, functools.cached_property):
        return functools.cached_property(functools.partial(_call, plugin, name, found.func))
    return None


def _call(plugin: str, what: str, function: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
    return USER_CODE.call(plugin, what, function, *args, **kwargs)
