"""Applies an ordered list of perturbations to frames, each to the result of the previous one.

The result depends only on (frame, perturbations, seed, mode, frame index). Every random field is drawn from a
generator addressed by (seed, gene, frame index), so any frame of an episode can be reproduced on its own, in any
process. A gene has the same field alone, after another gene and before it: what differs between a list and its parts,
or between two orders, is due to the genes. A gene that is listed again has another field each time. Deterministic
tables (masks, radial profiles, a pool of noise) are cached by size.
"""

import zlib
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from numbers import Integral
from typing import Self

import numpy as np

from brink.extras import install_command
from brink.sim.episode import Json, JsonObject
from brink.sim.perturbations.catalogue import (
    Frame,
    InvalidFrame,
    InvalidPerturbation,
    PerturbationFailed,
    Transform,
    VisionMissing,
    find_gene,
    find_registered_transform,
)


@dataclass(frozen=True, slots=True)
class Perturbation:
    """One gene at one level.

    Attributes:
        gene: Name of the gene.
        level: Index of the level; 0 has no effect.

    Raises:
        InvalidPerturbation: The gene or the level does not exist.
    """

    gene: str
    level: int

    def __post_init__(self) -> None:
        if not isinstance(self.gene, str):
            raise InvalidPerturbation(f"gene: expected the name of a perturbation, got {self.gene!r}")
        level: object = self.level
        if not isinstance(level, bool) and isinstance(level, Integral):
            object.__setattr__(self, "level", int(level))  # numpy integers cannot be written as JSON
        find_gene(self.gene).check_level(self.level)

    def __str__(self) -> str:
        return f"{self.gene}:{self.level}"

    @property
    def value(self) -> float | None:
        """The parameter of the level, or None for level 0."""
        return find_gene(self.gene).value(self.level)

    @property
    def intensity(self) -> float:
        """The relative rank of the level, in [0, 1]."""
        return find_gene(self.gene).intensity(self.level)

    def to_json(self) -> JsonObject:
        """Return the perturbation as a JSON object."""
        return {"gene": self.gene, "level": self.level}

    @classmethod
    def from_json(cls, document: Json) -> Self:
        """Parse a perturbation from ``{"gene": "smoke", "level": 3}``.

        Raises:
            InvalidPerturbation: The document has another form, or the gene or level does not exist.
        """
        if not isinstance(document, Mapping) or set(document) != {"gene", "level"}:
            raise InvalidPerturbation(
                f'expected a perturbation such as {{"gene": "smoke", "level": 3}}, got {document!r}'
            )
        return cls(document["gene"], document["level"])  # type: ignore[arg-type]  # checked on construction

    @classmethod
    def parse(cls, text: str) -> Self:
        """Parse a perturbation from ``gene:level``, such as ``smoke:3``.

        Raises:
            InvalidPerturbation: The text has another form, or the gene or level does not exist.
        """
        gene, _, level = text.partition(":")
        if not level.isdecimal():
            raise InvalidPerturbation(f"expected a perturbation such as smoke:3, got {text!r}")
        return cls(gene, int(level))


def parse_perturbations(items: Iterable[Json]) -> tuple[Perturbation, ...]:
    """Parse an ordered list of perturbations, each ``gene:level`` or an object with ``gene`` and ``level``.

    Raises:
        InvalidPerturbation: An item is invalid; the message gives its position.
    """
    parsed = []
    for place, item in enumerate(items):
        try:
            parsed.append(Perturbation.parse(item) if isinstance(item, str) else Perturbation.from_json(item))
        except InvalidPerturbation as error:
            raise InvalidPerturbation(f"perturbations[{place}]: {error}") from None
    return tuple(parsed)


MIN_SIDE_PX = 16
STREAM = 100
"""First word of every generator's address; keeps these generators apart from those of the driving world."""


class Mode(StrEnum):
    """How often random fields are drawn."""

    PER_FRAME = "per_frame"
    PER_EPISODE = "per_episode"


def field_of(gene: str, occurrence: int = 0) -> int:
    """Return the number of a gene's random field.

    Args:
        gene: Name of the gene.
        occurrence: How many times the same list contains the gene before, from 0.
    """
    return zlib.crc32(f"{gene} {occurrence}".encode())


def generator(seed: int, field: int, frame: int) -> np.random.Generator:
    """Return the random generator for one perturbation in one frame.

    Args:
        seed: The episode's seed, >= 0.
        field: Number of the random field, >= 0, as `field_of` returns it.
        frame: Index of the frame, from 0.

    Raises:
        InvalidPerturbation: One of them is not an integer >= 0.
    """
    for name, word in (("seed", seed), ("field", field), ("frame", frame)):
        if not _is_index(word):
            raise InvalidPerturbation(f"{name}: expected an integer >= 0, got {word!r}")
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(STREAM, field, frame)))


def apply(frame: Frame, perturbation: Perturbation, rng: np.random.Generator) -> Frame:
    """Return a perturbed copy of a frame.

    Args:
        frame: RGB, uint8, shape ``(height, width, 3)``, at least 16 px a side; need not be contiguous or writable.
        perturbation: The gene and level to apply; level 0 returns `frame` itself.
        rng: Draws the random fields of this frame.

    Raises:
        InvalidFrame: `frame` is not such an image.
        PerturbationFailed: The transform raised, or did not return such an image; the message names the gene.
        VisionMissing: OpenCV is not installed.
    """
    check_frame(frame)
    value = perturbation.value
    if value is None:
        return frame
    transform = _transform(perturbation.gene)
    given = np.ascontiguousarray(frame).view()
    given.flags.writeable = False  # writing to the input raises instead of changing the caller's frame
    try:
        perturbed = transform(given, value, rng)
    except Exception as error:  # registered transforms may raise anything
        raise PerturbationFailed(f"{perturbation}: {type(error).__name__}: {error}") from error
    if not isinstance(perturbed, np.ndarray) or (perturbed.shape, perturbed.dtype) != (
        given.shape,
        given.dtype,
    ):
        raise PerturbationFailed(
            f"{perturbation}: expected a {given.dtype} frame of shape {given.shape} from the transform, "
            f"got {_describe(perturbed)}"
        )
    return perturbed


@dataclass(frozen=True, slots=True)
class Pipeline:
    """Perturbs the frames of one episode.

    Attributes:
        perturbations: Applied in order, each to the result of the previous one.
        seed: The episode's seed, >= 0.
        mode: `PER_FRAME` draws random fields for every frame; `PER_EPISODE` draws them once, so dirt on the lens
            stays in place.

    Raises:
        InvalidPerturbation: An item is not a perturbation, or the seed is not an integer >= 0.
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
                    f"expected Perturbation objects, got {perturbation!r}; use parse_perturbations for other forms"
                )
        if not _is_index(self.seed):
            raise InvalidPerturbation(f"seed: expected an integer >= 0, got {self.seed!r}")

    def __call__(self, frame: Frame, index: int) -> Frame:
        """Return a perturbed copy of a frame.

        Args:
            frame: RGB, uint8, shape ``(height, width, 3)``, at least 16 px a side.
            index: Index of the frame in its episode, from 0.

        Raises:
            InvalidFrame: `frame` is not such an image, or `index` is not an integer >= 0.
            PerturbationFailed: A transform raised, or did not return such an image; the message names the gene.
            VisionMissing: OpenCV is not installed.
        """
        check_frame(frame)
        if not _is_index(index):
            raise InvalidFrame(f"index: expected the index of a frame, an integer >= 0, got {index!r}")
        drawn_at = index if self.mode is Mode.PER_FRAME else 0
        occurrences: Counter[str] = Counter()
        for perturbation in self.perturbations:
            field = field_of(perturbation.gene, occurrences[perturbation.gene])
            occurrences[perturbation.gene] += 1
            frame = apply(frame, perturbation, generator(self.seed, field, drawn_at))
        return frame


def _is_index(value: object) -> bool:
    return isinstance(value, int | np.integer) and not isinstance(value, bool) and int(value) >= 0


def _transform(name: str) -> Transform:
    own = find_registered_transform(name)
    if own is not None:
        return own
    try:
        from brink.sim.perturbations.transforms import TRANSFORMS
    except ModuleNotFoundError as error:
        if error.name != "cv2":
            raise
        raise VisionMissing(
            f"perturbing images needs OpenCV; install it with: {install_command('vision')}"
        ) from None
    return TRANSFORMS[name]


def check_frame(frame: Frame, where: str = "") -> None:
    """Check that an object is an image that can be perturbed.

    Args:
        frame: Should be RGB, uint8, shape ``(height, width, 3)``, at least 16 px a side.
        where: Prefix of the message, such as a file name.

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
        f"{where}expected an RGB image: uint8, shape (height, width, 3), at least {MIN_SIDE_PX} px a side; "
        f"got {_describe(frame)}"
    )


def _describe(thing: object) -> str:
    if isinstance(thing, np.ndarray):
        return f"a {thing.dtype} array of shape {thing.shape}"
    return f"a {type(thing).__name__}"
