"""What the figures of a campaign are drawn from, and what several of them derive from it."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from brink.search.archive import Archive
from brink.search.space import SearchSpace


@dataclass(frozen=True, slots=True, kw_only=True)
class CampaignFigures:
    """The inputs of all figures of a campaign.

    Attributes:
        archive: All evaluated solutions that did not fail, ascending by number.
        space: Their search space.
        title: Name of the campaign.
        generation_ends: How many solutions the archive held after each generation, ascending.
        t_b: Largest fitness of a boundary solution.
        d_th: Least distance between two that count.
    """

    archive: Archive
    space: SearchSpace
    title: str
    generation_ends: tuple[int, ...]
    t_b: float
    d_th: float

    def __post_init__(self) -> None:
        ends = np.asarray(self.generation_ends, dtype=np.int64)
        if ends.size and (ends[0] < 0 or ends[-1] > len(self.archive) or (np.diff(ends) < 0).any()):
            raise ValueError(
                f"generation_ends: expected ascending counts up to {len(self.archive)}, got {ends.tolist()}"
            )
        if self.archive.metric.dimension != self.space.dimension:
            raise ValueError(
                f"space: expected {self.archive.metric.dimension} parameters as in the archive, "
                f"got {self.space.dimension}"
            )


def by_generation(inputs: CampaignFigures) -> Iterator[Archive]:
    """Yield the archive as it was after each generation, scored with only what was known then."""
    archive = inputs.archive
    known = Archive.empty(archive.metric, archive.neighbourhood)
    for end in inputs.generation_ends:
        part = slice(len(known), end)
        known = known.grown(
            archive.numbers[part],
            archive.vectors[part],
            archive.unsafe[part],
            archive.robustness[part],
            keep_rows=False,
        )
        yield known
