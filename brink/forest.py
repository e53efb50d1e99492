"""Forests of decision trees as arrays, which NumPy alone evaluates, and their JSON form.

The safety monitor and the guard store their trees in this form. NumPy and the standard library only, so that both the
search and the simulator may import it.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, Self, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray: TypeAlias = NDArray[np.float64]
IntArray: TypeAlias = NDArray[np.int64]
FeatureArray: TypeAlias = NDArray[np.floating[Any]]

BLOCK_NODES: Final = 1 << 20
"""Maximum number of nodes visited at a time."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Forest:
    """The trees of several models, as arrays of nodes.

    The left child of an inner node is the next node. A solution goes left if its feature is at most the threshold.

    Attributes:
        right: Right child of each node, 0 for a leaf, shape ``(nodes,)``.
        feature: Feature compared at each inner node, 0 for a leaf, shape ``(nodes,)``.
        value: Threshold of an inner node, contribution of a leaf in log odds, shape ``(nodes,)``.
        roots: First node of each tree, ascending, shape ``(trees,)``.
        owners: Model of each tree, ascending, shape ``(trees,)``.
        offsets: Score of each model before its trees, in log odds, shape ``(models,)``.
    """

    right: IntArray
    feature: IntArray
    value: FloatArray
    roots: IntArray
    owners: IntArray
    offsets: FloatArray

    @classmethod
    def of(cls, document: Mapping[str, Any], features: int) -> Self:
        """Return the trees of a document written by `to_document`.

        Args:
            document: The document.
            features: Number of features.

        Raises:
            ValueError: A shape or an index is wrong; every walk through accepted trees ends in a leaf.
        """
        right, feature, roots, owners = (
            _frozen(document[name], np.int64) for name in ("right", "feature", "roots", "owners")
        )
        value, offsets = (_frozen(document[name], np.float64) for name in ("value", "offsets"))
        nodes = np.arange(right.size)
        ends = np.append(roots[1:], right.size)
        # A child comes after its parent and in the same tree, so that no walk can circle or leave the arrays.
        end = np.repeat(ends, ends - roots) if (ends > roots).all() and roots.size else np.zeros(0)
        inner = right > 0
        good = (
            all(one.ndim == 1 for one in (right, feature, value, roots, owners, offsets))
            and right.shape == feature.shape == value.shape == end.shape
            and roots.shape == owners.shape
            and roots[0] == 0
            and (right >= 0).all()
            and (right[inner] > nodes[inner] + 1).all()
            and (right[inner] < end[inner]).all()
            and ((feature >= 0) & (feature < features)).all()
            and np.isfinite(value).all()
            and np.isfinite(offsets).all()
            and (np.unique(owners) == np.arange(offsets.size)).all()
            and (np.diff(owners) >= 0).all()
        )
        if not good:
            raise ValueError("expected consistent arrays of trees")
        return cls(right=right, feature=feature, value=value, roots=roots, owners=owners, offsets=offsets)

    def to_document(self) -> dict[str, Any]:
        """Return the arrays as a JSON object."""
        return {
            "right": self.right.tolist(),
            "feature": self.feature.tolist(),
            "value": self.value.tolist(),
            "roots": self.roots.tolist(),
            "owners": self.owners.tolist(),
            "offsets": self.offsets.tolist(),
        }

    def scores(self, features: FeatureArray) -> FloatArray:
        """Return the score of each solution by each model in log odds, shape ``(m, models)``.

        Args:
            features: Features of the solutions, shape ``(m, features)``.
        """
        starts = np.searchsorted(self.owners, np.arange(self.offsets.size))
        scores = np.empty((len(features), self.offsets.size))
        step = max(1, BLOCK_NODES // self.roots.size)
        for first in range(0, len(features), step):
            part = np.ascontiguousarray(features[first : first + step])
            values = self.value[self._leaves(part)]
            scores[first : first + step] = np.add.reduceat(values, starts, axis=1) + self.offsets
        return scores

    def _leaves(self, features: FeatureArray) -> IntArray:
        """Return the leaf that each solution reaches in each tree, shape ``(m, trees)``."""
        count, width = features.shape
        at = np.tile(self.roots, count)
        row = np.repeat(np.arange(0, count * width, width), self.roots.size)
        flat = features.ravel()
        walking = np.flatnonzero(self.right[at] > 0)
        while walking.size:
            node = at[walking]
            left = flat[row[walking] + self.feature[node]] <= self.value[node]
            node = np.where(left, node + 1, self.right[node])
            at[walking] = node
            walking = walking[self.right[node] > 0]
        return at.reshape(count, -1)


def _frozen(values: ArrayLike, dtype: type[np.generic]) -> NDArray[Any]:
    array = np.array(values, dtype=dtype)
    array.flags.writeable = False
    return array
