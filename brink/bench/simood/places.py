"""Which episodes are run: random streets by number, and perturbations on them."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final, TypeAlias

from brink.search.streams import Stream, generator
from brink.server.problems.aeb_crossing import AebCrossing, AebCrossingParams
from brink.sim.episode import EpisodeSpec, Json
from brink.sim.perturbations import CATALOGUE

Chain: TypeAlias = tuple[tuple[str, int], ...]
"""Genes at levels, in the order in which they are applied."""

ACCIDENT: Final = "no-collision@1"
DANGEROUS_STOP: Final = "no-dangerous-stop@1"


def steps(chain: Chain) -> list[Json]:
    """Return a chain as specifications have it."""
    return [{"gene": gene, "level": level} for gene, level in chain]


def words(chain: Chain) -> str:
    """Return a chain in words."""
    return (
        ", then ".join(f"{g.replace('_', ' ')} {v}/{CATALOGUE[g].levels - 1}" for g, v in chain) or "nothing"
    )


class Places:
    """Streets that are random but the same each time; a number is a scenario and the seed of its chance.

    Args:
        params: Of the problem: detector, size of the pictures, obstacle.
    """

    def __init__(self, params: AebCrossingParams | None = None) -> None:
        self.problem = AebCrossing(params or AebCrossingParams())

    def episode(
        self, place: int, chain: Chain = (), *, mode: str = "detector", **options: Json
    ) -> EpisodeSpec:
        """Return an episode."""
        vectors = self.problem.space.sample(generator(0, Stream.FINALISTS, place))
        spec = self.problem.episode(vectors, place)
        behaviour: dict[str, Json] = {"mode": mode}
        if mode == "detector":
            behaviour = {**spec.behaviour, "perturbations": steps(chain)}
        return replace(spec, behaviour=behaviour, options={**spec.options, **options})

    def evaluation(self, chain: Chain) -> EpisodeSpec:
        """Return the evaluation of a chain on the data set."""
        vectors = self.problem.space.sample(generator(0, Stream.FINALISTS, 0))
        spec = self.problem.dataset_evaluation(vectors)
        return replace(spec, behaviour={**spec.behaviour, "perturbations": steps(chain)})


def singles() -> list[Chain]:
    """Return every gene at every level that does something: 160."""
    return [((name, level),) for name, gene in CATALOGUE.items() for level in range(1, gene.levels)]


def highest(tallies: dict[Chain, float], share: float) -> dict[str, int]:
    """Return, for each gene, its highest level up to which every level alone is hazardous in at most that share."""
    found: dict[str, int] = {}
    for name, gene in CATALOGUE.items():
        for level in range(1, gene.levels):
            if tallies[((name, level),)] > share:
                break
            found[name] = level
    return found


def shares(hazards: dict[Chain, Sequence[bool]]) -> dict[Chain, float]:
    """Return the hazardous share of each chain."""
    return {chain: sum(seen) / len(seen) for chain, seen in hazards.items()}
