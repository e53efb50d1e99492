"""The data from which the figures of a campaign are drawn."""

from dataclasses import dataclass

import numpy as np

from brink.search.archive import Archive
from brink.search.space import BoolArray, SearchSpace


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class VerdictWords:
    """The subject of a campaign's verdicts in words.

    Attributes:
        held: What safe solutions have in common, such as ``front gap held``.
        other: The same for those that violated another requirement.
        violated: What unsafe solutions have in common.
        others: Solutions that are safe but violated another requirement, in the order of the archive, shape ``(n,)``.
    """

    held: str
    other: str
    violated: str
    others: BoolArray


@dataclass(frozen=True, slots=True, kw_only=True)
class CampaignFigures:
    """The inputs of all figures of a campaign.

    Attributes:
        archive: All evaluated solutions except failures, in ascending order of number.
        space: Their search space.
        title: Name of the campaign.
        generation_ends: Size of the archive after each generation, ascending.
        t_b: Maximum fitness of a boundary solution.
        d_th: Minimum distance between distinct boundary solutions.
        words: What the verdicts are about; None if that is unknown.
        active: Which parameters were active in each episode, shape ``(n, d)``; None if that was not recorded.
        pairs: Numbers of the safe and the unsafe side of each distinct pair, in the order of their list, if the
            campaign searched for pairs; None if it searched for something else.
        too_many_pairs: Whether there are too many pairs to mark any.
        searched_boundary: Whether the campaign searched for the boundary, or for pairs across it; otherwise nothing
            about it is shown.
    """

    archive: Archive
    space: SearchSpace
    title: str
    generation_ends: tuple[int, ...]
    t_b: float
    d_th: float
    words: VerdictWords | None = None
    active: BoolArray | None = None
    pairs: tuple[tuple[int, int], ...] | None = None
    too_many_pairs: bool = False
    searched_boundary: bool = True

    def __post_init__(self) -> None:
        ends = np.asarray(self.generation_ends, dtype=np.int64)
        if ends.size and (ends[0] < 0 or ends[-1] > len(self.archive) or (np.diff(ends) < 0).any()):
            raise ValueError(
                f"generation_ends: expected ascending counts up to {len(self.archive)}, got {ends.tolist()}"
            )
        if self.words is not None and self.words.others.shape != self.archive.unsafe.shape:
            raise ValueError(
                f"words: expected {len(self.archive)} entries in others, got {self.words.others.size}"
            )
        if self.active is not None and self.active.shape != self.archive.vectors.shape:
            raise ValueError(f"active: expected shape {self.archive.vectors.shape}, got {self.active.shape}")
        known = frozenset(self.archive.numbers.tolist())
        if unknown := [number for pair in self.pairs or () for number in pair if number not in known]:
            raise ValueError(f"pairs: expected numbers of solutions in the archive, got {unknown[0]}")
        if self.archive.metric.dimension != self.space.dimension:
            raise ValueError(
                f"space: expected {self.archive.metric.dimension} parameters as in the archive, "
                f"got {self.space.dimension}"
            )
