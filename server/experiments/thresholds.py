"""Thresholds in experiments: which are counted, and the results of their follow-ups."""

import math
from dataclasses import dataclass

import numpy as np
from sqlalchemy import Connection

from brink.search.analysis.threshold_comparison import (
    FoundThreshold,
    ThresholdCounts,
    ThresholdRepeat,
    close_ones,
)
from brink.search.thresholds import Outcome
from brink.server.campaigns.follow_ups.kinds.component import blames_scenario
from brink.server.campaigns.follow_ups.kinds.confirm import shares_of
from brink.server.campaigns.store import Campaign
from brink.server.campaigns.threshold_ends import Ends, kind_of, read_outcome, row_at
from brink.server.campaigns.thresholds import Threshold, find_stored_thresholds
from brink.server.campaigns.view_store import read_solutions
from brink.server.errors import NotFound
from brink.server.experiments.body import ExperimentBody, ThresholdsChoice
from brink.server.experiments.searched import SearchedCache, TooMany, read_ended_follow_ups
from brink.server.experiments.store import Member


def distance_of(body: ExperimentBody, d_th: float | None = None) -> float:
    """Return the given distance; that of the experiment, or else the default, if None. All campaigns share it."""
    return (body.thresholds or ThresholdsChoice()).d_th if d_th is None else d_th


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundThresholds:
    """The thresholds of a campaign, the sharpest first, and whether its verdicts are computed."""

    thresholds: tuple[FoundThreshold, ...]
    computed: bool


class ThresholdCache(SearchedCache[float, FoundThresholds, ThresholdRepeat]):
    """The thresholds of finished campaigns, each estimated once; their setting is the smallest distance."""

    def _find(self, campaign: Campaign, settings: float) -> FoundThresholds | TooMany:
        plan, _, archive = self.archives.stored(campaign)
        problem = plan.problem
        lines = find_stored_thresholds(self.engines, campaign, plan, archive).of(Outcome.THRESHOLD)
        ends = [Ends.of(archive, one) for one in lines]
        with self.engines.reader.connect() as connection:
            numbers = {one.unsafe for one in ends}
            rows = {row.number: row for row in read_solutions(connection, campaign.id, numbers)}
        if not rows.keys() >= numbers:
            raise NotFound(f"campaign {campaign.id}: no such campaign")  # it was deleted meanwhile
        kinds = [
            kind_of(problem, archive, line, read_outcome(problem, rows[end.unsafe]).words(times=False))
            for line, end in zip(lines, ends, strict=True)
        ]
        places = np.array([row_at(problem, archive, line, _place(line)) for line in lines])
        near = close_ones(kinds, places, problem.space, settings)
        return FoundThresholds(
            thresholds=tuple(
                FoundThreshold(
                    kind=kind,
                    near=others,
                    ends=(end.safe, end.unsafe),
                    is_paired=end.are_beyond and end.are_tight,
                )
                for kind, others, end in zip(kinds, near, ends, strict=True)
            ),
            computed=problem.ignores_seeds,
        )

    def _repeat(self, connection: Connection, member: Member, found: FoundThresholds) -> ThresholdRepeat:
        ended = read_ended_follow_ups(connection, member.campaign.id) if found.thresholds else []
        return ThresholdRepeat(
            problem=member.problem,
            method=member.method,
            seed=member.campaign.body.seed,
            campaign=member.campaign.id,
            computed=found.computed,
            counts=ThresholdCounts.of(found.thresholds, shares_of(ended), blames_scenario(ended)),
        )


def _place(line: Threshold) -> float:
    """Return the value at which a line turns, or else its unsafe end."""
    return line.middle if math.isfinite(line.middle) else line.line.ends[1]
