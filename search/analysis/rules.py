"""A region of solutions described by the rules of a shallow decision tree, with the accuracy of the rules.

The region is, for example, the unsafe solutions or those on the boundary. The tree is fitted to half of the scenarios
(the first component), and everything that is said of its rules is counted in the other half: a tree chooses its
splits so that the shares of the solutions that it sees differ, whether they do elsewhere or not. Compare the share of
a rule with that of the whole region, and an accuracy with that of always predicting the majority.

Shares have no intervals: a search breeds its solutions from each other, so they are not an independent sample of
anything (ADR 66). A parameter that did not affect an episode is inactive there, whatever its value.

Source: Breiman et al. 1984 (CART), with scikit-learn's implementation (extra `analysis`).
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any, Final

import numpy as np

from brink.extras import install_command
from brink.search.analysis.dependence import ParameterColumn, parameter_columns
from brink.search.archive import Archive
from brink.search.errors import MissingExtra
from brink.search.parameters import Categorical, Integer, Parameter
from brink.search.space import BoolArray, FloatArray, IntArray, SearchSpace

DEPTH: Final = 4
USELESS: Final = 0.65
"""Balanced accuracy up to which rules are not a finding; guessing gives .50."""
LEAST_LEAF: Final = 15
"""Minimum number of solutions per rule, among those to which the tree is fitted."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Rule:
    """A leaf of the tree.

    Attributes:
        conditions: Conditions in words, all of which must hold; empty if the rule always applies.
        solutions: Solutions of the held-out scenarios for which they hold, at least one.
        inside: Solutions among them in the region.
    """

    conditions: tuple[str, ...]
    solutions: int
    inside: int

    @property
    def share(self) -> float:
        """Share of the rule's solutions that are in the region."""
        return self.inside / self.solutions


@dataclass(frozen=True, slots=True, kw_only=True)
class Rules:
    """The rules of a region.

    Attributes:
        region: The region in words.
        solutions: Number of evaluated solutions.
        inside: Number of solutions in the region.
        held_out: Number of solutions of the scenarios to which the tree was not fitted; 0 if there are too few
            scenarios, and therefore no rules.
        held_out_inside: Solutions among them in the region.
        rules: The rules, by share in the region, largest first.
        accuracy: Accuracy in the held-out scenarios; None without any.
        balanced: Balanced accuracy there, the mean of those inside and outside; guessing gives .5.
    """

    region: str
    solutions: int
    inside: int
    held_out: int
    held_out_inside: int
    rules: tuple[Rule, ...]
    accuracy: float | None
    balanced: float | None

    @property
    def usual(self) -> float:
        """Accuracy of always predicting the majority, in the held-out scenarios; needs some."""
        share = self.held_out_inside / self.held_out
        return max(share, 1.0 - share)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Feature:
    """A column that a tree may split on: a number, or whether a category has a certain choice.

    Attributes:
        name: Name of the parameter, ``component.parameter``.
        parameter: The parameter.
        choice: The choice; None for a number.
        sleeps: Whether the parameter is inactive in some solutions. These have none of its choices, or a number far
            below its range.
    """

    name: str
    parameter: Parameter
    choice: str | None
    sleeps: bool

    def values(self, column: ParameterColumn) -> FloatArray:
        if isinstance(self.parameter, Categorical):
            assert self.choice is not None
            index = self.parameter.choices.index(self.choice)
            chosen: FloatArray = (column.active & (column.values == index)).astype(np.float64)
            return chosen
        low, high = self.parameter.low, self.parameter.high
        numbers: FloatArray = np.where(column.active, column.values, low - (high - low) - 1.0)
        return numbers


def region_rules(
    archive: Archive,
    space: SearchSpace,
    inside: BoolArray,
    region: str,
    *,
    seed: int,
    recorded: BoolArray | None = None,
) -> Rules:
    """Return the rules of a region of the evaluated solutions.

    Args:
        archive: The evaluated solutions.
        space: The search space.
        inside: Which solutions are in the region, shape ``(n,)``; neither all nor none.
        region: The region in words.
        seed: Seed of the tree and of the folds.
        recorded: Which parameters were active in each episode, as in `parameter_columns`.

    Raises:
        MissingExtra: scikit-learn is not installed.
        ValueError: All solutions are in the region, or none is.
    """
    if find_spec("sklearn") is None:
        raise MissingExtra(f"rules need scikit-learn, which is not installed: {install_command('analysis')}")
    if inside.all() or not inside.any():
        raise ValueError(f"{region}: expected some solutions inside and some outside the region")
    from sklearn.tree import DecisionTreeClassifier  # optional, and slow to import

    columns = {column.name: column for column in parameter_columns(space, archive.vectors, recorded)}
    features = _features(columns.values())
    table = np.column_stack([feature.values(columns[feature.name]) for feature in features])

    state = seed % 2**32  # scikit-learn takes no larger one
    groups = np.unique(archive.vectors[:, space.slices[0]], axis=0, return_inverse=True)[1].ravel()
    held_out = _half(inside, groups, state)
    if held_out is None:
        return Rules(
            region=region,
            solutions=len(inside),
            inside=int(inside.sum()),
            held_out=0,
            held_out_inside=0,
            rules=(),
            accuracy=None,
            balanced=None,
        )
    leaf = min(LEAST_LEAF, max(1, len(table) // 10))
    tree = DecisionTreeClassifier(max_depth=DEPTH, min_samples_leaf=leaf, random_state=state)
    tree.fit(table[~held_out], inside[~held_out])
    truth = inside[held_out]
    right = tree.predict(table[held_out]) == truth
    return Rules(
        region=region,
        solutions=len(inside),
        inside=int(inside.sum()),
        held_out=len(truth),
        held_out_inside=int(truth.sum()),
        rules=_leaves(tree.tree_, features, table[held_out], truth),
        accuracy=float(right.mean()),
        balanced=float(np.mean([right[truth].mean(), right[~truth].mean()])),
    )


def _features(columns: Iterable[ParameterColumn]) -> list[_Feature]:
    features = []
    for column in columns:
        parameter, sleeps = column.parameter, not column.active.all()
        choices: tuple[str | None, ...] = (None,)
        if isinstance(parameter, Categorical):
            allowed = tuple(parameter.choices[code] for code in parameter.codes)
            choices = allowed[1:] if len(allowed) == 2 and not sleeps else allowed
        features += [
            _Feature(name=column.name, parameter=parameter, choice=choice, sleeps=sleeps)
            for choice in choices
        ]
    return features


def _half(inside: BoolArray, groups: IntArray, state: int) -> BoolArray | None:
    """Return a mask of half of the solutions, by whole scenarios; None if a half would be all inside or all outside.

    Args:
        inside: Which solutions are in the region, shape ``(n,)``.
        groups: The scenario of each, shape ``(n,)``.
        state: Seed of the division.
    """
    from sklearn.model_selection import StratifiedGroupKFold

    if groups.max() < 1 or min(inside.sum(), (~inside).sum()) < 2:
        return None
    split = StratifiedGroupKFold(2, shuffle=True, random_state=state)
    held_out = np.zeros(len(inside), np.bool_)
    held_out[next(split.split(groups, inside, groups))[1]] = True
    halves = (inside[held_out], inside[~held_out])
    return None if any(half.all() or not half.any() for half in halves) else held_out


def _leaves(
    tree: Any, features: Sequence[_Feature], table: FloatArray, inside: BoolArray
) -> tuple[Rule, ...]:
    rules: list[Rule] = []

    def walk(node: int, rows: BoolArray, bounds: Mapping[int, tuple[float, float]]) -> None:
        left, right = tree.children_left[node], tree.children_right[node]
        if left == right:
            if rows.any():
                conditions, count = _conditions(bounds, features), int(rows.sum())
                rules.append(Rule(conditions=conditions, solutions=count, inside=int(inside[rows].sum())))
            return
        column, level = int(tree.feature[node]), float(tree.threshold[node])
        least, most = bounds.get(column, (-math.inf, math.inf))
        below = table[:, column].astype(np.float32) <= level  # as scikit-learn compares
        walk(left, rows & below, {**bounds, column: (least, min(most, level))})
        walk(right, rows & ~below, {**bounds, column: (max(least, level), most)})

    walk(0, np.ones(len(table), np.bool_), {})
    return tuple(sorted(rules, key=lambda rule: (-rule.share, -rule.solutions)))


def _conditions(bounds: Mapping[int, tuple[float, float]], features: Sequence[_Feature]) -> tuple[str, ...]:
    """Return the conditions, one for each restricted parameter."""
    conditions: dict[str, str] = {}
    excluded: dict[str, list[str]] = {}
    for column, (low, high) in bounds.items():
        feature = features[column]
        if feature.choice is None:
            conditions[feature.name] = _range_condition(feature, low, high)
        elif low > 0:
            conditions[feature.name] = f"{feature.name} is {feature.choice}"
        else:
            excluded.setdefault(feature.name, []).append(feature.choice)
    for name, choices in excluded.items():
        if name not in conditions:
            feature = next(feature for feature in features if feature.name == name)
            parameter = feature.parameter
            assert isinstance(parameter, Categorical)
            allowed = [parameter.choices[code] for code in parameter.codes]
            left = [choice for choice in allowed if choice not in choices]
            left += ["inactive"] if feature.sleeps else []
            conditions[name] = (
                f"{name} is {' or '.join(left)}"
                if len(left) <= 3
                else f"{name} is not {' or '.join(choices)}"
            )
    return tuple(conditions[features[column].name] for column in _first_columns(bounds, features))


def _first_columns(bounds: Mapping[int, tuple[float, float]], features: Sequence[_Feature]) -> list[int]:
    """Return the first column of each parameter, in the order of the tree."""
    first: dict[str, int] = {}
    for column in bounds:
        first.setdefault(features[column].name, column)
    return list(first.values())


def _range_condition(feature: _Feature, low: float, high: float) -> str:
    assert not isinstance(feature.parameter, Categorical)
    if feature.sleeps and high < feature.parameter.low:
        return f"{feature.name} is inactive"
    if feature.sleeps and low < feature.parameter.low:
        if np.isfinite(low) and not np.isfinite(high):
            return f"{feature.name} is active"
        if np.isfinite(low):
            low = feature.parameter.low
    unit = getattr(feature.parameter, "unit", "")
    after = f" {unit}" if unit else ""
    if isinstance(feature.parameter, Integer):
        least, most = np.floor(low) + 1, np.floor(high)
        if np.isfinite(low) and least == most:
            return f"{feature.name} is {least:.0f}{after}"
        texts = (f"{least:.0f}", f"{most:.0f}")
    else:
        texts = (f"{low:.3g}", f"{high:.3g}")
    if np.isfinite(low) and np.isfinite(high):
        return f"{feature.name} from {texts[0]} to {texts[1]}{after}"
    if np.isfinite(low):
        return f"{feature.name} at least {texts[0]}{after}"
    return f"{feature.name} at most {texts[1]}{after}{' or inactive' if feature.sleeps else ''}"


def rules_markdown(found: Sequence[Rules]) -> str:
    """Return rules as Markdown."""
    parts = []
    for one in found:
        lines = [f"## {one.region[0].upper()}{one.region[1:]}", ""]
        share = one.inside / one.solutions
        lines.append(f"{one.inside:,} of {one.solutions:,} evaluated solutions ({share:.0%}). {trust(one)}")
        lines += ["", "| share | solutions | where |", "|---:|---:|---|"] if one.rules else []
        for rule in one.rules:
            where = " **and** ".join(rule.conditions) or "everywhere"
            lines.append(f"| {rule.share:.0%} | {rule.solutions:,} | {where} |")
        parts.append("\n".join(lines))
    return "\n\n".join(parts) + "\n"


def trust(one: Rules) -> str:
    """Return a description of how far the rules can be trusted."""
    if one.accuracy is None or one.balanced is None:
        return "Too few scenarios to fit rules to half of them."
    verdict = (
        "" if one.balanced > USELESS else " **They say little about scenarios that they were not fitted to.**"
    )
    return (
        f"The rules are fitted to half of the scenarios, and counted in the other half: {one.held_out_inside:,} of "
        f"{one.held_out:,} solutions. There they have a balanced accuracy of {one.balanced:.0%}; guessing gives 50%."
        f"{verdict} They are right for {one.accuracy:.1%}; always predicting the majority is right for "
        f"{one.usual:.1%}."
    )
