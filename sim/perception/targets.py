"""What the network should answer for a picture, and how far an answer is from it.

The heat map's target is a Gaussian around the middle of each box, as wide as a box may be off and still overlap by
half; distances to the edges are asked of the cells near the middle. Cells inside ignored boxes are asked nothing.

Sources: Zhou et al. 2019 (penalty-reduced focal loss), Rezatofighi et al. 2019 (generalised IoU).
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import torch
from torch import Tensor

from brink.sim.perception.detector import INPUT_PX, LABELS, STRIDE
from brink.sim.perception.quality import Truth

ACROSS: Final = INPUT_PX[0] // STRIDE
DOWN: Final = INPUT_PX[1] // STRIDE
NEAR_MIDDLE: Final = 0.6
"""Cells with at least so much heat are asked for edges."""
EDGES_WEIGHT: Final = 3.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Target:
    """What is asked of the network for a batch.

    Attributes:
        heat: In [0, 1], 1 at the middles, shape ``(n, classes, h, w)``.
        asked: Where the heat map counts, shape ``(n, 1, h, w)``.
        edges: Distances to left, upper, right and lower edge in px, shape ``(n, classes, 4, h, w)``.
        weight: How much the edges of each cell count, shape ``(n, classes, h, w)``: 1 in all for each box.
    """

    heat: Tensor
    asked: Tensor
    edges: Tensor
    weight: Tensor


_Plane = np.ndarray[tuple[int, ...], np.dtype[np.float32]]


def target_of(truths: list[Truth]) -> Target:
    """Return what is asked for pictures with this ground truth, in px of the network's input."""
    count, classes = len(truths), len(LABELS)
    heat = np.zeros((count, classes, DOWN, ACROSS), np.float32)
    asked = np.ones((count, 1, DOWN, ACROSS), np.float32)
    edges = np.zeros((count, classes, 4, DOWN, ACROSS), np.float32)
    weight = np.zeros((count, classes, DOWN, ACROSS), np.float32)
    for index, truth in enumerate(truths):
        sizes = np.prod(truth.boxes[:, 2:] - truth.boxes[:, :2], axis=1)
        for place in np.argsort(
            -sizes, kind="stable"
        ).tolist():  # small boxes last: theirs are the cells they share
            box, label = truth.boxes[place], truth.labels[place]
            if truth.ignored[place]:
                _forgive(asked[index, 0], box)
            else:
                _draw(heat[index, label], asked[index, 0], edges[index, label], weight[index, label], box)
    return Target(
        heat=torch.from_numpy(heat),
        asked=torch.from_numpy(asked),
        edges=torch.from_numpy(edges),
        weight=torch.from_numpy(weight),
    )


def _forgive(asked: _Plane, box: _Plane) -> None:
    left, upper, right, lower = (box / STRIDE).tolist()
    asked[int(upper) : int(np.ceil(lower)), int(left) : int(np.ceil(right))] = 0.0


def _draw(heat: _Plane, asked: _Plane, edges: _Plane, weight: _Plane, box: _Plane) -> None:
    left, upper, right, lower = box.tolist()
    column = min(int(0.5 * (left + right) / STRIDE), ACROSS - 1)
    row = min(int(0.5 * (upper + lower) / STRIDE), DOWN - 1)
    # A shift by a sixth of the size along each axis still leaves an overlap of one half.
    spread = [max(0.6, (high - low) / STRIDE / 6.0) / 1.5 for low, high in ((left, right), (upper, lower))]
    reach = [int(np.ceil(3.0 * sigma)) for sigma in spread]
    columns = np.arange(max(0, column - reach[0]), min(ACROSS, column + reach[0] + 1))
    rows = np.arange(max(0, row - reach[1]), min(DOWN, row + reach[1] + 1))
    across = np.exp(-0.5 * ((columns - column) / spread[0]) ** 2)
    down = np.exp(-0.5 * ((rows - row) / spread[1]) ** 2)
    bump = (down[:, None] * across[None, :]).astype(np.float32)
    window = np.ix_(rows, columns)
    heat[window] = np.maximum(heat[window], bump)
    asked[row, column] = 1.0
    near_rows, near_columns = np.nonzero(bump >= NEAR_MIDDLE)
    y, x = rows[near_rows], columns[near_columns]
    middle_x, middle_y = (x + 0.5) * STRIDE, (y + 0.5) * STRIDE
    edges[:, y, x] = np.stack([middle_x - left, middle_y - upper, right - middle_x, lower - middle_y])
    weight[y, x] = 1.0 / len(y)


def loss_of(heat: Tensor, edges: Tensor, target: Target) -> Tensor:
    """Return how far an answer is from its target; a scalar. Each class counts the same, and each box of a class."""
    heat_loss = _heat_loss(heat, target) / (target.heat == 1.0).sum((0, 2, 3)).clamp(min=1)
    edges_loss = _edges_loss(edges, target) / target.weight.sum((0, 2, 3)).clamp(min=1.0)
    return heat_loss.sum() + EDGES_WEIGHT * edges_loss.sum()


def _heat_loss(logits: Tensor, target: Target) -> Tensor:
    """Return the penalty-reduced focal loss, summed for each class."""
    chance = torch.sigmoid(logits)
    right = torch.nn.functional.logsigmoid(logits)
    wrong = torch.nn.functional.logsigmoid(-logits)
    middle = (target.heat == 1.0).float()
    lost = middle * (1 - chance) ** 2 * right + (1 - middle) * (1 - target.heat) ** 4 * chance**2 * wrong
    return -(lost * target.asked).sum((0, 2, 3))


def _edges_loss(edges: Tensor, target: Target) -> Tensor:
    """Return one minus the generalised overlap, weighted, summed for each class."""
    left, upper, right, lower = edges.unbind(2)
    left_t, upper_t, right_t, lower_t = target.edges.unbind(2)
    across = (torch.minimum(left, left_t) + torch.minimum(right, right_t)).clamp(min=0.0)
    down = (torch.minimum(upper, upper_t) + torch.minimum(lower, lower_t)).clamp(min=0.0)
    shared = across * down
    joined = (left + right) * (upper + lower) + (left_t + right_t) * (upper_t + lower_t) - shared
    around = (torch.maximum(left, left_t) + torch.maximum(right, right_t)) * (
        torch.maximum(upper, upper_t) + torch.maximum(lower, lower_t)
    )
    overlap = shared / joined.clamp(min=1e-6) - (around - joined) / around.clamp(min=1e-6)
    return ((1 - overlap) * target.weight).sum((0, 2, 3))
