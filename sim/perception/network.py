"""The network of `brink-det@1`: anchor-free, a heat map of box centres and the distances to the four edges.

About half a million parameters, for pictures of 320 x 192. Every cell of a grid at a quarter of the picture's
resolution says, for each class, how likely the middle of a box lies in it, and how far away that box's edges are.

Sources of the parts: centres as points (Zhou et al. 2019, "Objects as Points"), distances to the edges (Tian et al.
2019, "FCOS"), residual blocks and a feature pyramid.
"""

from typing import Final

import torch
from torch import Tensor, nn

STRIDE: Final = 4
CLASSES: Final = ("vehicle", "person")
WIDTHS: Final = (16, 24, 48, 96)
HEAD: Final = 32
RARE: Final = -4.0
"""First bias of the heat map: a centre in few cells."""


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
    """Takes pictures, shape ``(n, 3, h, w)`` with h and w divisible by 32, RGB in [0, 1].

    Gives the heat map's logits, shape ``(n, classes, h / 4, w / 4)``, and the distances from each cell's middle to
    the left, upper, right and lower edge, in px, of a box of each class, shape ``(n, classes, 4, h / 4, w / 4)``.
    """

    def __init__(self) -> None:
        super().__init__()
        first, second, third, fourth = WIDTHS
        self.stem = _conv(3, first, stride=2)
        self.quarter = nn.Sequential(_conv(first, second, stride=2), _Residual(second))
        self.eighth = nn.Sequential(_conv(second, third, stride=2), _Residual(third), _Residual(third))
        self.sixteenth = nn.Sequential(_conv(third, fourth, stride=2), _Residual(fourth), _Residual(fourth))
        self.down_fourth = _conv(fourth, third, size=1)
        self.join_eighth = _conv(third, third)
        self.down_third = _conv(third, HEAD, size=1)
        self.lateral = _conv(second, HEAD, size=1)
        self.join_quarter = _conv(HEAD, HEAD)
        self.heat = nn.Sequential(_conv(HEAD, HEAD), nn.Conv2d(HEAD, len(CLASSES), 1))
        self.box = nn.Sequential(_conv(HEAD, HEAD), nn.Conv2d(HEAD, 4 * len(CLASSES), 1))
        last = self.heat[-1]
        assert isinstance(last, nn.Conv2d)
        assert last.bias is not None
        nn.init.constant_(last.bias, RARE)

    def forward(self, pictures: Tensor) -> tuple[Tensor, Tensor]:
        """Return heat map and edges."""
        quarter = self.quarter(self.stem(pictures - 0.45))
        eighth = self.eighth(quarter)
        sixteenth = self.sixteenth(eighth)
        wide = self.join_eighth(eighth + _doubled(self.down_fourth(sixteenth)))
        fine = self.join_quarter(self.lateral(quarter) + _doubled(self.down_third(wide)))
        return self.heat(fine), _edges(self.box(fine))


def _edges(box: Tensor) -> Tensor:
    """Return the distances to the edges of boxes given by the shift of their middle and the logarithm of their size.

    A box narrower than a cell need not hold the cell's middle: distances may be negative.
    """
    count, _, down, across = box.shape
    box = box.reshape(count, len(CLASSES), 4, down, across)
    shift, size = box[:, :, :2], box[:, :, 2:]
    half = torch.exp(torch.clamp(size, -3.0, 3.0)) * (3.0 * STRIDE)
    return torch.cat((half - STRIDE * shift, half + STRIDE * shift), dim=2)


def _doubled(x: Tensor) -> Tensor:
    return nn.functional.interpolate(x, scale_factor=2.0, mode="nearest")
