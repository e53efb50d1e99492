"""Thresholds in words: amounts in the units of the problem, where a line turns, and what is held."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from difflib import SequenceMatcher
from typing import Final, Self

import numpy as np

from brink.search.archive import Archive
from brink.search.conclusions import Outcome
from brink.search.features import Unit
from brink.search.parameters import Categorical, Value, name_in_words
from brink.search.space import FloatArray
from brink.server.campaigns.thresholds import CampaignThresholds, Threshold
from brink.server.findings.pairs.views import ComponentPart
from brink.server.findings.words import as_sentence, counted
from brink.server.problems.base import Problem, SimulatedSolution, describe_candidate
from brink.server.problems.changes import Change, different, instead, share_words

BLAMED: Final = {
    ComponentPart.NOT_TRIED: "ground truth not tried",
    ComponentPart.PENDING: "ground truth pending",
    ComponentPart.FAILED: "ground truth failed",
    ComponentPart.COMPONENT: "component's hazard (one seed)",
    ComponentPart.SCENARIO: "scenario's hazard (one seed)",
}
"""What ground truth in place of the component says of the unsafe end."""
_ROUNDING: Final = 1e-9
_MOST_LISTED: Final = 6
"""Most held values that are listed where the problem has no words for what is held."""
_FEWEST_REPEATS: Final = 3
"""Simulations of a solution from which on most of those with another seed say something."""
_UNCERTAIN: Final = {
    Outcome.CHANCY: "chance decides, no value does",
    Outcome.OPEN: "more simulations would tell where it turns",
}
_BARE: Final = 3
"""Most words of a part that names a number, its value and its unit, and nothing else."""
_LONGEST_SYMBOL: Final = 3
"""Letters up to which a unit is a symbol, such as ``s``, rather than a word in the plural, such as ``steps``."""
_PARTS: Final = re.compile(r"[^\s,;]+|[,;]?\s+|[,;]")


@dataclass(frozen=True, slots=True, kw_only=True)
class Amounts:
    """Values of a number in the unit that people use.

    Attributes:
        unit: The unit; empty for a plain number.
        at_0: Amount of the value 0.
        per_1: Amount of a difference of 1.
        decimals: Decimal places that the resolution asks for.
        digits: Significant digits that it asks for on a log scale, where values are logarithms and differences are
            factors; None on any other.
    """

    unit: str
    at_0: float
    per_1: float
    decimals: int
    digits: int | None = None

    @classmethod
    def of(cls, problem: Problem, column: int, row: FloatArray, resolution: float) -> Self:
        """Return the amounts of a number in a solution.

        Args:
            problem: The problem.
            column: Column of the number.
            row: The solution, shape ``(d,)``.
            resolution: Resolution of the number.
        """
        space = problem.space
        scale = problem.scale_of(space.column_names()[column], space.decode(space.split(row)))
        unit, at_0, at_1 = "", 0.0, 1.0
        if scale is not None:
            unit, at_0, at_1 = scale.unit, scale.none, scale.most
        else:
            parameter = space.parameters[column]
            assert not isinstance(parameter, Categorical)  # a line has no categories
            unit = parameter.unit
            if parameter.log:
                digits = 1 + max(1, math.ceil(-math.log10(resolution)))
                decimals = max(0, digits - 1 - math.floor(math.log10(parameter.low)))
                return cls(unit=unit, at_0=at_0, per_1=at_1, decimals=decimals, digits=digits)
        shown = resolution * abs(at_1 - at_0)
        decimals = max(0, math.ceil(-math.log10(shown) - _ROUNDING))
        return cls(unit=unit, at_0=at_0, per_1=at_1 - at_0, decimals=decimals)

    def amount(self, value: float) -> float | None:
        """Return the amount of a value; None if that is infinite."""
        return self.at(value) if math.isfinite(value) else None

    def at(self, value: float) -> float:
        """Return the amount of a finite value."""
        return self.at_0 + value * self.per_1 if self.digits is None else math.exp(value)

    def apart(self, width: float) -> float:
        """Return a difference in the unit; on a log scale, the factor that it stands for."""
        return width * abs(self.per_1) if self.digits is None else math.exp(width)

    def rounded(self, value: float) -> float:
        """Return the value whose amount has no more decimal places than the resolution asks for."""
        if self.digits is not None:
            return math.log(float(f"{math.exp(value):.{self.digits}g}"))
        return (round(self.at_0 + value * self.per_1, self.decimals) - self.at_0) / self.per_1

    def number(self, value: float) -> str:
        """Return the amount of a value in digits; ``beyond`` if that is infinite."""
        amount = self.amount(value)
        if amount is None:
            return "beyond"
        return f"{amount + 0.0:.{self.decimals}f}" if self.digits is None else f"{amount:.{self.digits}g}"

    def words(self, value: float) -> str:
        """Return the amount of a value with its unit."""
        return self._with_unit(self.number(value))

    def interval(self, low: float, high: float) -> str:
        """Return an interval in digits, smaller amounts first."""
        ends = sorted((low, high), key=lambda value: self.at_0 + value * self.per_1)
        return f"[{self.number(ends[0])}, {self.number(ends[1])}]"

    def difference(self, width: float, resolution: float) -> str:
        """Return a difference with its unit, or a factor; less than a resolution is not told apart."""
        if self.digits is not None:
            least = f"less than {self.apart(resolution):.4g}" if width < resolution else ""
            return f"a factor of {least or format(self.apart(width), '.3g')}"
        if width < resolution:
            return self._with_unit(f"less than {resolution * abs(self.per_1):.4g}")
        return self._with_unit(f"{width * abs(self.per_1):.{self.decimals}f}")

    def _with_unit(self, digits: str) -> str:
        if self.unit == "%":
            return f"{digits}%"
        is_word = self.unit.isalpha() and len(self.unit) > _LONGEST_SYMBOL
        one = is_word and digits.rpartition(" ")[2] == "1"  # 1 step, less than 1 step
        return f"{digits} {self.unit.removesuffix('s') if one else self.unit}".rstrip()


def headline(found: CampaignThresholds, kinds: int, archive: Archive, problem: Problem, noun: str) -> str:
    """Return the result in at most 25 words, without a full stop.

    Args:
        found: The thresholds.
        kinds: Different kinds among them.
        archive: The simulated solutions.
        problem: Their problem.
        noun: What a solution is called.
    """
    thresholds, chancy, open_ones = (
        found.of(outcome) for outcome in (Outcome.THRESHOLD, Outcome.CHANCY, Outcome.OPEN)
    )
    rest = [counted(len(chancy), "chancy line")] if chancy else []
    rest += [counted(len(open_ones), "open line")] if open_ones else []
    if not thresholds:
        return f"no threshold: {_reason(found, archive, problem, noun)}"
    stretch = float(np.median([one.stretch / one.range for one in thresholds]))
    width, median = f"{share_words(stretch)} of the range", " (median)" if len(thresholds) > 1 else ""
    told = (
        f"safe and unsafe values {width} apart"
        if problem.ignores_seeds
        else f"from 20 to 80% unsafe within {width}"
    )
    many = f"{counted(len(thresholds), 'threshold')} of {counted(kinds, 'kind')}"
    return "; ".join([many, told + median, *rest])


def _reason(found: CampaignThresholds, archive: Archive, problem: Problem, noun: str) -> str:
    """Return why there is no threshold."""
    evaluated, unsafe = len(archive), int(archive.unsafe.sum())
    if not unsafe:
        return f"none of {counted(evaluated, noun)} was unsafe"
    if unsafe == evaluated:
        return f"all {counted(evaluated, noun)} were unsafe"
    if all(isinstance(one, Categorical) for one in problem.space.parameters):
        return "the search space has no numbers, only categories"
    told = []
    if chancy := found.of(Outcome.CHANCY):
        drives = sum(one.drives for one in chancy)
        told.append(f"chance decides on {counted(len(chancy), 'line')} ({counted(drives, noun)})")
    if open_ones := found.of(Outcome.OPEN):
        told.append(f"{counted(len(open_ones), 'line')} with too few simulations")
    if told:
        return " and ".join(told)
    again, changed = _repeats(archive)
    if again and not problem.ignores_seeds:
        return f"of {counted(again, noun)} simulated again with other seeds, {changed:,} mostly had the other verdict"
    return "no number was varied alone with enough episode seeds"


def _repeats(archive: Archive) -> tuple[int, int]:
    """Return how many solutions were simulated at least three times, and of how many most repeats differ.

    A solution is simulated again only under another seed.
    """
    _, first, which, counts = np.unique(
        archive.vectors, axis=0, return_index=True, return_inverse=True, return_counts=True
    )
    which = which.reshape(-1)
    differ = archive.unsafe != archive.unsafe[first[which]]
    others = np.bincount(which, weights=differ, minlength=len(counts))
    repeated = counts >= _FEWEST_REPEATS
    return int(repeated.sum()), int((repeated & (2 * others > counts - 1)).sum())


def untold(found: CampaignThresholds, archive: Archive, problem: Problem, noun: str) -> str:
    """Return what was tried where there is no threshold, and what that leaves open, as a sentence.

    Args:
        found: The thresholds.
        archive: The simulated solutions.
        problem: Their problem.
        noun: What a solution is called.

    Returns:
        Empty if there are thresholds, or if nothing was learnt.
    """
    evaluated, unsafe = len(archive), int(archive.unsafe.sum())
    if found.of(Outcome.THRESHOLD) or not evaluated:
        return ""
    if not unsafe:
        lowest = int(archive.numbers[int(np.argmin(archive.robustness))])
        return (
            f"The whole budget was spent on looking for an unsafe {noun}. Solution {lowest} came closest; "
            f"{noun}s that were not simulated may be unsafe"
        )
    if unsafe == evaluated:
        return f"Without a safe {noun}, there is no value at which one turns: search a wider space"
    if all(isinstance(one, Categorical) for one in problem.space.parameters):
        return "A category has no values in between. What changing one does is shown by the categorical pairs"
    if found.of(Outcome.CHANCY):
        return (
            "Along each line, the probability of a violation does not pass from 20 to 80% within a fifth of the "
            "range: another number, or several together, may decide"
        )
    return ""


def change_of(
    problem: Problem, safe: SimulatedSolution, unsafe: SimulatedSolution, changes: Sequence[Change]
) -> str:
    """Return what changes from the 20% to the 80% point, in the problem's own words or else by the numbers' names.

    Args:
        problem: The problem.
        safe: The 20% point.
        unsafe: The 80% point.
        changes: Their differences.
    """
    names = [name for one in changes for name in one.names]
    if words := problem.words_of_change(safe, unsafe, names):
        return as_sentence(words)
    parts = [
        f"{_named(problem, name, unit)} {instead(old, new, unit)}"
        for one in changes
        for name, old, new, unit in zip(one.names, one.safe, one.unsafe, one.units, strict=True)
    ]
    return as_sentence(", ".join(parts))


def sentence(one: Threshold, change: str, fails: str, ends: Sequence[str], parameter: str) -> str:
    """Return a line in a sentence without a full stop.

    Args:
        one: The line.
        change: What changes from the 20% to the 80% point, in words.
        fails: How the unsafe end fails.
        ends: Both ends of the line in words, the smaller one first.
        parameter: What is varied, in words.
    """
    if one.outcome is Outcome.THRESHOLD:
        return f"{change}: {fails}"
    varied = f"{parameter}, varied from {ends[0]} to {ends[1]}"
    return f"{varied}: {_UNCERTAIN[one.outcome]}"


def turns(one: Threshold, amounts: Amounts, *, computed: bool) -> str:
    """Return where half of the drives are unsafe, with the interval, such as ``1.4 s [1.3, 1.6]``.

    Args:
        one: The line.
        amounts: Its amounts.
        computed: Whether verdicts are deterministic: it turns between two values then, and nothing is estimated.
    """
    if computed:
        ends = sorted(amounts.at(value) for value in (one.start, one.end))
        return f"between {' and '.join(different(*ends))} {amounts.unit}".rstrip()
    if one.outcome is Outcome.CHANCY:
        return "nowhere"
    if not math.isfinite(one.middle):
        return "not known yet"
    return f"{amounts.words(one.middle)} {_interval(one, amounts)}"


def _interval(one: Threshold, amounts: Amounts) -> str:
    """Return the interval of the 50% point; where it reaches beyond the line, with the end of the line."""
    if math.isfinite(one.low) and math.isfinite(one.high):
        return amounts.interval(one.low, one.high)
    low, high = sorted((one.low, one.high), key=lambda value: value * amounts.per_1)
    least, most = sorted(one.line.ends, key=lambda value: value * amounts.per_1)
    below = amounts.number(low) if math.isfinite(low) else f"below {amounts.number(least)}"
    above = amounts.number(high) if math.isfinite(high) else f"above {amounts.number(most)}"
    return f"[{below}, {above}]"


def within(one: Threshold, amounts: Amounts) -> str:
    """Return the stretch from 20 to 80% in words, such as ``0.2 s (2%)``."""
    if not math.isfinite(one.stretch):
        return "not within a fifth of the range" if one.outcome is Outcome.CHANCY else "not known yet"
    return f"{amounts.difference(one.stretch, one.resolution)} ({share_words(one.stretch / one.range)})"


def rule(one: Threshold, amounts: Amounts, *, computed: bool) -> str:
    """Return where drives are unsafe, as far as they were simulated; empty without a threshold.

    Args:
        one: The line.
        amounts: Its amounts.
        computed: Whether verdicts are deterministic.
    """
    if one.outcome is not Outcome.THRESHOLD or not math.isfinite(one.end):
        return ""
    sign = 1.0 if one.line.rises else -1.0
    bounds = [value for value in (one.safe_again, one.line.safe_beyond) if value is not None]
    along = sign * one.line.values
    reach = along[one.line.unsafe & (along < min((sign * value for value in bounds), default=np.inf))].max()
    where = amounts.words(one.end)
    if not computed and all(map(math.isfinite, one.end_interval)):
        where += f" {amounts.interval(*one.end_interval)}"
    how = "unsafe" if computed else "unsafe with a probability of at least 80%"
    if reach <= sign * max(one.end_interval, key=lambda value: sign * value) + one.resolution:
        return f"{how} at {where}"
    return f"{how} from {where} {'up' if rises(one, amounts) else 'down'} to {amounts.words(sign * reach)}"


def window(one: Threshold, amounts: Amounts) -> str:
    """Return where drives further on are safe again; empty if none are."""
    if one.safe_again is not None:
        return f"further on, from {amounts.words(one.safe_again)}, no longer unsafe"
    if one.line.safe_beyond is not None:
        return f"one drive further on, at {amounts.words(one.line.safe_beyond)}, is safe again"
    return ""


def rises(one: Threshold, amounts: Amounts) -> bool:
    """Return whether larger amounts are the unsafe ones."""
    return one.line.rises == (amounts.per_1 > 0)


def parameter_words(problem: Problem, name: str, side: SimulatedSolution, unit: str) -> str:
    """Return what a number is: what its scale measures, or else its title without the unit.

    Args:
        problem: The problem.
        name: The number, as component.parameter.
        side: A solution.
        unit: Unit in which the number is shown.
    """
    scale = problem.scale_of(name, problem.space.decode(tuple(side.vectors)))
    if scale is not None:
        return scale.meaning
    return _named(problem, name, unit)


def _named(problem: Problem, name: str, unit: str) -> str:
    """Return the title of a parameter without its unit, which follows its values.

    The component is left out where no other one has a parameter of this name.
    """
    title, (_, _, own) = problem.space.titles()[name], name.partition(".")
    if title == name_in_words(name) and not any(
        other != name and other.endswith(f".{own}") for other in problem.space.column_names()
    ):
        title = own.replace(".", " ").replace("_", " ")
    return title.removesuffix(f" {unit.replace('/', 'p')}") if unit else title


def held(problem: Problem, safe: SimulatedSolution, unsafe: SimulatedSolution, unit: Unit) -> str:
    """Return what both ends of a line have in common, with ``…`` in place of what changes.

    Args:
        problem: The problem.
        safe: The safe end.
        unsafe: The unsafe end.
        unit: What changes.
    """
    if not problem.words(safe.vectors):
        return _listed(problem, safe, unit)
    one, other = (_PARTS.findall(describe_candidate(problem, side.vectors)) for side in (safe, unsafe))
    changes = SequenceMatcher(None, one, other, autojunk=False).get_opcodes()
    shared = ("".join(one[start:end]) if change == "equal" else "…" for change, start, end, _, _ in changes)
    clauses = "".join(shared).split("; ")
    return "; ".join(filter(None, map(_without_bare_values, clauses)))


def _without_bare_values(clause: str) -> str:
    """Return a clause without the parts that only name what changes, such as ``speed … m/s``."""
    parts = clause.split(", ")
    return ", ".join(part for part in parts if not ("…" in part and len(part.split()) <= _BARE))


def _listed(problem: Problem, side: SimulatedSolution, unit: Unit) -> str:
    """Return the first values that are held, such as ``y 0.5 m``."""
    space, row = problem.space, problem.space.join(tuple(side.vectors))
    units = ["" if isinstance(one, Categorical) else one.unit for one in space.parameters]
    listed = [
        f"{_named(problem, name, units[column])} {_value_text(parameter.decode(float(row[column])))} {units[column]}"
        for column, (name, parameter) in enumerate(zip(space.column_names(), space.parameters, strict=True))
        if column not in unit
    ]
    more = [f"{len(listed) - _MOST_LISTED} more"] if len(listed) > _MOST_LISTED else []
    return ", ".join([*map(str.rstrip, listed[:_MOST_LISTED]), *more])


def _value_text(value: Value) -> str:
    """Return a value with at most four significant digits."""
    return f"{value:.4g}" if isinstance(value, float) else str(value)
