"""Shared by the SiMOOD criteria: chains, reproducible streets, and tables of results in them."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, TypeAlias

from benchmarks.measurement import Progress
from benchmarks.trials import Record, Records
from brink.search.streams import Stream, generator
from brink.server.csv_text import csv_text
from brink.server.problems.aeb_crossing import AebCrossing, AebCrossingParams
from brink.sim.episode import EpisodeSpec, Json
from brink.sim.perturbations import CATALOGUE

NamedChain: TypeAlias = tuple[tuple[str, int], ...]
"""Genes and their levels, in the order in which they are applied; level 0 has no effect."""

CONFIRMATION_PLACES: Final = range(5, 10)
"""Places in which chains are simulated to call them hazardous or safe; with fewer, four of five would be all.

No level and no chain is selected by what happens in them.
"""


class Places:
    """Reproducible random streets. The number of a place determines its scenario and the seed of its episodes.

    Args:
        params: Parameters of the problem: detector, picture size, obstacle.
    """

    def __init__(self, params: AebCrossingParams) -> None:
        self.problem = AebCrossing(params)

    def episode(
        self, place: int, chain: NamedChain = (), *, mode: str = "detector", **options: Json
    ) -> EpisodeSpec:
        """Return an episode in a place.

        Args:
            place: Number of the place.
            chain: Perturbations of the camera pictures.
            mode: Mode of the detector's behaviour.
            options: Further options of the episode.
        """
        vectors = self.problem.space.sample(generator(0, Stream.FINALISTS, place))
        spec = self.problem.episode(vectors, place)
        behaviour: dict[str, Json] = {"mode": mode}
        if mode == "detector":
            behaviour = {**spec.behaviour, "perturbations": _steps(chain)}
        return replace(spec, behaviour=behaviour, options={**spec.options, **options})

    def evaluation(self, chain: NamedChain) -> EpisodeSpec:
        """Return the evaluation of a chain on the data set."""
        vectors = self.problem.space.sample(generator(0, Stream.FINALISTS, 0))
        spec = self.problem.dataset_evaluation(vectors)
        return replace(spec, behaviour={**spec.behaviour, "perturbations": _steps(chain)})


class Criteria:
    """Base class of the measurements: runs episodes in the numbered streets of `Places` and writes tables.

    Args:
        records: Runs episodes and stores their outcomes.
        folder: Folder for tables and figures.
        progress: Progress callback.
        params: Parameters of the problem.
    """

    def __init__(self, records: Records, folder: Path, progress: Progress, params: AebCrossingParams) -> None:
        self._records = records
        self._folder = folder
        self._progress = progress
        self._params = params
        self._places = Places(params)

    def _run(self, part: str, specs: Sequence[EpisodeSpec]) -> list[Record]:
        return self._records.run(specs, part, self._progress)

    def _run_chains(
        self, part: str, chains: Sequence[NamedChain], places: Sequence[int]
    ) -> dict[NamedChain, list[Record]]:
        """Run every chain in every place."""
        specs = [self._places.episode(place, chain) for chain in chains for place in places]
        records = self._run(part, specs)
        width = len(places)
        return {chain: records[index * width : (index + 1) * width] for index, chain in enumerate(chains)}

    def _write(self, name: str, rows: Sequence[Mapping[str, Any]]) -> None:
        header = list(rows[0])
        text = csv_text([header, *([row[column] for column in header] for row in rows)])
        (self._folder / name).write_text(text, encoding="utf-8", newline="")


def words_of(chain: NamedChain) -> str:
    """Return a chain in words, without steps that have no effect."""
    steps = (
        f"{gene.replace('_', ' ')} {level}/{CATALOGUE[gene].levels - 1}" for gene, level in chain if level
    )
    return ", then ".join(steps) or "nothing"


def _steps(chain: NamedChain) -> list[Json]:
    """Return a chain in the format of an episode specification."""
    return [{"gene": gene, "level": level} for gene, level in chain]
