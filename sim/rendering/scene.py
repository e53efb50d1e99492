"""Owns the types of what is drawn: surfaces, buildings, trees, bodies, light, camera and picture.

Lengths in m, angles in radians counter-clockwise, z up; the ground is the plane z = 0. `look` is any integer: it
chooses colours and shape, and the same look always looks the same.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import NDArray

from brink.sim.rendering.errors import InvalidCamera, InvalidScene
from brink.sim.world.scenario import TimeOfDay, Weather

if TYPE_CHECKING:
    from brink.sim.rendering.canvas import Outline

FloatArray: TypeAlias = NDArray[np.float64]
Picture: TypeAlias = NDArray[np.uint8]
IdMask: TypeAlias = NDArray[np.int32]

MAX_SIDE_PX = 8192
MAX_ID = 2**31 - 1


class Material(StrEnum):
    """What the ground is made of."""

    ASPHALT = "asphalt"
    PAVEMENT = "pavement"
    GRASS = "grass"
    EARTH = "earth"
    MARKING = "marking"
    CROSSING = "crossing"
    KERB = "kerb"
    GUTTER = "gutter"


class BodyKind(StrEnum):
    """What a body is; the last two are never met in ordinary traffic."""

    VEHICLE = "vehicle"
    PERSON = "person"
    FALLEN_TREE = "fallen_tree"
    OVERTURNED_VEHICLE = "overturned_vehicle"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ground:
    """A surface of the ground; later ones lie on earlier ones.

    Attributes:
        material: What it is made of.
        points: Its outline, shape ``(k, 2)``, k >= 3; need not be convex.
    """

    material: Material
    points: FloatArray

    def __post_init__(self) -> None:
        if self.points.ndim != 2 or self.points.shape[0] < 3 or self.points.shape[1] != 2:
            raise InvalidScene(f"ground.points: expected shape (k, 2) with k >= 3, got {self.points.shape}")
        if not np.isfinite(self.points).all():
            raise InvalidScene("ground.points: expected finite numbers")


@dataclass(frozen=True, slots=True, kw_only=True)
class Building:
    """A house: an upright box over an oriented rectangle."""

    x_m: float
    y_m: float
    yaw_rad: float
    length_m: float
    width_m: float
    height_m: float
    look: int

    def __post_init__(self) -> None:
        _finite("building", x_m=self.x_m, y_m=self.y_m, yaw_rad=self.yaw_rad)
        _positive("building", length_m=self.length_m, width_m=self.width_m, height_m=self.height_m)


@dataclass(frozen=True, slots=True, kw_only=True)
class Tree:
    """A tree: a trunk, and from about two fifths of its height a crown of diameter `crown_m`."""

    x_m: float
    y_m: float
    height_m: float
    crown_m: float
    look: int

    def __post_init__(self) -> None:
        _finite("tree", x_m=self.x_m, y_m=self.y_m)
        _positive("tree", height_m=self.height_m, crown_m=self.crown_m)


@dataclass(frozen=True, slots=True, kw_only=True)
class Lamp:
    """A street lamp; it shines at night. Its arm points along `yaw_rad`."""

    x_m: float
    y_m: float
    yaw_rad: float
    height_m: float = 6.0

    def __post_init__(self) -> None:
        _finite("lamp", x_m=self.x_m, y_m=self.y_m, yaw_rad=self.yaw_rad)
        _positive("lamp", height_m=self.height_m)


@dataclass(frozen=True, slots=True, kw_only=True)
class Body:
    """Something with an id: it stands in an upright box over an oriented rectangle and fills it.

    Attributes:
        id: Positive, unique in a picture, parked vehicles included.
        kind: What it is.
        x_m: Centre of its footprint.
        y_m: The same.
        yaw_rad: Its heading.
        length_m: Extent along its heading.
        width_m: Extent across its heading.
        height_m: Its height.
        look: Chooses its colours and its shape.
        phase: Of a walk, in radians; 0 and pi stand with closed feet.
        braking: Whether its brake lights burn.
    """

    id: int
    kind: BodyKind
    x_m: float
    y_m: float
    yaw_rad: float
    length_m: float
    width_m: float
    height_m: float
    look: int
    phase: float = 0.0
    braking: bool = False

    def __post_init__(self) -> None:
        if not 0 < self.id <= MAX_ID:
            raise InvalidScene(f"body.id: expected 1 to {MAX_ID}, got {self.id!r}")
        where = f"body {self.id}"
        _finite(where, x_m=self.x_m, y_m=self.y_m, yaw_rad=self.yaw_rad, phase=self.phase)
        _positive(where, length_m=self.length_m, width_m=self.width_m, height_m=self.height_m)


@dataclass(frozen=True, slots=True, kw_only=True)
class StreetScene:
    """All that does not move."""

    ground: tuple[Ground, ...] = ()
    buildings: tuple[Building, ...] = ()
    trees: tuple[Tree, ...] = ()
    parked: tuple[Body, ...] = ()
    lamps: tuple[Lamp, ...] = ()

    def __post_init__(self) -> None:
        check_unique(body.id for body in self.parked)


@dataclass(frozen=True, slots=True, kw_only=True)
class Light:
    """Sun and sky."""

    time_of_day: TimeOfDay
    weather: Weather


@dataclass(frozen=True, slots=True, kw_only=True)
class PictureCamera:
    """A pin-hole camera with square pixels, the optical axis in the middle of the picture.

    Attributes:
        width_px: Width of the picture.
        height_px: Height of the picture.
        fov_deg: Horizontal field of view, in (0, 180).
        height_m: Height above the ground.
        forward_m: How far ahead of the ego's centre it sits.
        focal_px: Focal length, derived.
    """

    width_px: int
    height_px: int
    fov_deg: float = 90.0
    height_m: float = 1.7
    forward_m: float = 1.3
    focal_px: float = field(init=False)

    def __post_init__(self) -> None:
        for name, side_px in (("width_px", self.width_px), ("height_px", self.height_px)):
            if not 1 < side_px <= MAX_SIDE_PX:
                raise InvalidCamera(f"camera.{name}: expected 2 to {MAX_SIDE_PX}, got {side_px!r}")
        if not 0 < self.fov_deg < 180:
            raise InvalidCamera(f"camera.fov_deg: expected an angle in (0, 180), got {self.fov_deg!r}")
        if not (math.isfinite(self.height_m) and self.height_m > 0 and math.isfinite(self.forward_m)):
            raise InvalidCamera(f"camera.height_m: expected a positive length, got {self.height_m!r}")
        object.__setattr__(self, "focal_px", self.width_px / 2 / math.tan(math.radians(self.fov_deg) / 2))


@dataclass(frozen=True, slots=True, kw_only=True)
class Viewpoint:
    """Where the ego's centre is; `pitch_rad` > 0 looks up, at most 0.6 either way."""

    x_m: float
    y_m: float
    yaw_rad: float
    pitch_rad: float = 0.0

    def __post_init__(self) -> None:
        numbers = (self.x_m, self.y_m, self.yaw_rad, self.pitch_rad)
        if not all(math.isfinite(number) for number in numbers) or abs(self.pitch_rad) > 0.6:
            raise InvalidCamera(f"viewpoint: expected finite numbers and |pitch_rad| <= 0.6, got {numbers}")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Frame:
    """What the camera sees.

    Attributes:
        image: RGB, shape ``(height, width, 3)``.
        ids: Id of the body that is frontmost in each pixel, else 0, shape ``(height, width)``.
        outlines: How each body within the view was painted, by id: what `visible_bodies` counts.
    """

    image: Picture
    ids: IdMask
    outlines: Mapping[int, "Outline"]


def check_unique(ids: Iterable[int]) -> None:
    """Refuse ids that occur twice.

    Raises:
        InvalidScene: Names the first of them.
    """
    seen: set[int] = set()
    for number in ids:
        if number in seen:
            raise InvalidScene(f"bodies: expected unique ids, got {number} twice")
        seen.add(number)


def _finite(where: str, **numbers: float) -> None:
    for name, number in numbers.items():
        if not math.isfinite(number):
            raise InvalidScene(f"{where}.{name}: expected a finite number, got {number!r}")


def _positive(where: str, **lengths_m: float) -> None:
    for name, length_m in lengths_m.items():
        if not (math.isfinite(length_m) and length_m > 0):
            raise InvalidScene(f"{where}.{name}: expected a positive length, got {length_m!r}")
