"""The network of `brink-det@2`, its training targets and its loss.

The network is anchor-free and has about a million parameters, for images of 448 x 256. Beside the image it sees
two planes computed from the brightness: its logarithm, and the logarithm normalised by mean and spread in the
surroundings, which changes little with exposure, haze and uneven light. For each cell of a grid at a quarter of the
image's resolution and each class, it predicts how likely the cell is to hold a box centre, and the distances to the
four edges of that box.

The heat map's target is a Gaussian around each box centre, as wide as the shift that leaves a box an IoU of 0.5
with itself. Edges are trained in the cells near a centre. Cells inside ignored boxes are not trained.

Sources: Zhou et al. 2019, "Objects as Points" (centres, penalty-reduced focal loss); Tian et al. 2019, "FCOS"
(distances to the edges); Rezatofighi et al. 2019 (generalised IoU).
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import torch
from torch import Tensor, nn

from brink.sim.perception.boxes import FloatArray, GroundTruth
from brink.sim.perception.detector import LABELS, STRIDE

WIDTHS: Final = (24, 32, 64, 128)
HEAD_WIDTH: Final = 48
PLANES: Final = 5
"""Red, green, blue, logarithm of the brightness, locally normalised logarithm."""
SURROUNDINGS_PX: Final = 8
"""Mean and spread are taken over squares of three times this side."""
INITIAL_HEAT: Final = -4.0
"""Initial bias of the heat map, because few cells hold a centre."""
EDGES_FROM_HEAT: Final = 0.6
"""Edges are trained in cells with at least this heat."""
EDGES_WEIGHT: Final = 3.0


def _conv(inward: int, outward: int, *, stride: int = 1, size: int = 3) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(inward, outward, size, stride=stride, padding=size // 2, bias=False),
        nn.BatchNorm2d(outward),
        nn.ReLU(inplace=True),
    )


class _Residual(nn.Module):
    def __init__(self, width: int) -> None:
        super().__init__()
        self.first = _conv(width, width)
        self.second = nn.Sequential(nn.Conv2d(width, width, 3, padding=1, bias=False), nn.BatchNorm2d(width))

    def forward(self, x: Tensor) -> Tensor:
        return torch.relu(x + self.second(self.first(x)))


class Network(nn.Module):
    """The detection network.

    Takes images, shape ``(n, 3, h, w)`` with h and w divisible by 32, RGB in [0, 1]. Returns the logits of the
    heat map, shape ``(n, classes, h / 4, w / 4)``, and the distances in px from each cell's centre to the left,
    upper, right and lower edge of a box of each class, shape ``(n, classes, 4, h / 4, w / 4)``.
    """

    def __init__(self) -> None:
        super().__init__()
        first, second, third, fourth = WIDTHS
        self.register_buffer(
            "brightness_weights", torch.tensor([0.299, 0.587, 0.114]).reshape(1, 3, 1, 1), persistent=False
        )
        self.stem = _conv(PLANES, first, stride=2)
        self.quarter = nn.Sequential(_conv(first, second, stride=2), _Residual(second))
        self.eighth = nn.Sequential(_conv(second, third, stride=2), _Residual(third), _Residual(third))
        self.sixteenth = nn.Sequential(_conv(third, fourth, stride=2), _Residual(fourth), _Residual(fourth))
        self.down_fourth = _conv(fourth, third, size=1)
        self.join_eighth = _conv(third, third)
        self.down_third = _conv(third, HEAD_WIDTH, size=1)
        self.lateral = _conv(second, HEAD_WIDTH, size=1)
        self.join_quarter = _conv(HEAD_WIDTH, HEAD_WIDTH)
        self.heat = nn.Sequential(_conv(HEAD_WIDTH, HEAD_WIDTH), nn.Conv2d(HEAD_WIDTH, len(LABELS), 1))
        self.box = nn.Sequential(_conv(HEAD_WIDTH, HEAD_WIDTH), nn.Conv2d(HEAD_WIDTH, 4 * len(LABELS), 1))
        last = self.heat[-1]
        assert isinstance(last, nn.Conv2d)
        assert last.bias is not None
        nn.init.constant_(last.bias, INITIAL_HEAT)

    def forward(self, pictures: Tensor) -> tuple[Tensor, Tensor]:
        """Return the heat map and the edges."""
        quarter = self.quarter(self.stem(self._with_brightness(pictures)))
        eighth = self.eighth(quarter)
        sixteenth = self.sixteenth(eighth)
        wide = self.join_eighth(eighth + _upsample(self.down_fourth(sixteenth)))
        fine = self.join_quarter(self.lateral(quarter) + _upsample(self.down_third(wide)))
        return self.heat(fine), _edges(self.box(fine))

    def _with_brightness(self, pictures: Tensor) -> Tensor:
        """Return the image with its brightness and its normalised brightness, shape ``(n, 5, h, w)``."""
        brightness = torch.log((pictures * self.get_buffer("brightness_weights")).sum(1, keepdim=True) + 0.03)
        mean, square = _surroundings(brightness), _surroundings(brightness * brightness)
        spread = torch.sqrt((square - mean * mean).clamp(min=0.0) + 0.01)
        normalised = (brightness - mean) / spread
        return torch.cat((pictures - 0.45, 0.3 * (brightness + 1.2), 0.5 * normalised), dim=1)


def _surroundings(plane: Tensor) -> Tensor:
    """Return the mean over each pixel's surroundings, shape ``(n, 1, h, w)``."""
    coarse = nn.functional.avg_pool2d(plane, SURROUNDINGS_PX)
    smooth = nn.functional.avg_pool2d(coarse, 3, stride=1, padding=1, count_include_pad=False)
    return nn.functional.interpolate(
        smooth, scale_factor=float(SURROUNDINGS_PX), mode="bilinear", align_corners=False
    )


def _edges(box: Tensor) -> Tensor:
    """Convert centre offsets and log sizes to distances from the cell's centre to the box edges.

    A box narrower than a cell need not contain the cell's centre, so distances may be negative.
    """
    count, _, down, across = box.shape
    box = box.reshape(count, len(LABELS), 4, down, across)
    shift, size = box[:, :, :2], box[:, :, 2:]
    half = torch.exp(torch.clamp(size, -3.0, 3.0)) * (3.0 * STRIDE)
    return torch.cat((half - STRIDE * shift, half + STRIDE * shift), dim=2)


def _upsample(x: Tensor) -> Tensor:
    return nn.functional.interpolate(x, scale_factor=2.0, mode="nearest")


@dataclass(frozen=True, slots=True, kw_only=True)
class Target:
    """Training target for a batch.

    Attributes:
        heat: In [0, 1], 1 at box centres, shape ``(n, classes, h, w)``.
        heat_mask: 1 where the heat map is trained, 0 elsewhere, shape ``(n, 1, h, w)``.
        edges: Distances to the left, upper, right and lower edge in px, shape ``(n, classes, 4, h, w)``.
        weight: Weight of each cell's edges, shape ``(n, classes, h, w)``; the weights of a box sum to 1.
    """

    heat: Tensor
    heat_mask: Tensor
    edges: Tensor
    weight: Tensor

    def to(self, device: torch.device) -> "Target":
        """Return the target on a device."""
        return Target(
            heat=self.heat.to(device),
            heat_mask=self.heat_mask.to(device),
            edges=self.edges.to(device),
            weight=self.weight.to(device),
        )


def make_target(truths: list[GroundTruth], size_px: tuple[int, int]) -> Target:
    """Return the training target for a batch with this ground truth.

    Args:
        truths: Boxes in px of the network's input.
        size_px: Width and height of the network's input.
    """
    count, classes = len(truths), len(LABELS)
    across, down = size_px[0] // STRIDE, size_px[1] // STRIDE
    heat = np.zeros((count, classes, down, across), np.float32)
    heat_mask = np.ones((count, 1, down, across), np.float32)
    edges = np.zeros((count, classes, 4, down, across), np.float32)
    weight = np.zeros((count, classes, down, across), np.float32)
    for index, truth in enumerate(truths):
        for box in truth.boxes[
            truth.ignored
        ]:  # first, because the centre of a box counts in an ignored one, too
            _mask_ignored(heat_mask[index, 0], box)
        sizes = np.prod(truth.boxes[:, 2:] - truth.boxes[:, :2], axis=1)
        # Small boxes come last, because they win the cells that they share with larger ones.
        for place in np.argsort(-sizes, kind="stable").tolist():
            if truth.ignored[place]:
                continue
            box, label = truth.boxes[place], truth.labels[place]
            _draw_box(heat[index, label], heat_mask[index, 0], edges[index, label], weight[index, label], box)
    return Target(
        heat=torch.from_numpy(heat),
        heat_mask=torch.from_numpy(heat_mask),
        edges=torch.from_numpy(edges),
        weight=torch.from_numpy(weight),
    )


def _mask_ignored(heat_mask: FloatArray, box: FloatArray) -> None:
    left, upper, right, lower = (box / STRIDE).tolist()
    heat_mask[int(upper) : int(np.ceil(lower)), int(left) : int(np.ceil(right))] = 0.0


def _draw_box(
    heat: FloatArray, heat_mask: FloatArray, edges: FloatArray, weight: FloatArray, box: FloatArray
) -> None:
    left, upper, right, lower = box.tolist()
    end_row, end_column = heat.shape
    column = min(int(0.5 * (left + right) / STRIDE), end_column - 1)
    row = min(int(0.5 * (upper + lower) / STRIDE), end_row - 1)
    # A shift by a sixth of the size along each axis still leaves an IoU of 0.5.
    spread = [max(0.6, (high - low) / STRIDE / 6.0) / 1.5 for low, high in ((left, right), (upper, lower))]
    reach = [int(np.ceil(3.0 * sigma)) for sigma in spread]
    columns = np.arange(max(0, column - reach[0]), min(end_column, column + reach[0] + 1))
    rows = np.arange(max(0, row - reach[1]), min(end_row, row + reach[1] + 1))
    across = np.exp(-0.5 * ((columns - column) / spread[0]) ** 2)
    down = np.exp(-0.5 * ((rows - row) / spread[1]) ** 2)
    bump = (down[:, None] * across[None, :]).astype(np.float32)
    window = np.ix_(rows, columns)
    heat[window] = np.maximum(heat[window], bump)
    heat_mask[row, column] = 1.0
    near_rows, near_columns = np.nonzero(bump >= EDGES_FROM_HEAT)
    y, x = rows[near_rows], columns[near_columns]
    middle_x, middle_y = (x + 0.5) * STRIDE, (y + 0.5) * STRIDE
    edges[:, y, x] = np.stack([middle_x - left, middle_y - upper, right - middle_x, lower - middle_y])
    weight[y, x] = 1.0 / len(y)


def detection_loss(heat: Tensor, edges: Tensor, target: Target) -> Tensor:
    """Return the scalar loss of an output; all classes have equal weight, as do all boxes of a class.

    Args:
        heat: Logits, shape ``(n, classes, h, w)``.
        edges: Distances in px, shape ``(n, classes, 4, h, w)``.
        target: Training target.
    """
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
    return -(lost * target.heat_mask).sum((0, 2, 3))


def _edges_loss(edges: Tensor, target: Target) -> Tensor:
    """Return one minus the generalised IoU, weighted and summed for each class."""
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
