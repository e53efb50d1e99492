"""The 15 genes and their 175 levels, in the order of the published table; and genes that others register.

Source: Ferreira et al. 2022, table I. Two of its levels do nothing and are replaced (docs/adr/0022): snow 1, which
scales lightness by 1, and blur 1, a kernel of one pixel. Pixel sizes are for frames 720 px high.
"""

from collections.abc import Mapping
from types import MappingProxyType

from brink.sim.perturbations.errors import InvalidPerturbation
from brink.sim.perturbations.gene import Gene, Transform


def _evenly(first: float, last: float, count: int, digits: int = 4) -> tuple[float, ...]:
    return tuple(round(first + (last - first) * i / (count - 1), digits) for i in range(count))


_GENES = (
    Gene(
        name="shifted_pixels",
        values=_evenly(0.5, 0.05, 10, digits=2),
        unit="inverse of the shift",
        effect="each row moves left in a circle by 0 to int(3 / v) px; a small v is the strong end",
    ),
    Gene(
        name="gaussian_noise",
        values=_evenly(0.1, 0.7, 7, digits=1),
        unit="variance, of intensities in [0, 1]",
        effect="every channel of every pixel gets N(0, sqrt(v)) added",
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
        effect="a black square of half the cell's side in each cell of a regular grid",
    ),
    Gene(
        name="coarse_dropout",
        values=(*(float(v) for v in range(10, 39)), 40.0),
        unit="px, side",
        effect="v + 5 black squares at random places",
    ),
    Gene(
        name="channel_dropout",
        values=(1.0, 2.0),
        unit="channels",
        effect="v random colour channels become 0",
    ),
    Gene(
        name="snow",
        values=(1.5, 2.0, 3.0, 4.0, 5.0),
        unit="factor of lightness",
        effect="what is darker than a random threshold gets its lightness (HLS) scaled, as if snow lay on it",
    ),
    Gene(
        name="broken_lens",
        values=_evenly(0.3, 0.8, 10),
        unit="opacity",
        effect="white cracks and rings around 1 to 3 points of impact",
    ),
    Gene(name="dirty", values=_evenly(0.3, 0.8, 10), unit="opacity", effect="smears and specks of dirt"),
    Gene(
        name="condensation",
        values=_evenly(0.1, 0.6, 10),
        unit="opacity",
        effect="a grey film with droplets and the streaks that some of them leave",
    ),
    Gene(
        name="sun_flare",
        values=_evenly(400, 900, 10, digits=0),
        unit="px, radius",
        effect="a glaring disc in the upper half, with 6 to 10 ghosts on the line through the centre",
    ),
    Gene(name="brightness", values=_evenly(0.3, 0.8, 10), unit="of full scale", effect="255 v is added"),
    Gene(name="contrast", values=_evenly(0.2, 0.7, 10), unit="gain", effect="multiplied by 1 + v"),
    Gene(
        name="rain",
        values=(1.0, 2.0, 3.0, 4.0, 5.0),
        unit="kind",
        effect="slanted drops, blurred and darkened: drizzle, heavy, torrential, heavy and a wet lens, "
        "torrential and a wet lens",
    ),
    Gene(
        name="smoke",
        values=_evenly(0.03, 0.3, 10, digits=2),
        unit="opacity of a disc",
        effect="white discs, densest at the centre: those over a pixel each let 1 - v c of it through",
    ),
)

CATALOGUE: Mapping[str, Gene] = MappingProxyType({gene.name: gene for gene in _GENES})
"""The genes of the table by name, in its order."""

_registered: dict[str, tuple[Gene, Transform]] = {}


def register(gene: Gene, transform: Transform) -> None:
    """Add a gene of one's own, for this process.

    Args:
        gene: What it is; its name may not be one of the catalogue's.
        transform: What it does.

    Raises:
        InvalidPerturbation: The catalogue has a gene of that name.
    """
    if gene.name in CATALOGUE:
        raise InvalidPerturbation(f"{gene.name}: the catalogue has a gene of that name; expected a new one")
    _registered[gene.name] = (gene, transform)


def registered_transform(name: str) -> Transform | None:
    """Return the transform that was registered with a gene, None for a gene of the catalogue."""
    return _registered[name][1] if name in _registered else None


def find_gene(name: str) -> Gene:
    """Return a gene of the catalogue, or one that was registered.

    Raises:
        InvalidPerturbation: There is none of that name.
    """
    if name in CATALOGUE:
        return CATALOGUE[name]
    if name in _registered:
        return _registered[name][0]
    known = ", ".join([*CATALOGUE, *_registered])
    raise InvalidPerturbation(f"unknown perturbation {name!r}; expected one of {known}")
