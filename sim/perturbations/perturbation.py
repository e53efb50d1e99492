"""A perturbation: one gene at one level. An individual of the search is an ordered tuple of them."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from numbers import Integral
from typing import Self

from brink.sim.episode import Json, JsonObject
from brink.sim.perturbations.catalogue import find_gene
from brink.sim.perturbations.errors import InvalidPerturbation


@dataclass(frozen=True, slots=True)
class Perturbation:
    """One gene at one level.

    Attributes:
        gene: Name of a gene.
        level: Index of its level; 0 has no effect.

    Raises:
        InvalidPerturbation: There is no such gene or level.
    """

    gene: str
    level: int

    def __post_init__(self) -> None:
        if not isinstance(self.gene, str):
            raise InvalidPerturbation(f"gene: expected the name of a perturbation, got {self.gene!r}")
        level: object = self.level
        if not isinstance(level, bool) and isinstance(level, Integral):
            object.__setattr__(self, "level", int(level))  # numpy's integers are no JSON
        find_gene(self.gene).check(self.level)

    def __str__(self) -> str:
        return f"{self.gene}:{self.level}"

    @property
    def value(self) -> float | None:
        """The parameter of the level, None for level 0."""
        return find_gene(self.gene).value(self.level)

    @property
    def intensity(self) -> float:
        """The rank of the level in [0, 1]."""
        return find_gene(self.gene).intensity(self.level)

    def to_json(self) -> JsonObject:
        """Return the perturbation as a JSON object."""
        return {"gene": self.gene, "level": self.level}

    @classmethod
    def from_json(cls, document: Json) -> Self:
        """Read a perturbation from ``{"gene": "smoke", "level": 3}``.

        Raises:
            InvalidPerturbation: It is something else, or there is no such gene or level.
        """
        if not isinstance(document, Mapping) or set(document) != {"gene", "level"}:
            raise InvalidPerturbation(
                f'expected a perturbation such as {{"gene": "smoke", "level": 3}}, got {document!r}'
            )
        return cls(document["gene"], document["level"])  # type: ignore[arg-type]  # checked on construction

    @classmethod
    def parse(cls, text: str) -> Self:
        """Read a perturbation from ``gene:level``, such as ``smoke:3``.

        Raises:
            InvalidPerturbation: It is something else, or there is no such gene or level.
        """
        gene, _, level = text.partition(":")
        if not level.isdecimal():
            raise InvalidPerturbation(f"expected a perturbation such as smoke:3, got {text!r}")
        return cls(gene, int(level))


def parse_perturbations(items: Iterable[Json]) -> tuple[Perturbation, ...]:
    """Read an ordered list of perturbations: ``gene:level`` or objects with ``gene`` and ``level``.

    Raises:
        InvalidPerturbation: One is something else; names its place.
    """
    parsed = []
    for place, item in enumerate(items):
        try:
            parsed.append(Perturbation.parse(item) if isinstance(item, str) else Perturbation.from_json(item))
        except InvalidPerturbation as error:
            raise InvalidPerturbation(f"perturbations[{place}]: {error}") from None
    return tuple(parsed)


def mean_intensity(perturbations: Iterable[Perturbation]) -> float:
    """Return the mean rank of the levels in [0, 1]; 0 for an empty list."""
    ranks = [perturbation.intensity for perturbation in perturbations]
    return sum(ranks) / len(ranks) if ranks else 0.0
