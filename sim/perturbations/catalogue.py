"""The catalogue: 15 published genes with 175 levels, registered genes, and the package's errors.

A gene is a perturbation technique with numbered levels. This module is plain data and does not import OpenCV, so a
coordinator can build a search space of genes that only workers can apply.

SimulatorError
└── PerturbationError
    ├── InvalidPerturbation  final, also an InvalidEpisode: unknown gene or level; fix the specification
    ├── InvalidFrame         the input is not an RGB uint8 image, or its index is not an integer >= 0
    ├── PerturbationFailed   a transform raised, or did not return an image; names the gene
    └── VisionMissing        OpenCV is not installed

Source: Ferreira et al. 2022, table I. Two of its levels have no effect and are replaced (docs/adr/0022): snow 1,
which scales lightness by 1, and blur 1, whose kernel is one pixel. Snow also falls. Pixel sizes
refer to frames 720 px high.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from brink.sim.errors import InvalidEpisode, SimulatorError


class PerturbationError(SimulatorError):
    """Base class of all errors that the perturbations package raises deliberately."""


class InvalidPerturbation(PerturbationError, InvalidEpisode):
    """A gene or level that does not exist."""


class InvalidFrame(PerturbationError):
    """The input is not an RGB uint8 image of a usable size, or its index is not an integer >= 0."""


class PerturbationFailed(PerturbationError):
    """A transform raised, or did not return an image of the same size; the message names the gene."""


class VisionMissing(PerturbationError):
    """OpenCV is not installed on this machine."""


Frame: TypeAlias = npt.NDArray[np.uint8]
"""An image: RGB, uint8, shape ``(height, width, 3)``."""

Transform: TypeAlias = Callable[[Frame, float, np.random.Generator], Frame]
"""Maps (frame, value of a level, generator) to a new frame. Must be pure; the input frame is read-only."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Gene:
    """A perturbation technique.

    Attributes:
        name: Identifier, such as ``gaussian_noise``.
        values: Parameters of levels 1, 2, ..., in order of strength. Level 0 means "no effect" and has no parameter.
        unit: Unit of the values, such as ``px``.
        effect: One sentence that says what it does to a frame.
    """

    name: str
    values: tuple[float, ...]
    unit: str
    effect: str

    def __post_init__(self) -> None:
        if not self.values:
            raise InvalidPerturbation(f"{self.name}: expected at least one value besides level 0, got none")

    @property
    def levels(self) -> int:
        """Number of levels, including level 0."""
        return len(self.values) + 1

    @property
    def representative_levels(self) -> tuple[int, ...]:
        """The lowest, middle and highest level that have an effect, without duplicates."""
        return tuple(dict.fromkeys((1, self.levels // 2, self.levels - 1)))

    def value(self, level: int) -> float | None:
        """Return the parameter of a level, or None for level 0.

        Raises:
            InvalidPerturbation: The level does not exist.
        """
        self.check_level(level)
        return self.values[level - 1] if level else None

    def intensity(self, level: int) -> float:
        """Return the relative rank of a level: 0 for no effect, 1 for the strongest.

        The rank is used rather than the value, because the values of `shifted_pixels` fall as its strength rises.

        Raises:
            InvalidPerturbation: The level does not exist.
        """
        self.check_level(level)
        return level / (self.levels - 1)

    def check_level(self, level: int) -> None:
        """Check that a level exists.

        Raises:
            InvalidPerturbation: The level does not exist.
        """
        if isinstance(level, bool) or not isinstance(level, int) or not 0 <= level < self.levels:
            raise InvalidPerturbation(
                f"{self.name}: expected a level from 0 to {self.levels - 1} (0 has no effect), got {level!r}"
            )


def _evenly_spaced(first: float, last: float, count: int, digits: int = 4) -> tuple[float, ...]:
    return tuple(round(first + (last - first) * i / (count - 1), digits) for i in range(count))


_GENES = (
    Gene(
        name="shifted_pixels",
        values=_evenly_spaced(0.5, 0.05, 10, digits=2),
        unit="inverse of the shift",
        effect="shifts each row cyclically to the left by 0 to int(3 / v) px; a smaller v is stronger",
    ),
    Gene(
        name="gaussian_noise",
        values=_evenly_spaced(0.1, 0.7, 7, digits=1),
        unit="variance, of intensities in [0, 1]",
        effect="adds N(0, sqrt(v)) to every channel of every pixel",
    ),
    Gene(
        name="gaussian_blur",
        values=tuple(float(k) for k in range(1, 46, 2)),
        unit="px, kernel",
        effect="Gaussian blur with sigma 0.3 ((k - 1) / 2 - 1) + 0.8; k = 1 on a kernel of 3",
    ),
    Gene(
        name="grid_dropout",
        values=tuple(float(v) for v in range(1, 9)),
        unit="10 px, cell",
        effect="a black square of half the cell's side in each cell of a grid",
    ),
    Gene(
        name="coarse_dropout",
        values=(*(float(v) for v in range(10, 39)), 40.0),
        unit="px, side",
        effect="v + 5 black squares at random positions",
    ),
    Gene(
        name="channel_dropout",
        values=(1.0, 2.0),
        unit="channels",
        effect="sets v random colour channels to 0",
    ),
    Gene(
        name="snow",
        values=(1.5, 2.0, 3.0, 4.0, 5.0),
        unit="factor of lightness",
        effect="flakes and a veil, both proportional to v - 1; dark pixels get a quarter of the lightness that a "
        "factor of v would add",
    ),
    Gene(
        name="broken_lens",
        values=_evenly_spaced(0.3, 0.8, 10),
        unit="opacity",
        effect="white cracks and rings around 1 to 3 points of impact",
    ),
    Gene(
        name="dirty", values=_evenly_spaced(0.3, 0.8, 10), unit="opacity", effect="smears and specks of dirt"
    ),
    Gene(
        name="condensation",
        values=_evenly_spaced(0.1, 0.6, 10),
        unit="opacity",
        effect="a grey film with droplets and streaks",
    ),
    Gene(
        name="sun_flare",
        values=_evenly_spaced(400, 900, 10, digits=0),
        unit="px, radius",
        effect="a glaring disc in the upper half, with 6 to 10 ghosts on the line through the centre",
    ),
    Gene(name="brightness", values=_evenly_spaced(0.3, 0.8, 10), unit="of full scale", effect="adds 255 v"),
    Gene(name="contrast", values=_evenly_spaced(0.2, 0.7, 10), unit="gain", effect="multiplies by 1 + v"),
    Gene(
        name="rain",
        values=(1.0, 2.0, 3.0, 4.0, 5.0),
        unit="kind",
        effect="slanted drops, blurred and darkened: drizzle, heavy, torrential, heavy and a wet lens, "
        "torrential and a wet lens",
    ),
    Gene(
        name="smoke",
        values=_evenly_spaced(0.03, 0.3, 10, digits=2),
        unit="opacity of a disc",
        effect="white discs, densest at the centre; each disc transmits 1 - v c of a pixel",
    ),
)

CATALOGUE: Mapping[str, Gene] = MappingProxyType({gene.name: gene for gene in _GENES})
"""The published genes by name, in the order of the table."""

_registered: dict[str, tuple[Gene, Transform]] = {}


def register(gene: Gene, transform: Transform) -> None:
    """Add a custom gene in this process.

    Args:
        gene: Its name must not be in the catalogue.
        transform: Applies the gene.

    Raises:
        InvalidPerturbation: The catalogue already has a gene with that name.
    """
    if gene.name in CATALOGUE:
        raise InvalidPerturbation(
            f"{gene.name}: the catalogue already has a gene with that name; choose another name"
        )
    _registered[gene.name] = (gene, transform)


def find_registered_transform(name: str) -> Transform | None:
    """Return the transform of a registered gene, or None for a gene of the catalogue."""
    return _registered[name][1] if name in _registered else None


def find_gene(name: str) -> Gene:
    """Return a gene of the catalogue or a registered gene.

    Raises:
        InvalidPerturbation: No gene has this name.
    """
    if name in CATALOGUE:
        return CATALOGUE[name]
    if name in _registered:
        return _registered[name][0]
    known = ", ".join([*CATALOGUE, *_registered])
    raise InvalidPerturbation(f"unknown perturbation {name!r}; expected one of {known}")
