"""Where the parts of a frame lie: header, map, camera, panel, time bar."""

from dataclasses import dataclass
from typing import Final, Self, TypeAlias

from brink.sim.replay.errors import ReplayError

Size: TypeAlias = tuple[int, int]
Rectangle: TypeAlias = tuple[int, int, int, int]
"""Left, top, right, bottom in pixels."""

DEFAULT_SIZE: Final[Size] = (960, 540)
LEAST_SIZE: Final[Size] = (640, 360)
GREATEST_SIZE: Final[Size] = (1920, 1080)


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """The rectangles of a frame, and the unit that text and lines scale with: 1 at 540 px of height."""

    size: Size
    unit: float
    header: Rectangle
    map: Rectangle
    camera: Rectangle
    panel: Rectangle
    time_bar: Rectangle

    @classmethod
    def of(cls, size: Size, *, filmed: bool = False) -> Self:
        """Return the layout of a frame.

        Args:
            size: Width and height of the frame.
            filmed: Whether the camera's picture, 16 to 9, takes the large place and the map the small one.

        Raises:
            ReplayError: The size is out of bounds, or odd (H.264 halves both sides for its colours).
        """
        check_size(size)
        width, height = size
        unit = min(width / DEFAULT_SIZE[0], height / DEFAULT_SIZE[1])
        top, bottom = round(32 * unit), height - round(58 * unit)
        side = width - round(300 * unit)
        gap = round(10 * unit)
        camera_right, camera_top = width - gap, top + gap
        camera_left = side + gap
        camera_bottom = camera_top + round((camera_right - camera_left) * 3 / 4)
        large, small = (0, top, side, bottom), (camera_left, camera_top, camera_right, camera_bottom)
        return cls(
            size=size,
            unit=unit,
            header=(0, 0, width, top),
            map=small if filmed else large,
            camera=(0, top, side, top + round(side * 9 / 16)) if filmed else small,
            panel=(camera_left, camera_bottom + gap, camera_right, bottom),
            time_bar=(0, bottom, width, height),
        )


def check_size(size: Size) -> None:
    """Refuse a frame size that cannot be drawn.

    Raises:
        ReplayError: The size is out of bounds, or odd.
    """
    width, height = size
    if not (LEAST_SIZE[0] <= width <= GREATEST_SIZE[0] and LEAST_SIZE[1] <= height <= GREATEST_SIZE[1]) or (
        width % 2 or height % 2
    ):
        raise ReplayError(
            f"size: expected even numbers of pixels from {LEAST_SIZE[0]}x{LEAST_SIZE[1]} to "
            f"{GREATEST_SIZE[0]}x{GREATEST_SIZE[1]}, got {width}x{height}"
        )


def extent(rectangle: Rectangle) -> Size:
    """Return width and height of a rectangle."""
    left, top, right, bottom = rectangle
    return right - left, bottom - top
