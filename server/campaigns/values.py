"""Campaigns and what a generation step writes, as plain values."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime

import numpy as np
from numpy.typing import NDArray

from brink.server.campaigns.body import CampaignBody
from brink.server.states import CampaignStatus, JobKind, SolutionVerdict


@dataclass(frozen=True, slots=True, kw_only=True)
class Campaign:
    """A campaign as it stands in the database.

    Attributes:
        body: What was asked for, with every parameter spelled out.
        document_hash: Of the body as it was submitted.
        sequence: Grows with every change, but for jobs that are handed out and reported within a generation.
    """

    id: str
    body: CampaignBody
    document_hash: str
    status: CampaignStatus
    status_reason: str
    generation: int
    evaluated: int
    unsafe: int
    failed: int
    measured: int
    failures_accepted: int
    sequence: int
    created_at: datetime
    finished_at: datetime | None

    @property
    def budget(self) -> int:
        """Simulations that it may cost."""
        return self.body.budget.simulations

    @property
    def told(self) -> int:
        """Candidates of which all is known that was asked: simulated, measured or failed."""
        return self.evaluated + self.measured + self.failed


@dataclass(frozen=True, slots=True, kw_only=True)
class NewJob:
    """An episode or a data-set evaluation that a solution needs."""

    spec: str
    spec_hash: str
    needs: str
    timeout_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class NewSolution:
    """A solution that was asked for."""

    number: int
    vector: bytes
    seed: int
    job: NewJob | None
    kind: JobKind = JobKind.EPISODE
    origin: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Judged:
    """What became of a solution."""

    number: int
    verdict: SolutionVerdict
    robustness: float | None
    objectives: Mapping[str, float] | None
    failure: str | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Block:
    """A generation's rows of the distance matrix."""

    first_row: int
    rows: int
    columns: int
    metric_version: int
    data: bytes


@dataclass(frozen=True, slots=True, kw_only=True)
class Checkpoint:
    """The algorithm's state after a `tell`, and the counts of the archive that goes with it."""

    generation: int
    document: bytes
    neighbours: bytes
    unsafe_neighbours: bytes

    def sha256(self) -> str:
        """Return the checksum that is stored with it."""
        return hashlib.sha256(self.document + self.neighbours + self.unsafe_neighbours).hexdigest()


@dataclass(frozen=True, slots=True, kw_only=True)
class GenerationSummary:
    """Where the archive stood after a generation."""

    number: int
    evaluated: int
    unsafe: int
    failed: int
    measured: int
    best_fitness: float | None
    median_fitness: float | None
    dbs: int
    strict_dbs: int
    step_s: float
    told_at: datetime | None = None

    @property
    def told(self) -> int:
        """Candidates of which all is known that was asked."""
        return self.evaluated + self.measured + self.failed


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """All that one generation step writes.

    Attributes:
        campaign: Its id.
        generation: Generations told before this step; the step is written only if that still holds.
        judged: The generation that was told.
        summary: Where the archive stands after it.
        block: Its distances, unless they are not stored.
        checkpoint: The state after it.
        asked: The next generation; empty if the search is over.
        traces: Solutions of which a trace is wanted as evidence, once the search is over.
        status: What the campaign is after the step.
        reason: Why.
    """

    campaign: str
    generation: int
    judged: Sequence[Judged]
    summary: GenerationSummary
    block: Block | None
    checkpoint: Checkpoint
    asked: Sequence[NewSolution]
    traces: Sequence[int]
    status: CampaignStatus
    reason: str


@dataclass(frozen=True, slots=True, kw_only=True)
class StoredArchive:
    """The evaluated solutions of a campaign, ascending by number, as of its last checkpoint."""

    generation: int
    numbers: NDArray[np.int64]
    vectors: NDArray[np.float64]
    unsafe: NDArray[np.bool_]
    robustness: NDArray[np.float64]
    generations: NDArray[np.int64]
    neighbours: NDArray[np.int64]
    unsafe_neighbours: NDArray[np.int64]
