"""Signal temporal logic: parses a formula over recorded signals, and measures by how much a recording satisfies it.

A formula such as ``always[0:20] (gap > 1.5 or not braking)`` has comparisons of arithmetic on signals
(`brink.formula`), ``not``, ``and``, ``or``, ``implies`` (or ``->``), ``always``, ``eventually`` and ``until``. The
operators ``not``, ``always`` and ``eventually`` bind tightest, then ``until``, ``and``, ``or``, ``implies``.
Bounds are in seconds, ``[2:5]`` or ``[2:]``; without them, an operator looks ahead without limit.

Semantics: a signal keeps the value of each sample until the next one, and its last value from then on, however
unevenly it is sampled. Windows are closed, and a formula is evaluated at the first sample. The robustness of a
comparison is the difference of its sides, and never 0: where they are equal, it is `SMALLEST` in favour of the truth.
``==``, ``!=`` and a signal alone, which is true unless it is 0, are infinitely robust: they choose between the other
parts without adding a number of another unit.

References:
    Donzé and Maler 2010, Robust satisfaction of temporal logic over real-valued signals, definition 3.
    Donzé, Ferrère and Maler 2013, Efficient robust monitoring for STL, section 3 (until by the other operators).
"""

import math
import re
import sys
from bisect import bisect_left
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Final, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from brink.formula import Formula, FormulaError

FloatArray: TypeAlias = NDArray[np.float64]
TimeArray: TypeAlias = NDArray[np.int64]

SMALLEST: Final = 1e-9
"""Robustness of a comparison whose sides are equal."""
MOST_CHARACTERS: Final = 1_000
_MOST_LEVELS: Final = 30
_NS_PER_S: Final = 1e9
_LONGEST_S: Final = 1e8
"""Longest recording and bound, so that a time in nanoseconds fits into an integer."""

_TOKEN: Final = re.compile(
    r"""\s*(?:(?P<token>\d[\w.]*(?:(?<=[eE])[+-]\d+)? | \.\d+ | [^\W\d][\w.]* | `[^`]+` | "[^"]*" | '[^']*'
    | -> | \*\* | [<>=!]= | [-+*/%<>()\[\],:] ) | (?P<end>$) | (?P<other>.) )""",
    re.VERBOSE,
)
_UNARY: Final = ("always", "eventually", "not")
_BINARY: Final = ("and", "or", "until", "implies", "->")
_COMPARISONS: Final = ("<", ">", "<=", ">=", "==", "!=")
_NEEDS_LEFT: Final = (*_COMPARISONS, "*", "/", "%", "**", ",")
_ENDS: Final = (*_UNARY, *_BINARY, ")", "")


@dataclass(frozen=True, slots=True)
class _Atom:
    """A comparison, or a signal or number alone.

    Attributes:
        formula: The text between the operators of temporal logic.
        is_yes_or_no: Whether it is infinitely robust.
    """

    formula: Formula
    is_yes_or_no: bool


@dataclass(frozen=True, slots=True)
class _Not:
    part: "_Node"


@dataclass(frozen=True, slots=True)
class _Pair:
    """Two formulas that must both hold, or of which one must."""

    both: bool
    left: "_Node"
    right: "_Node"


@dataclass(frozen=True, slots=True)
class _Window:
    """A formula that must hold always, or eventually, from `begin_s` to `end_s` after the present."""

    always: bool
    begin_s: float
    end_s: float
    part: "_Node"


@dataclass(frozen=True, slots=True)
class _Until:
    """`right` must hold from `begin_s` to `end_s` after the present, and `left` until then."""

    begin_s: float
    end_s: float
    left: "_Node"
    right: "_Node"


_Node: TypeAlias = _Atom | _Not | _Pair | _Window | _Until


@dataclass(frozen=True, slots=True)
class _Steps:
    """A function of time that is constant from each of its times to the next, and from the last one on.

    Attributes:
        starts_ns: The times, increasing, shape ``(n,)``; the first one is the first sample's.
        values: Shape ``(n,)``.
    """

    starts_ns: TimeArray
    values: FloatArray

    def at(self, times_ns: TimeArray) -> FloatArray:
        """Return the values at times that are not before the first one."""
        return self.values[np.searchsorted(self.starts_ns, times_ns, side="right") - 1]


@dataclass(frozen=True, slots=True, kw_only=True)
class Satisfaction:
    """How a recording satisfies a formula.

    Attributes:
        robustness: By how much it does, negative if it does not; never 0, infinite if only yes or no decides.
        violated_at_s: Time of the earliest sample with which all that has been recorded decides that it does not,
            whatever follows; None if it does.
    """

    robustness: float
    violated_at_s: float | None


@dataclass(frozen=True, slots=True)
class Stl:
    """A parsed formula.

    Attributes:
        text: As it was written.
        names: The signals in it, in the order of their first appearance.
        begins_s: How long after the first sample a recording must last to be evaluated at all, without the end of any
            window.
    """

    text: str
    names: tuple[str, ...] = field(init=False, compare=False)
    begins_s: float = field(init=False, compare=False)
    _root: _Node = field(init=False, compare=False, repr=False)
    _texts: frozenset[str] = field(init=False, compare=False, repr=False)

    def __post_init__(self) -> None:
        parser = _Parser(self.text)
        root = parser.parse()
        object.__setattr__(self, "_root", root)
        object.__setattr__(self, "begins_s", _begins_s(root))
        names = dict.fromkeys(name for formula in parser.formulas for name in formula.names)
        object.__setattr__(self, "names", tuple(names))
        object.__setattr__(self, "_texts", frozenset().union(*(one.texts for one in parser.formulas)))

    def satisfaction(self, times_s: ArrayLike, signals: Mapping[str, ArrayLike]) -> Satisfaction:
        """Return how a recording satisfies the formula.

        Args:
            times_s: Times of the samples, increasing by at least a nanosecond, shape ``(n,)`` with n > 0.
            signals: Numbers, or truth values, of each signal at these times, shape ``(n,)`` each.

        Raises:
            FormulaError: A signal is missing, has another length or is not a number, or times do not increase.
        """
        recording = self._recording(times_s, signals)
        robustness = recording.robustness(self._root)
        violated_at_s = None
        if robustness < 0:
            counts = range(1, len(recording.times_ns) + 1)
            index = bisect_left(counts, True, key=lambda count: recording.highest(self._root, count) < 0)
            violated_at_s = float(np.asarray(times_s, np.float64)[index])
        return Satisfaction(robustness=robustness, violated_at_s=violated_at_s)

    def margins(self, times_s: ArrayLike, signals: Mapping[str, ArrayLike]) -> FloatArray:
        """Return the robustness over time, whose least value is that of the formula, shape ``(n,)``.

        It is that of the comparisons at each sample where these must hold always. Otherwise it is the greatest that
        the formula can have given the samples so far. Its first negative value is at the violation.

        Args:
            times_s: As for `satisfaction`.
            signals: As for `satisfaction`.

        Raises:
            FormulaError: As for `satisfaction`.
        """
        recording = self._recording(times_s, signals)
        recording.robustness(self._root)
        return recording.margins(self._root)

    def _recording(self, times_s: ArrayLike, signals: Mapping[str, ArrayLike]) -> "_Recording":
        times = np.asarray(times_s, np.float64)
        return _Recording(_checked_times_ns(times), self._values(times, signals))

    def _values(self, times: FloatArray, signals: Mapping[str, ArrayLike]) -> dict[str, NDArray[Any]]:
        values: dict[str, NDArray[Any]] = {}
        for name in self.names:
            if name not in signals:
                raise FormulaError(
                    f"{self.text!r}: no signal {name!r}; there are {', '.join(signals) or 'none'}"
                )
            try:
                values[name] = found = np.asarray(signals[name], None if name in self._texts else np.float64)
            except ValueError as error:
                raise FormulaError(f"signal {name!r}: expected numbers ({error})") from None
            if found.shape != times.shape:
                raise FormulaError(
                    f"signal {name!r}: expected shape {times.shape}, as the times, got {found.shape}"
                )
        return values


def _checked_times_ns(times: FloatArray) -> TimeArray:
    """Return the times from the first one on in nanoseconds, so that sums of times and bounds are exact."""
    if times.ndim != 1 or not len(times):
        raise FormulaError(f"times: expected at least one sample in one dimension, got shape {times.shape}")
    since = times - times[0]
    if not (np.isfinite(since).all() and since[-1] <= _LONGEST_S):
        raise FormulaError(f"times: expected finite seconds over at most {_LONGEST_S:g} s")
    times_ns: TimeArray = np.rint(since * _NS_PER_S).astype(np.int64)
    if (late := np.flatnonzero(np.diff(times_ns) <= 0)).size:
        raise FormulaError(
            f"times: expected increasing ones, got {times[late[0] + 1]:g} s after {times[late[0]]:g} s"
        )
    return times_ns


def _begins_s(node: _Node) -> float:
    match node:
        case _Atom():
            return 0.0
        case _Not():
            return _begins_s(node.part)
        case _Window():
            return node.begin_s + _begins_s(node.part)
        case _Pair():
            return max(_begins_s(node.left), _begins_s(node.right))
        case _Until():
            return max(_begins_s(node.left), node.begin_s + _begins_s(node.right))


def _is_momentary(node: _Node) -> bool:
    """Return whether a formula is about the present alone."""
    match node:
        case _Not():
            return _is_momentary(node.part)
        case _Pair():
            return _is_momentary(node.left) and _is_momentary(node.right)
    return isinstance(node, _Atom)


@dataclass(slots=True)
class _Recording:
    """Evaluates formulas on a recording.

    Attributes:
        times_ns: Times of the samples, shape ``(n,)``.
        signals: Values by name, shape ``(n,)`` each.
    """

    times_ns: TimeArray
    signals: Mapping[str, NDArray[Any]]
    _margins: dict[int, FloatArray] = field(default_factory=dict)
    _known: int = sys.maxsize

    def robustness(self, root: _Node) -> float:
        """Return the robustness of a formula at the first sample."""
        return float(self.steps_of(root).values[0])

    def highest(self, root: _Node, count: int) -> float:
        """Return the greatest robustness that a formula can have with the first `count` samples."""
        return replace(self, _known=count).robustness(root)

    def margins(self, root: _Node) -> FloatArray:
        """Return the robustness of a formula over time; see `Stl.margins`."""
        if isinstance(root, _Pair) and root.both:
            return np.minimum(self.margins(root.left), self.margins(root.right))
        if isinstance(root, _Window) and root.always and _is_momentary(root.part):
            part, times_s = self.steps_of(root.part), self.times_ns / _NS_PER_S
            # The sample before the window begins is in it, since it lasts until the next one.
            begin = np.searchsorted(times_s, root.begin_s, side="right") - 1
            inside = (np.arange(len(times_s)) >= begin) & (times_s <= root.end_s)
            return np.where(inside, part.values, math.inf)
        highest = np.empty(len(self.times_ns))
        self._fill(root, highest, (0, self.highest(root, 1)), (len(highest) - 1, self.robustness(root)))
        return highest

    def _fill(
        self, root: _Node, highest: FloatArray, first: tuple[int, float], last: tuple[int, float]
    ) -> None:
        """Fill in `highest` from one sample to another one, between which it never rises."""
        if first[1] == last[1] or last[0] - first[0] < 2:
            highest[first[0] : last[0]], highest[last[0]] = first[1], last[1]
            return
        index = (first[0] + last[0]) // 2
        middle = index, self.highest(root, index + 1)
        self._fill(root, highest, first, middle)
        self._fill(root, highest, middle, last)

    def steps_of(self, node: _Node, sign: float = 1.0) -> _Steps:
        """Return the robustness of a formula over time.

        Args:
            node: The formula.
            sign: -1 within an odd number of negations. What is not known is assumed to favour the whole formula.
        """
        match node:
            case _Atom():
                values = self._margin(node)
                if self._known < len(values):
                    values = np.append(values[: self._known], sign * math.inf)
                return _Steps(self.times_ns[: len(values)], values)
            case _Not():
                part = self.steps_of(node.part, -sign)
                return _Steps(part.starts_ns, -part.values)
            case _Pair():
                return _combined(node.both, self.steps_of(node.left, sign), self.steps_of(node.right, sign))
            case _Window():
                return _extreme(node.always, node.begin_s, node.end_s, self.steps_of(node.part, sign))
            case _Until():
                left, right = self.steps_of(node.left, sign), self.steps_of(node.right, sign)
                kept = _extreme(True, 0.0, node.begin_s, _until(left, right))
                return _combined(True, kept, _extreme(False, node.begin_s, node.end_s, right))

    def _margin(self, atom: _Atom) -> FloatArray:
        if id(atom) not in self._margins:
            self._margins[id(atom)] = self._new_margin(atom)
        return self._margins[id(atom)]

    def _new_margin(self, atom: _Atom) -> FloatArray:
        formula = atom.formula
        value = np.broadcast_to(formula.evaluate(self.signals), self.times_ns.shape)
        margin = formula.margin(self.signals) if formula.is_condition else value
        unknown = np.flatnonzero(np.isnan(np.broadcast_to(margin, value.shape)))
        if unknown.size:
            at_s = self.times_ns[unknown[0]] / _NS_PER_S
            raise FormulaError(
                f"{formula.text!r}: not a number {at_s:g} s after the first sample (a signal that is NaN, or 0 / 0)"
            )
        holds = value if formula.is_condition else value != 0
        if atom.is_yes_or_no:
            margin = np.where(holds, math.inf, -math.inf)
        robustness: FloatArray = np.where(holds, np.maximum(margin, SMALLEST), np.minimum(margin, -SMALLEST))
        return robustness


def _combined(both: bool, left: _Steps, right: _Steps) -> _Steps:
    """Return the smaller of two functions at each time, or the greater one."""
    if left.starts_ns is right.starts_ns:
        starts, pair = left.starts_ns, (left.values, right.values)
    else:
        starts = _merged(left.starts_ns, right.starts_ns)
        pair = (left.at(starts), right.at(starts))
    return _Steps(starts, (np.minimum if both else np.maximum)(*pair))


def _merged(left: TimeArray, right: TimeArray) -> TimeArray:
    """Return the times in either of two increasing arrays, each once."""
    both = np.sort(np.concatenate([left, right]), kind="stable")  # merges what is sorted already
    times: TimeArray = both[np.append(True, both[1:] > both[:-1])]
    return times


def _within(begin_ns: np.int64, times: TimeArray) -> TimeArray:
    """Return a time and all later ones of an increasing array."""
    return np.append(begin_ns, times[np.searchsorted(times, begin_ns, side="right") :])


def _extreme(least: bool, begin_s: float, end_s: float, steps: _Steps) -> _Steps:
    """Return the least, or greatest, value in the window from `begin_s` to `end_s` after each time."""
    if not end_s:
        return steps
    reduce = np.minimum if least else np.maximum
    begin_ns, starts = round(begin_s * _NS_PER_S), steps.starts_ns
    if end_s == math.inf:
        onward = _Steps(starts, reduce.accumulate(steps.values[::-1])[::-1])
        if not begin_ns:
            return onward
        times = _within(starts[0], starts - begin_ns)
        return _Steps(times, onward.at(times + begin_ns))
    end_ns = round(end_s * _NS_PER_S)
    times = _within(starts[0], _merged(starts - begin_ns, starts - end_ns))
    first = np.searchsorted(starts, times + begin_ns, side="right") - 1
    last = np.searchsorted(starts, times + end_ns, side="right") - 1
    # Any window is the union of two that may overlap, each as long as the greatest power of two within it.
    power = np.frexp(last - first + 1)[1] - 1
    values, extreme = steps.values, np.empty(len(times))
    for level in range(int(power.max()) + 1):
        its = power == level
        extreme[its] = reduce(values[first[its]], values[last[its] + 1 - (1 << level)])
        values = reduce(values[: -(1 << level) or None], values[1 << level :])
    return _Steps(times, extreme)


def _until(left: _Steps, right: _Steps) -> _Steps:
    """Return the robustness of ``left until right`` without bounds.

    From the last step back it is ``min(left, max(right, next))``, which clips the next one between two bounds. Clips
    are composed in steps of 1, 2, 4, ...
    """
    starts = _merged(left.starts_ns, right.starts_ns)
    high = left.at(starts)
    low = np.minimum(high, right.at(starts))
    reach = 1
    while reach < len(starts):
        bottom, top = low[:-reach].copy(), high[:-reach].copy()
        np.minimum(top, np.maximum(bottom, low[reach:]), out=low[:-reach])
        np.minimum(top, np.maximum(bottom, high[reach:]), out=high[:-reach])
        reach *= 2
    return _Steps(starts, low)


class _Parser:
    """Parses a formula by recursive descent."""

    def __init__(self, text: object) -> None:
        if not isinstance(text, str) or not text.strip():
            raise FormulaError(f"expected a formula such as 'always[0:20] (gap > 1.5)', got {text!r}")
        if len(text) > MOST_CHARACTERS:
            raise FormulaError(f"expected a formula of at most {MOST_CHARACTERS} characters, got {len(text)}")
        self.formulas: list[Formula] = []
        self._text = text
        self._tokens: list[str] = []
        self._starts: list[int] = []
        self._place = self._level = 0
        for match in _TOKEN.finditer(text):
            self._tokens.append(match["token"] or match["other"] or "")
            self._starts.append(match.start(match.lastgroup or 0))
            if match["other"]:
                self._place = len(self._tokens) - 1
                raise self._refusal("expected a signal, a number or an operator")

    def parse(self) -> _Node:
        node = self._implies()
        if self._token:
            raise self._refusal("expected and, or, until, implies or the end")
        return node

    @property
    def _token(self) -> str:
        return self._tokens[self._place]

    def _refusal(self, expected: str, detail: str = "") -> FormulaError:
        got = repr(self._token) if self._token else "the end"
        return FormulaError(
            f"{self._text!r}, character {self._starts[self._place] + 1}: {expected}{detail or f', got {got}'}"
        )

    def _accept(self, *tokens: str) -> bool:
        if self._token not in tokens:
            return False
        self._place += 1
        return True

    def _expect(self, token: str) -> None:
        if not self._accept(token):
            raise self._refusal(f"expected {token!r}")

    def _implies(self) -> _Node:
        left = self._either()
        return _Pair(False, _Not(left), self._implies()) if self._accept("implies", "->") else left

    def _either(self) -> _Node:
        node = self._both()
        while self._accept("or"):
            node = _Pair(False, node, self._both())
        return node

    def _both(self) -> _Node:
        node = self._until()
        while self._accept("and"):
            node = _Pair(True, node, self._until())
        return node

    def _until(self) -> _Node:
        left = self._unary()
        return _Until(*self._bounds(), left, self._until()) if self._accept("until") else left

    def _unary(self) -> _Node:
        self._level += 1
        if self._level > _MOST_LEVELS:
            raise self._refusal(f"expected at most {_MOST_LEVELS} operators within each other", " ")
        if self._accept("not"):
            node: _Node = _Not(self._unary())
        elif self._token in ("always", "eventually"):
            always = self._token == "always"
            self._place += 1
            node = _Window(always, *self._bounds(), self._unary())
        elif self._token == "(" and self._holds_condition():
            self._place += 1
            node = self._implies()
            self._expect(")")
        else:
            node = self._atom()
        self._level -= 1
        return node

    def _bounds(self) -> tuple[float, float]:
        """Return the bounds of an operator, in seconds."""
        if not self._accept("["):
            return 0.0, math.inf
        begin_s = self._seconds()
        if not self._accept(":", ","):
            raise self._refusal("expected bounds in seconds such as [0:20] or [5:]")
        end_s = math.inf if self._token == "]" else self._seconds()
        if end_s < begin_s:
            self._place -= 1
            raise self._refusal(f"expected an end of at least {begin_s:g}")
        self._expect("]")
        return begin_s, end_s

    def _seconds(self) -> float:
        try:
            seconds = float(self._token)
        except ValueError:
            raise self._refusal("expected a number of seconds") from None
        if not 0 <= seconds <= _LONGEST_S:
            raise self._refusal(f"expected 0 to {_LONGEST_S:g} seconds")
        self._place += 1
        return seconds

    def _holds_condition(self) -> bool:
        """Return whether the parentheses that open here enclose a condition, and not arithmetic."""
        depth = 0
        for token in self._tokens[self._place :]:
            depth += (token == "(") - (token == ")")
            if token in (*_COMPARISONS, *_UNARY, *_BINARY):
                return True
            if not depth:
                return False
        return False

    def _atom(self) -> _Atom:
        """Return what stands up to the next operator of temporal logic: a comparison, or a number."""
        begin, depth, wants_operand = self._place, 0, True
        while self._token and (depth or self._token not in _ENDS):
            is_operand = self._token[0] in "._`'\"" or self._token[0].isalnum()
            if is_operand and not wants_operand:
                raise self._refusal("expected an operator")
            if wants_operand and self._token in _NEEDS_LEFT:
                raise self._refusal("expected a signal or a number")
            wants_operand = not is_operand and self._token != ")"
            depth += (self._token == "(") - (self._token == ")")
            self._place += 1
        if wants_operand:
            raise self._refusal("expected a signal or a number")
        tokens = self._tokens[begin : self._place]
        written = self._text[self._starts[begin] : self._starts[self._place]].strip()
        try:
            formula = Formula(written)
        except FormulaError as error:
            self._place = begin
            raise self._refusal(str(error), " ") from None
        self.formulas.append(formula)
        return _Atom(formula, not formula.is_condition or not {"==", "!="}.isdisjoint(tokens))
