"""Changes to training images that make a detector robust; none is one of the 15 perturbation techniques.

The search must not be able to say more than "the detector was never trained on this". So no perturbation is used in
training, neither by name nor by code. What is used instead changes the geometry of a scene, the camera's response and
the transmission of the image, as in most detectors that are in use. Some of it has an effect that is similar to that
of a perturbation:

=====================  ==============================================================  =======================
augmentation           what it does                                                    resembles
=====================  ==============================================================  =======================
mirror                 left and right are exchanged                                    none
zoom and crop          a section of the image fills it, or it becomes smaller          none
response curve         a monotonic curve with random knots                             brightness, contrast
white balance          gains of the three channels, partly loss of saturation          channel dropout (weakly)
mixed channels         each channel becomes a random mixture of the three              channel dropout
uneven light           a smooth random field darkens and brightens                     brightness, dirty lens
veil                   the image fades locally towards a random colour                 smoke, condensation, flare
shot noise             noise that grows with brightness, in grains of 1 to 3 px        Gaussian noise
compression            JPEG at low quality                                             none
low resolution         the image becomes smaller and large again                       Gaussian blur
camera shake           averages along a short straight path                            Gaussian blur, rain
rolling shutter        rows move sideways in waves, the shortest 2 rows long           shifted pixels
collage                rectangles show pieces of another image                         dropouts
scratches              a few thin curved lines of random colours                       broken lens, rain (weakly)
=====================  ==============================================================  =======================

All functions are pure and take their random numbers from a generator.
"""

from collections.abc import Callable, Sequence
from typing import Final, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from brink.sim.perception.boxes import FloatArray, GroundTruth, too_small

Picture: TypeAlias = NDArray[np.uint8]
Change: TypeAlias = Callable[[Picture, np.random.Generator], Picture]

ZOOM: Final = (0.75, 1.6)
MIN_LEFT: Final = 0.4
"""A box of which cropping leaves a smaller share is ignored."""
COLLAGE_SHARE: Final = 0.25
MAX_COVERED: Final = 0.5
"""A box of which a collage covers a larger share is ignored."""
_PADDING: Final = (115, 115, 115)


def augment(
    picture: Picture, truth: GroundTruth, other: Picture, rng: np.random.Generator, *, unchanged: float = 0.0
) -> tuple[Picture, GroundTruth]:
    """Return a changed image of the same shape, and its ground truth, without boxes outside it.

    Args:
        picture: RGB, uint8, shape ``(h, w, 3)``.
        truth: Ground truth in px of the image.
        other: Another image of the same shape, for the collage.
        rng: Source of randomness.
        unchanged: Share of the images that are only mirrored, zoomed and cropped.
    """
    if rng.random() < 0.5:
        picture, truth = mirror(picture, truth)
    picture, truth = zoom(picture, truth, rng, (picture.shape[1], picture.shape[0]))
    if rng.random() < COLLAGE_SHARE:
        picture, truth = collage(picture, truth, other, rng)
    if rng.random() < unchanged:
        return picture, truth
    for change, chance in _CHANGES:
        if rng.random() < chance:
            picture = change(picture, rng)
    return picture, truth


def mirror(picture: Picture, truth: GroundTruth) -> tuple[Picture, GroundTruth]:
    """Exchange left and right."""
    boxes = truth.boxes.copy()
    boxes[:, [0, 2]] = picture.shape[1] - truth.boxes[:, [2, 0]]
    mirrored = np.ascontiguousarray(picture[:, ::-1])
    return mirrored, GroundTruth(labels=truth.labels, boxes=boxes, ignored=truth.ignored)


def zoom(
    picture: Picture, truth: GroundTruth, rng: np.random.Generator, size_px: tuple[int, int]
) -> tuple[Picture, GroundTruth]:
    """Scale by a random factor, and show a random section of the given width and height.

    Boxes that become too small, or of which little is left, are ignored. The image is 16:9, padded below or not.
    """
    width_px, height_px = size_px
    scale = float(np.exp(rng.uniform(*np.log(ZOOM))))
    shift = rng.random(2) * (np.array(size_px) - scale * np.array(picture.shape[1::-1]))
    # OpenCV maps the centres of pixels, half a pixel from their edges, where boxes end.
    matrix = np.column_stack([scale * np.eye(2), shift + 0.5 * (scale - 1.0)])
    changed = cv2.warpAffine(
        picture,
        matrix,
        (width_px, height_px),
        flags=cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=_PADDING,
    )
    moved = (truth.boxes * np.float32(scale) + np.tile(shift, 2)).astype(np.float32)
    cut = np.clip(moved, 0.0, np.array([width_px, height_px] * 2, np.float32)).astype(np.float32)
    left = _area(cut) / np.maximum(_area(moved), 1e-6)
    inside = left > 0.0
    ignored = truth.ignored | (left < MIN_LEFT) | too_small(cut, picture.shape[1], picture.shape[1] * 9 // 16)
    return changed.astype(np.uint8, copy=False), GroundTruth(
        labels=truth.labels[inside], boxes=cut[inside], ignored=ignored[inside]
    )


def _area(boxes: FloatArray) -> NDArray[np.float64]:
    return np.asarray(np.prod(boxes[:, 2:] - boxes[:, :2], axis=1), np.float64)


def collage(
    picture: Picture, truth: GroundTruth, other: Picture, rng: np.random.Generator
) -> tuple[Picture, GroundTruth]:
    """Show pieces of another image in up to ten rectangles; boxes of which they cover much are ignored.

    The pieces come from the upper sixth of the other image, where there are houses, trees and sky, so that they do
    not bring unlabelled bodies along.
    """
    height_px, width_px = picture.shape[:2]
    changed = picture.copy()
    covered = np.zeros((height_px, width_px), np.uint8)
    pieces = int(rng.integers(1, 11))
    for _ in range(pieces):
        wide = int(rng.integers(4, width_px // (3 + pieces)))
        high = int(rng.integers(4, other.shape[0] // 6))
        x, y = int(rng.integers(width_px - wide)), int(rng.integers(height_px - high))
        from_x = int(rng.integers(width_px - wide))
        changed[y : y + high, x : x + wide] = other[:high, from_x : from_x + wide]
        covered[y : y + high, x : x + wide] = 1
    shares = [
        float(covered[y : max(y + 1, end_y), x : max(x + 1, end_x)].mean())
        for x, y, end_x, end_y in np.minimum(
            truth.boxes.astype(int), [width_px - 1, height_px - 1, width_px, height_px]
        ).tolist()
    ]
    hidden = truth.ignored | (np.array(shares, np.float64) > MAX_COVERED)
    return changed, GroundTruth(labels=truth.labels, boxes=truth.boxes, ignored=hidden)


def response_curve(picture: Picture, rng: np.random.Generator) -> Picture:
    """Apply a monotonic curve through random knots to all channels; its ends move as well."""
    steps = rng.uniform(0.1, 1.0, 5) ** rng.uniform(0.5, 2.0)
    reach = rng.uniform(0.35, 1.0)
    floor = rng.uniform(0.0, 1.0 - reach)
    knots = floor + reach * np.concatenate([[0.0], np.cumsum(steps) / steps.sum()])
    curve = np.interp(np.linspace(0.0, 1.0, 256), np.linspace(0.0, 1.0, 6), knots)
    if rng.random() < 0.35:  # the bright end saturates
        curve = 1.0 - (1.0 - curve) ** float(np.exp(rng.uniform(0.2, 1.8)))
    return np.asarray(cv2.LUT(picture, np.round(255.0 * curve).astype(np.uint8)), np.uint8)


def white_balance(picture: Picture, rng: np.random.Generator) -> Picture:
    """Multiply the channels by random gains, and take away some of the saturation."""
    gains = np.diag(np.exp(rng.normal(0.0, 0.15, 3)))
    grey = rng.uniform(0.0, 0.8) if rng.random() < 0.5 else 0.0
    return _mix(picture, (1.0 - grey) * gains + grey * np.full((3, 3), 1.0 / 3.0))


def mixed_channels(picture: Picture, rng: np.random.Generator) -> Picture:
    """Replace each channel by a random mixture of the three; its weights may be negative, and need not sum to 1."""
    mixture = rng.dirichlet(np.full(3, 0.5), 3) * rng.uniform(0.05, 1.2, (3, 1))
    return _mix(picture, mixture + rng.normal(0.0, 0.1, (3, 3)))


def _mix(picture: Picture, matrix: NDArray[np.floating]) -> Picture:
    return np.asarray(cv2.transform(picture, matrix.astype(np.float32)), np.uint8)


def _field(shape: tuple[int, ...], cells: int, rng: np.random.Generator) -> FloatArray:
    """Return a smooth random field in [0, 1], shape ``(h, w)``."""
    coarse = rng.random((cells, cells + 2)).astype(np.float32)
    return np.asarray(cv2.resize(coarse, (shape[1], shape[0]), interpolation=cv2.INTER_LINEAR), np.float32)


def uneven_light(picture: Picture, rng: np.random.Generator) -> Picture:
    """Multiply by a smooth random field."""
    field = _field(picture.shape, int(rng.integers(2, 9)), rng)
    strength = rng.uniform(0.3, 1.6)
    gain = np.exp(strength * (field - rng.uniform(0.3, 0.7)))
    return _clip(picture * gain[:, :, None])


def veil(picture: Picture, rng: np.random.Generator) -> Picture:
    """Fade locally towards a colour, by a smooth random field."""
    field = _field(picture.shape, int(rng.integers(2, 12)), rng)
    share = np.clip(rng.uniform(-0.2, 0.25) + rng.uniform(0.2, 0.9) * field, 0.0, 0.9)[:, :, None]
    colour = np.clip(rng.choice([60.0, 140.0, 215.0, 245.0]) + rng.normal(0.0, 15.0, 3), 0.0, 255.0)
    return _clip(picture * (1.0 - share) + (colour * share).astype(np.float32))


def shot_noise(picture: Picture, rng: np.random.Generator) -> Picture:
    """Add noise with a spread that grows with the square root of brightness, in grains of 1 to 3 px."""
    height_px, width_px = picture.shape[:2]
    grain = int(rng.integers(1, 4))
    channels = 3 if rng.random() < 0.7 else 1
    coarse = rng.standard_normal((-(-height_px // grain), -(-width_px // grain), channels), np.float32)
    field = cv2.resize(coarse, (width_px, height_px), interpolation=cv2.INTER_LINEAR)
    strength = float(np.exp(rng.uniform(np.log(0.3), np.log(7.0))))
    spread = strength * np.sqrt(picture.astype(np.float32) + 20.0)
    return _clip(picture + spread * field.reshape(height_px, width_px, channels))


def compression(picture: Picture, rng: np.random.Generator) -> Picture:
    """Compress as JPEG at low quality."""
    _, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(5, 50))])
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), np.uint8)


def low_resolution(picture: Picture, rng: np.random.Generator) -> Picture:
    """Shrink the image by up to a factor of seven, and enlarge it again."""
    height_px, width_px = picture.shape[:2]
    factor = float(np.exp(rng.uniform(np.log(1.3), np.log(7.0))))
    size = max(8, round(width_px / factor)), max(8, round(height_px / factor))
    small = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    how = cv2.INTER_CUBIC if rng.random() < 0.8 else cv2.INTER_NEAREST
    return np.asarray(cv2.resize(small, (width_px, height_px), interpolation=how), np.uint8)


def camera_shake(picture: Picture, rng: np.random.Generator) -> Picture:
    """Average along a straight path of 3 to 15 px."""
    reach = int(rng.integers(1, 8))
    angle = rng.uniform(0.0, np.pi)
    kernel = np.zeros((2 * reach + 1, 2 * reach + 1), np.float32)
    end = np.round(reach * np.array([np.cos(angle), np.sin(angle)])).astype(int)
    cv2.line(
        kernel, (reach - int(end[0]), reach - int(end[1])), (reach + int(end[0]), reach + int(end[1])), 1.0
    )
    return np.asarray(cv2.filter2D(picture, -1, kernel / kernel.sum()), np.uint8)


def rolling_shutter(picture: Picture, rng: np.random.Generator) -> Picture:
    """Move rows sideways by a sum of two waves of their height.

    The waves are short, or low, so that bodies stay within their boxes: up to 5 px at a length of up to 12 px, and up
    to .6 px at a length of up to 80 px.
    """
    height_px, width_px = picture.shape[:2]
    rows = np.arange(height_px, dtype=np.float32)
    shift = np.zeros(height_px, np.float32)
    for shortest_px, longest_px, most_px in ((2.0, 12.0, 5.0), (12.0, 80.0, 0.6)):
        wave_px = float(np.exp(rng.uniform(np.log(shortest_px), np.log(longest_px))))
        wave = np.sin(2.0 * np.pi * (rows / wave_px + rng.random()))
        shift += (rng.uniform(0.0, most_px) * wave).astype(np.float32)
    columns = np.arange(width_px, dtype=np.float32)
    across = np.ascontiguousarray(columns[None, :] + shift[:, None])
    down = np.ascontiguousarray(np.broadcast_to(rows[:, None], across.shape))
    changed = cv2.remap(picture, across, down, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(changed, np.uint8)


def scratches(picture: Picture, rng: np.random.Generator) -> Picture:
    """Draw a few thin curved lines of random colours, half transparent."""
    height_px, width_px = picture.shape[:2]
    drawn = picture.copy()
    for _ in range(int(rng.integers(2, 14))):
        start = rng.random(2) * (width_px, height_px)
        bends = np.cumsum(rng.normal(0.0, 12.0, (6, 2)) + rng.normal(0.0, 25.0, 2), axis=0)
        colour = tuple(float(value) for value in rng.uniform(0.0, 255.0) + rng.normal(0.0, 15.0, 3))
        points = np.round(start + bends).astype(np.int32)
        cv2.polylines(drawn, [points], isClosed=False, color=colour, thickness=int(rng.integers(1, 3)))
    share = float(rng.uniform(0.3, 1.0))
    return np.asarray(cv2.addWeighted(drawn, share, picture, 1.0 - share, 0.0), np.uint8)


def _clip(values: NDArray[np.floating]) -> Picture:
    return np.asarray(np.clip(values, 0.0, 255.0), np.uint8)


_CHANGES: Final[Sequence[tuple[Change, float]]] = (
    (white_balance, 0.4),
    (mixed_channels, 0.15),
    (uneven_light, 0.25),
    (veil, 0.3),
    (rolling_shutter, 0.12),
    (scratches, 0.2),
    (low_resolution, 0.2),
    (camera_shake, 0.12),
    (response_curve, 0.5),
    (shot_noise, 0.35),
    (compression, 0.15),
)
"""Changes of appearance in the order in which they are applied, and how often each is applied."""
