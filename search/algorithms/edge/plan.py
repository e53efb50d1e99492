"""The generation that `edge@1` is planning."""

from dataclasses import dataclass

from brink.search.algorithms.edge.state import Job
from brink.search.space import FloatArray


@dataclass(slots=True)
class Plan:
    """The generation that is being planned.

    Attributes:
        wanted: Its size.
        rows: Its candidates so far.
        seeds: Number of the candidate whose episode seed each shares; None for a seed of its own.
        jobs: Their purposes.
        allowance: Simulations that are left beyond what open brackets are expected to need.
    """

    wanted: int
    rows: list[FloatArray]
    seeds: list[int | None]
    jobs: list[Job]
    allowance: float = 0.0

    @property
    def room(self) -> int:
        """How many more candidates fit."""
        return self.wanted - len(self.rows)

    def add(self, row: FloatArray, seed: int | None, job: Job) -> None:
        """Add a candidate."""
        self.rows.append(row)
        self.seeds.append(seed)
        self.jobs.append(job)
