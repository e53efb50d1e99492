"""The region in words: rules of a shallow decision tree over decoded parameters, and how far to trust them.

Two trees are grown on all evaluated solutions of a campaign: one for what is unsafe, one for what lies on the
boundary. Their accuracy is cross-validated by scenario (or whatever the first component is): solutions with the same
scenario are never on both sides, or a tree would be praised for knowing scenarios by heart. A rule is worth its share
beside the share of all; an accuracy is worth its distance from that of always saying the more frequent.

Source: Breiman et al. 1984 (CART), as scikit-learn grows it (extra `analysis`).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any, Final

import numpy as np

from brink.search.archive import Archive
from brink.search.component import BoolArray, FloatArray
from brink.search.errors import MissingExtra, install_command
from brink.search.fitness import wilson_interval
from brink.search.parameters import Categorical, Integer, Parameter
from brink.search.space import SearchSpace

DEPTH: Final = 4
FOLDS: Final = 5
NOTHING: Final = 0.55
"""Balanced accuracy up to which rules say next to nothing: guessing is .50."""
LEAST_LEAF: Final = 15
"""Solutions of a rule, at least: fewer say too little."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Rule:
    """A leaf of the tree.

    Attributes:
        conditions: In words; all must hold. None: always.
        solutions: Evaluated solutions for which they hold.
        inside: Of them, in the region.
        low: Lower limit of the Wilson interval of that share.
        high: Upper limit.
    """

    conditions: tuple[str, ...]
    solutions: int
    inside: int
    low: float
    high: float

    @property
    def share(self) -> float:
        """Share that is in the region."""
        return self.inside / self.solutions


@dataclass(frozen=True, slots=True, kw_only=True)
class Rules:
    """A region, in rules.

    Attributes:
        region: Which, in words.
        solutions: Evaluated solutions that they are made of.
        inside: Of them, in the region.
        rules: By share in the region, largest first.
        accuracy: Cross-validated mean of the folds; None if there is too little to cross-validate.
        accuracy_sd: Its standard deviation over the folds.
        balanced: Cross-validated mean of the accuracies inside and outside of the region; .5 is guessing.
        usual: Accuracy of always saying the more frequent.
        folds: Folds of the cross-validation.
    """

    region: str
    solutions: int
    inside: int
    rules: tuple[Rule, ...]
    accuracy: float | None
    accuracy_sd: float | None
    balanced: float | None
    usual: float
    folds: int


@dataclass(frozen=True, slots=True, kw_only=True)
class _Feature:
    """A column that a tree may split: a number, or whether a category is one of its choices."""

    name: str
    parameter: Parameter
    choice: str | None

    def values(self, column: FloatArray) -> FloatArray:
        if self.choice is None:
            return column
        assert isinstance(self.parameter, Categorical)
        chosen: FloatArray = (column == self.parameter.choices.index(self.choice)).astype(np.float64)
        return chosen


def region_rules(archive: Archive, space: SearchSpace, inside: BoolArray, region: str, *, seed: int) -> Rules:
    """Return rules for a region of the evaluated solutions.

    Args:
        archive: Evaluated solutions.
        space: Theirs.
        inside: Which are in the region, shape ``(n,)``; some must be, and some must not.
        region: Which it is, in words.
        seed: Of the tree and of the folds.

    Raises:
        MissingExtra: scikit-learn is not installed.
        ValueError: All solutions are in the region, or none.
    """
    if find_spec("sklearn") is None:
        raise MissingExtra(f"rules need scikit-learn, which is not installed: {install_command('analysis')}")
    if inside.all() or not inside.any():
        raise ValueError(f"{region}: expected some solutions inside and some outside")
    # Imported here: an optional extra that takes a second to load.
    from sklearn.tree import DecisionTreeClassifier

    features = _features(space)
    columns = dict(zip(space.column_names(), archive.vectors.T, strict=True))
    table = np.column_stack([feature.values(columns[feature.name]) for feature in features])

    def tree() -> Any:
        return DecisionTreeClassifier(
            max_depth=DEPTH, min_samples_leaf=min(LEAST_LEAF, max(1, len(table) // 10)), random_state=seed
        )

    fitted = tree().fit(table, inside)
    groups = np.unique(archive.vectors[:, space.slices[0]], axis=0, return_inverse=True)[1].ravel()
    accuracies, balanced = _cross_validated(tree, table, inside, groups, seed)
    return Rules(
        region=region,
        solutions=len(inside),
        inside=int(inside.sum()),
        rules=_leaves(fitted.tree_, features, table, inside),
        accuracy=float(np.mean(accuracies)) if accuracies else None,
        accuracy_sd=float(np.std(accuracies)) if accuracies else None,
        balanced=float(np.mean(balanced)) if balanced else None,
        usual=float(max(inside.mean(), 1 - inside.mean())),
        folds=len(accuracies),
    )


def _features(space: SearchSpace) -> list[_Feature]:
    features = []
    parameters = [parameter for component in space.components for parameter in component.parameters]
    for name, parameter in zip(space.column_names(), parameters, strict=True):
        if isinstance(parameter, Categorical):
            shown = parameter.choices[1:] if len(parameter.choices) == 2 else parameter.choices
            features += [_Feature(name=name, parameter=parameter, choice=choice) for choice in shown]
        else:
            features.append(_Feature(name=name, parameter=parameter, choice=None))
    return features


def _cross_validated(
    tree: Any, table: FloatArray, inside: BoolArray, groups: Any, seed: int
) -> tuple[list[float], list[float]]:
    """Return accuracy and balanced accuracy of each fold; none where groups or regions are too few."""
    from sklearn.model_selection import StratifiedGroupKFold

    folds = min(FOLDS, int(groups.max()) + 1, int(inside.sum()), int((~inside).sum()))
    if folds < 2:
        return [], []
    accuracies, balanced = [], []
    split = StratifiedGroupKFold(folds, shuffle=True, random_state=seed)
    for learned, judged in split.split(table, inside, groups):
        truth = inside[judged]
        if inside[learned].all() or not inside[learned].any():
            continue
        right = tree().fit(table[learned], inside[learned]).predict(table[judged]) == truth
        accuracies.append(float(right.mean()))
        balanced.append(float(np.mean([right[truth == which].mean() for which in np.unique(truth)])))
    return accuracies, balanced


def _leaves(
    tree: Any, features: Sequence[_Feature], table: FloatArray, inside: BoolArray
) -> tuple[Rule, ...]:
    found: list[Rule] = []

    def walk(node: int, rows: BoolArray, bounds: Mapping[int, tuple[float, float]]) -> None:
        left, right = tree.children_left[node], tree.children_right[node]
        if left == right:
            k, n = int(inside[rows].sum()), int(rows.sum())
            low, high = wilson_interval(k, n)
            found.append(
                Rule(
                    conditions=_in_words(bounds, features),
                    solutions=n,
                    inside=k,
                    low=float(low),
                    high=float(high),
                )
            )
            return
        column, level = int(tree.feature[node]), float(tree.threshold[node])
        least, most = bounds.get(column, (-math.inf, math.inf))
        below = table[:, column].astype(np.float32) <= level  # trees compare in float32
        walk(left, rows & below, {**bounds, column: (least, min(most, level))})
        walk(right, rows & ~below, {**bounds, column: (max(least, level), most)})

    walk(0, np.ones(len(table), np.bool_), {})
    return tuple(sorted(found, key=lambda rule: (-rule.share, -rule.solutions)))


def _in_words(bounds: Mapping[int, tuple[float, float]], features: Sequence[_Feature]) -> tuple[str, ...]:
    """Return conditions, one for each parameter that is bounded."""
    said: dict[str, str] = {}
    excluded: dict[str, list[str]] = {}
    for column, (low, high) in bounds.items():
        feature = features[column]
        if feature.choice is None:
            said[feature.name] = _range_in_words(feature, low, high)
        elif low > 0:
            said[feature.name] = f"{feature.name} is {feature.choice}"
        else:
            excluded.setdefault(feature.name, []).append(feature.choice)
    for name, choices in excluded.items():
        if name not in said:
            parameter = next(feature.parameter for feature in features if feature.name == name)
            assert isinstance(parameter, Categorical)
            left = [str(choice) for choice in parameter.choices if choice not in choices]
            one_of = (
                f"{name} is {' or '.join(left)}"
                if len(left) <= 3
                else f"{name} is not {' or '.join(choices)}"
            )
            said[name] = one_of
    return tuple(said[features[column].name] for column in _firsts(bounds, features))


def _firsts(bounds: Mapping[int, tuple[float, float]], features: Sequence[_Feature]) -> list[int]:
    """Return one column for each parameter, in the order of the tree."""
    first: dict[str, int] = {}
    for column in bounds:
        first.setdefault(features[column].name, column)
    return list(first.values())


def _range_in_words(feature: _Feature, low: float, high: float) -> str:
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
    return f"{feature.name} at most {texts[1]}{after}"


def rules_markdown(found: Sequence[Rules]) -> str:
    """Return rules as Markdown."""
    parts = []
    for one in found:
        lines = [f"## {one.region[0].upper()}{one.region[1:]}", ""]
        share = one.inside / one.solutions
        lines.append(f"{one.inside:,} of {one.solutions:,} evaluated solutions ({share:.0%}). {trust(one)}")
        lines += ["", "| share | interval | solutions | where |", "|---:|---:|---:|---|"]
        for rule in one.rules:
            where = " **and** ".join(rule.conditions) or "everywhere"
            lines.append(
                f"| {rule.share:.0%} | {rule.low:.0%} to {rule.high:.0%} | {rule.solutions:,} | {where} |"
            )
        parts.append("\n".join(lines))
    return "\n\n".join(parts) + "\n"


def trust(one: Rules) -> str:
    """Return how far rules can be trusted, in words."""
    if one.accuracy is None:
        return "Too few of them to say how well the rules foretell others."
    helps = one.balanced is not None and one.balanced > NOTHING
    verdict = "" if helps else " **They say next to nothing of scenarios that they have not seen.**"
    return (
        f"Cross-validated over {one.folds} folds of other scenarios, the rules are right for {one.accuracy:.1%} "
        f"(standard deviation {one.accuracy_sd:.1%}), where always saying the more frequent is right for "
        f"{one.usual:.1%}; balanced accuracy {one.balanced:.2f}, where guessing is .50.{verdict}"
    )
