"""The types of a scene: surfaces, buildings, trees, bodies, lights, camera and rendered frame; and their errors.

Lengths are in m, angles in radians counter-clockwise, z points up, and the ground is the plane z = 0. `look` is an
arbitrary integer that selects colours and shape; the same value always gives the same appearance.

SimulatorError
└── RenderingError          base class of all errors
    ├── InvalidScene        final: a body, building or surface cannot be drawn; fix the scene
    └── InvalidCamera       final: the camera's size, position or field of view is impossible
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Final, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from brink.sim.errors import SimulatorError
from brink.sim.plane import Rectangle
from brink.sim.world.scenario import TimeOfDay, Weather

FloatArray: TypeAlias = NDArray[np.float64]
IntArray: TypeAlias = NDArray[np.int32]
Picture: TypeAlias = NDArray[np.uint8]
IdMask: TypeAlias = NDArray[np.int32]

MAX_SIDE_PX = 8192
MAX_ID = 2**31 - 1

Rgb: TypeAlias = tuple[float, float, float]
Coverage: TypeAlias = NDArray[np.uint8]


class Material(StrEnum):
    """Material of a ground surface."""

    ASPHALT = "asphalt"
    PAVEMENT = "pavement"
    GRASS = "grass"
    EARTH = "earth"
    MARKING = "marking"
    CROSSING = "crossing"
    KERB = "kerb"
    GUTTER = "gutter"


class BodyKind(StrEnum):
    """The kind of a body; the last two never occur in ordinary traffic."""

    VEHICLE = "vehicle"
    PERSON = "person"
    FALLEN_TREE = "fallen_tree"
    OVERTURNED_VEHICLE = "overturned_vehicle"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ground:
    """A ground surface; later surfaces cover earlier ones.

    Attributes:
        material: Material of the surface.
        points: Outline, shape ``(k, 2)``, k >= 3; need not be convex.
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
    """A building: an upright box over an oriented rectangle."""

    x_m: float
    y_m: float
    yaw_rad: float
    length_m: float
    width_m: float
    height_m: float
    look: int

    def __post_init__(self) -> None:
        _check_finite("building", x_m=self.x_m, y_m=self.y_m, yaw_rad=self.yaw_rad)
        _check_positive("building", length_m=self.length_m, width_m=self.width_m, height_m=self.height_m)


TRUNK_SHARE: Final = 0.42
"""Height of the crown's lower end, as a share of the tree's height."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Tree:
    """A tree: a trunk and a crown of diameter `crown_m`."""

    x_m: float
    y_m: float
    height_m: float
    crown_m: float
    look: int

    def __post_init__(self) -> None:
        _check_finite("tree", x_m=self.x_m, y_m=self.y_m)
        _check_positive("tree", height_m=self.height_m, crown_m=self.crown_m)


@dataclass(frozen=True, slots=True, kw_only=True)
class Lamp:
    """A street lamp, lit at night. Its arm points along `yaw_rad`."""

    x_m: float
    y_m: float
    yaw_rad: float
    height_m: float = 6.0

    def __post_init__(self) -> None:
        _check_finite("lamp", x_m=self.x_m, y_m=self.y_m, yaw_rad=self.yaw_rad)
        _check_positive("lamp", height_m=self.height_m)


class SignalGroup(StrEnum):
    """The traffic lights of a junction that always show the same."""

    MAIN = "main"
    SIDE = "side"


@dataclass(frozen=True, slots=True, kw_only=True)
class TrafficLight:
    """A traffic light on a post: red, amber and green from top to bottom.

    Attributes:
        group: Decides what it shows.
        x_m: Foot of the post.
        y_m: Foot of the post.
        yaw_rad: Direction that it faces, against the traffic that it is for.
        height_m: Height of its upper end.
    """

    group: SignalGroup
    x_m: float
    y_m: float
    yaw_rad: float
    height_m: float = 3.4

    def __post_init__(self) -> None:
        _check_finite("traffic light", x_m=self.x_m, y_m=self.y_m, yaw_rad=self.yaw_rad)
        _check_positive("traffic light", height_m=self.height_m)


class FurnitureKind(StrEnum):
    """The kind of an item of street furniture."""

    BICYCLE = "bicycle"
    BIN = "bin"
    BOLLARD = "bollard"
    POST_BOX = "post_box"
    SIGN = "sign"
    METER = "meter"
    PLANTER = "planter"
    BENCH = "bench"
    BOARD = "board"


@dataclass(frozen=True, slots=True, kw_only=True)
class Furniture:
    """An item of street furniture, which fills an upright box and has no id and no label."""

    kind: FurnitureKind
    x_m: float
    y_m: float
    yaw_rad: float
    length_m: float
    width_m: float
    height_m: float
    look: int

    def __post_init__(self) -> None:
        where = f"furniture {self.kind}"
        _check_finite(where, x_m=self.x_m, y_m=self.y_m, yaw_rad=self.yaw_rad)
        _check_positive(where, length_m=self.length_m, width_m=self.width_m, height_m=self.height_m)


@dataclass(frozen=True, slots=True, kw_only=True)
class Body:
    """An object with an id. It fills an upright box over an oriented rectangle.

    Attributes:
        id: Positive and unique in an image, parked vehicles included.
        kind: Kind of object.
        x_m: Centre of the footprint.
        y_m: Centre of the footprint.
        yaw_rad: Heading.
        length_m: Extent along the heading.
        width_m: Extent across the heading.
        height_m: Height.
        look: Selects colours and shape.
        phase: Phase of the walk in radians; the feet are together at 0 and pi.
        braking: Whether the brake lights are on.
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
        _check_finite(where, x_m=self.x_m, y_m=self.y_m, yaw_rad=self.yaw_rad, phase=self.phase)
        _check_positive(where, length_m=self.length_m, width_m=self.width_m, height_m=self.height_m)


@dataclass(frozen=True, slots=True, kw_only=True)
class StreetScene:
    """Everything that does not move."""

    ground: tuple[Ground, ...] = ()
    buildings: tuple[Building, ...] = ()
    trees: tuple[Tree, ...] = ()
    parked: tuple[Body, ...] = ()
    lamps: tuple[Lamp, ...] = ()
    traffic_lights: tuple[TrafficLight, ...] = ()
    furniture: tuple[Furniture, ...] = ()

    def __post_init__(self) -> None:
        check_unique_ids(body.id for body in self.parked)


@dataclass(frozen=True, slots=True, kw_only=True)
class Light:
    """Time of day and weather."""

    time_of_day: TimeOfDay
    weather: Weather


@dataclass(frozen=True, slots=True, kw_only=True)
class PictureCamera:
    """A pinhole camera with square pixels and its optical axis in the middle of the image.

    Attributes:
        width_px: Width of the image.
        height_px: Height of the image.
        fov_deg: Horizontal field of view, in (0, 180).
        height_m: Height above the ground.
        forward_m: Distance ahead of the ego's centre.
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
    """Pose of the ego's centre; a positive `pitch_rad` looks up, and its magnitude is at most 0.6."""

    x_m: float
    y_m: float
    yaw_rad: float
    pitch_rad: float = 0.0

    def __post_init__(self) -> None:
        numbers = (self.x_m, self.y_m, self.yaw_rad, self.pitch_rad)
        if not all(math.isfinite(number) for number in numbers) or abs(self.pitch_rad) > 0.6:
            raise InvalidCamera(f"viewpoint: expected finite numbers and |pitch_rad| <= 0.6, got {numbers}")


class Stroke(NamedTuple):
    """A convex polygon of a body, in sixteenths of a pixel; only solid strokes count towards the silhouette."""

    points: IntArray
    rgb: Rgb
    solid: bool


class Stamp(NamedTuple):
    """A textured piece of a body: its position in the image, its pixels, and which of them are opaque."""

    left_px: int
    top_px: int
    pixels: Picture
    coverage: Coverage


Mark: TypeAlias = Stroke | Stamp


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Outline:
    """The marks that a body was painted with; the pixels of its silhouette are counted from them.

    Attributes:
        kind: Kind of body.
        depth_m: Depth of the nearest corner along the camera's axis, at least 0.
        marks: What was painted, in order.
    """

    kind: BodyKind
    depth_m: float
    marks: tuple[Mark, ...]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Frame:
    """A rendered image.

    Attributes:
        image: RGB, shape ``(height, width, 3)``.
        ids: Id of the frontmost body in each pixel, 0 where there is none, shape ``(height, width)``.
        outlines: Outline of each body in view, by id.
    """

    image: Picture
    ids: IdMask
    outlines: Mapping[int, Outline]


def check_unique_ids(ids: Iterable[int]) -> None:
    """Check that no id occurs twice.

    Raises:
        InvalidScene: An id occurs twice.
    """
    seen: set[int] = set()
    for number in ids:
        if number in seen:
            raise InvalidScene(f"bodies: expected unique ids, got {number} twice")
        seen.add(number)


def _check_finite(where: str, **numbers: float) -> None:
    for name, number in numbers.items():
        if not math.isfinite(number):
            raise InvalidScene(f"{where}.{name}: expected a finite number, got {number!r}")


def _check_positive(where: str, **lengths_m: float) -> None:
    for name, length_m in lengths_m.items():
        if not (math.isfinite(length_m) and length_m > 0):
            raise InvalidScene(f"{where}.{name}: expected a positive length, got {length_m!r}")


class RenderingError(SimulatorError):
    """Base class of all errors that the rendering package raises deliberately."""


class InvalidScene(RenderingError):
    """Part of a scene has an impossible size, position or id."""


class InvalidCamera(RenderingError):
    """The camera has an impossible size, position or field of view."""


_MULTIPLIER: Final = 0x9E3779B97F4A7C15
_MASK: Final = (1 << 64) - 1


def choose(look: int, question: int, count: int) -> int:
    """Return a pseudo-random integer in [0, count) that depends only on the look and the question.

    Args:
        look: Selects the value; the same look always gives the same value.
        question: Identifies the choice, so that different choices for the same look are independent.
        count: Number of options.
    """
    mixed = (look * _MULTIPLIER + question * 0xD1B54A32D192ED03 + 0x632BE59BD9B4E019) & _MASK
    mixed ^= mixed >> 31
    mixed = (mixed * 0xBF58476D1CE4E5B9) & _MASK
    mixed ^= mixed >> 29
    return (mixed >> 11) % count


def choose_fraction(look: int, question: int) -> float:
    """Return a pseudo-random number in [0, 1) that depends only on the look and the question."""
    return choose(look, question, 4096) / 4096


def scaled(rgb: Rgb, share: float) -> Rgb:
    """Return a darker colour, or a lighter one if `share` is above 1."""
    return rgb[0] * share, rgb[1] * share, rgb[2] * share


def footprint(x_m: float, y_m: float, yaw_rad: float, length_m: float, width_m: float) -> FloatArray:
    """Return the corners of an oriented rectangle, counter-clockwise.

    Args:
        x_m: Centre.
        y_m: Centre.
        yaw_rad: Heading.
        length_m: Extent along the heading.
        width_m: Extent across the heading.

    Returns:
        Corners, shape ``(4, 2)``.
    """
    return np.array(Rectangle(x_m, y_m, yaw_rad, 0.5 * length_m, 0.5 * width_m).polygon())
