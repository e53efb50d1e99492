"""Applies perturbations to frames, in order, each on what the one before it left.

What comes out depends on (frame, perturbations, seed, mode, frame index) alone: every random field is drawn from a
generator that is addressed by (seed, position in the list, frame index), so any frame of an episode can be made
again on its own, in any process. Tables that do not depend on chance (masks, radial profiles, a pool of noise) are
cached by size; they are the same whoever makes them, and whenever.
"""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from brink.sim.perturbations.catalogue import registered_transform
from brink.sim.perturbations.errors import (
    InvalidFrame,
    InvalidPerturbation,
    PerturbationFailed,
    VisionMissing,
)
from brink.sim.perturbations.gene import Frame, Transform
from brink.sim.perturbations.perturbation import Perturbation

MIN_SIDE_PX = 16
STREAM = 100
"""First word of every address, so that no generator is one of the driving world's for the same seed."""


class Mode(StrEnum):
    """How often random fields are drawn."""

    PER_FRAME = "per_frame"
    PER_EPISODE = "per_episode"


def generator(seed: int, position: int, frame: int) -> np.random.Generator:
    """Return the generator of one perturbation in one frame.

    Args:
        seed: The episode's seed, >= 0.
        position: Of the perturbation in its list, from 0.
        frame: Index of the frame, from 0.
    """
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(STREAM, position, frame)))


def apply(frame: Frame, perturbation: Perturbation, rng: np.random.Generator) -> Frame:
    """Return a perturbed frame; the given one is not touched.

    Args:
        frame: RGB, uint8, shape ``(height, width, 3)``, at least 16 px a side; need not be contiguous or writable.
        perturbation: What to do. Level 0 returns `frame` itself.
        rng: Draws the fields of this frame.

    Raises:
        InvalidFrame: `frame` is not such a picture.
        PerturbationFailed: The transform broke; names the gene.
        VisionMissing: OpenCV is not installed here.
    """
    check_frame(frame)
    value = perturbation.value
    if value is None:
        return frame
    transform = _transform(perturbation.gene)
    given = np.ascontiguousarray(frame).view()
    given.flags.writeable = False  # a transform that draws on its input is an error, not a changed original
    try:
        perturbed = transform(given, value, rng)
    except Exception as error:  # (foreign code may raise anything)
        raise PerturbationFailed(f"{perturbation}: {type(error).__name__}: {error}") from error
    if not isinstance(perturbed, np.ndarray) or (perturbed.shape, perturbed.dtype) != (
        given.shape,
        given.dtype,
    ):
        raise PerturbationFailed(
            f"{perturbation}: expected a {given.dtype} frame of shape {given.shape} back, got {_describe(perturbed)}"
        )
    return perturbed


@dataclass(frozen=True, slots=True)
class Pipeline:
    """Perturbs the frames of one episode.

    Attributes:
        perturbations: Applied from the first to the last, each on the result of the one before.
        seed: The episode's seed, >= 0.
        mode: `PER_FRAME` draws the fields of every frame afresh; `PER_EPISODE` draws them once, as if dirt stayed
            where it is on the lens.

    Raises:
        InvalidPerturbation: Something in the list is no perturbation, or the seed is negative.
    """

    perturbations: tuple[Perturbation, ...]
    seed: int
    mode: Mode = Mode.PER_FRAME

    def __post_init__(self) -> None:
        object.__setattr__(self, "perturbations", tuple(self.perturbations))
        object.__setattr__(self, "mode", Mode(self.mode))
        for perturbation in self.perturbations:
            if not isinstance(perturbation, Perturbation):
                raise InvalidPerturbation(
                    f"expected perturbations; parse_perturbations reads {perturbation!r}"
                )
        if self.seed < 0:
            raise InvalidPerturbation(f"seed: expected an integer >= 0, got {self.seed!r}")

    def __call__(self, frame: Frame, index: int) -> Frame:
        """Return the perturbed frame; the given one is not touched.

        Args:
            frame: RGB, uint8, shape ``(height, width, 3)``, at least 16 px a side.
            index: Index of the frame in its episode, from 0.

        Raises:
            InvalidFrame: `frame` is not such a picture.
            PerturbationFailed: A transform broke; names the gene.
            VisionMissing: OpenCV is not installed here.
        """
        check_frame(frame)
        drawn_at = index if self.mode is Mode.PER_FRAME else 0
        for position, perturbation in enumerate(self.perturbations):
            frame = apply(frame, perturbation, generator(self.seed, position, drawn_at))
        return frame


def _transform(name: str) -> Transform:
    own = registered_transform(name)
    if own is not None:
        return own
    try:
        from brink.sim.perturbations.transforms import TRANSFORMS  # loads OpenCV
    except ModuleNotFoundError as error:
        if error.name != "cv2":
            raise
        raise VisionMissing(
            "perturbing pictures needs OpenCV; install it with: "
            ".venv/bin/pip install -c constraints.txt -e '.[vision]'"
        ) from None
    return TRANSFORMS[name]


def check_frame(frame: Frame, where: str = "") -> None:
    """Check that something is a picture that can be perturbed.

    Args:
        frame: What should be RGB, uint8, shape ``(height, width, 3)``, at least 16 px a side.
        where: What the message begins with, such as the name of a file.

    Raises:
        InvalidFrame: It is not.
    """
    if (
        isinstance(frame, np.ndarray)
        and frame.dtype == np.uint8
        and frame.ndim == 3
        and frame.shape[2] == 3
        and min(frame.shape[:2]) >= MIN_SIDE_PX
    ):
        return
    raise InvalidFrame(
        f"{where}expected an RGB picture: uint8, shape (height, width, 3), at least {MIN_SIDE_PX} px a side; "
        f"got {_describe(frame)}"
    )


def _describe(thing: object) -> str:
    if isinstance(thing, np.ndarray):
        return f"a {thing.dtype} array of shape {thing.shape}"
    return f"a {type(thing).__name__}"
