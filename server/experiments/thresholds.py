"""Thresholds in experiments: which are counted."""

import math
from functools import partial

import numpy as np

from brink.search.analysis.threshold_comparison import FoundThreshold, ThresholdRepeat, close_ones
from brink.search.conclusions import Outcome
from brink.server.campaigns.store import Campaign
from brink.server.campaigns.threshold_ends import Ends, kind_of, read_outcome, row_at
from brink.server.campaigns.thresholds import Threshold, find_stored_thresholds
from brink.server.campaigns.view_store import read_solutions
from brink.server.errors import NotFound
from brink.server.experiments.body import ExperimentBody, ThresholdsChoice
from brink.server.experiments.searched import Found, SearchedCache, TooMany


def distance_of(body: ExperimentBody, d_th: float | None = None) -> float:
    """Return the given distance; that of the experiment, or else the default, if None. All campaigns share it."""
    return (body.thresholds or ThresholdsChoice()).d_th if d_th is None else d_th


class ThresholdCache(SearchedCache[float, ThresholdRepeat]):
    """The thresholds of finished campaigns, each estimated once; their setting is the smallest distance."""

    def _find(self, campaign: Campaign, settings: float) -> Found[ThresholdRepeat] | TooMany:
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
        thresholds = [
            FoundThreshold(
                kind=kind,
                near=others,
                ends=(end.safe, end.unsafe),
                is_paired=end.are_beyond and end.are_tight,
            )
            for kind, others, end in zip(kinds, near, ends, strict=True)
        ]
        return Found(
            count=partial(ThresholdRepeat.of, thresholds),
            is_empty=not thresholds,
            computed=problem.ignores_seeds,
        )


def _place(line: Threshold) -> float:
    """Return the value at which a line turns, or else its unsafe end."""
    return line.middle if math.isfinite(line.middle) else line.line.ends[1]
