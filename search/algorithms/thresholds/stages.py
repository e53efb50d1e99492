"""How evaluations move hunts from stage to stage."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from brink.search.algorithm import Candidate, Evaluation, Scored
from brink.search.algorithms.thresholds.parts import Parts
from brink.search.algorithms.thresholds.state import (
    MAX_FAILURES,
    OPEN,
    Draw,
    Hunt,
    Job,
    Purpose,
    Simulated,
    Stage,
    ThresholdConfig,
    ThresholdState,
)
from brink.search.conclusions import Outcome
from brink.search.metric import Metric
from brink.search.space import FloatArray
from brink.search.streams import Stream, generator
from brink.search.thresholds.estimation import FEWEST, Estimate, Trials, estimate
from brink.search.thresholds.line import Line, valid_change
from brink.search.thresholds.prior import CurvePrior

COARSE: Final = 1 / 4
"""Width of the bracket from which on trials take over, as a share of the line, where chance has a part."""
FAR: Final = 0.05
"""Least distance to the other end of the range, as a share of it, that is worth a simulation."""
APART: Final = 0.02
"""Distance of thresholds along the same unit below which one of them is enough, where chance has no part."""
CHECKS: Final = 3
"""Fresh seeds of the solution whose units are moved; most of them must have its verdict."""
OTHER_CHECKS: Final = 2
"""Fresh seeds of the other end of a line while it is bracketed; one of them must have its verdict."""
HOPELESS: Final = 0.8
"""Probability that a place is chancy from which on the budget is better spent elsewhere."""
PROBES: Final = 3
"""Probes of a bracket at a time where chance has a part; without chance, one."""


def learnt(
    state: ThresholdState,
    told: Sequence[Candidate],
    jobs: Sequence[Job],
    evaluations: Mapping[int, Evaluation],
) -> ThresholdState:
    """Return the state with hunts moved on by a generation's evaluations.

    Args:
        state: The state whose ledger has been told the generation, and whose jobs are those still waited for.
        told: The generation.
        jobs: The purpose of each of its candidates.
        evaluations: Its evaluations, by number.
    """
    hunts, explored = list(state.hunts), list(state.explored)
    for candidate, job in zip(told, jobs, strict=True):
        scored = isinstance(evaluations[candidate.number], Scored)
        if job.purpose is Purpose.EXPLORE:
            explored += [candidate.number] if scored else []
        elif scored:
            result = (int(job.purpose), job.subject, candidate.number)
            hunts[job.hunt] = replace(hunts[job.hunt], told=(*hunts[job.hunt].told, result))
        else:
            hunts[job.hunt] = replace(hunts[job.hunt], failures=hunts[job.hunt].failures + 1)
    state = replace(state, hunts=tuple(hunts), explored=tuple(explored))
    waiting = {job.hunt for job in state.jobs if job.purpose is not Purpose.EXPLORE}
    ready = {job.hunt for job in jobs if job.purpose is not Purpose.EXPLORE} - waiting
    stages = _Stages(state)
    for place in sorted(ready):
        stages.advance(place)
    return replace(state, hunts=tuple(stages.hunts), estimates=stages.estimates)


class _Stages:
    """Moves hunts on whose simulations of a stage are all told.

    Attributes:
        hunts: All hunts.
        estimates: As in the state.
    """

    def __init__(self, state: ThresholdState) -> None:
        self._state = state
        self._config = state.config
        self._parts = Parts(state.ledger.space)
        self._simulated = Simulated(state.ledger.archive)
        self._metric = Metric.of_space(state.ledger.space)
        self.hunts = list(state.hunts)
        self.estimates = dict(state.estimates)

    def advance(self, place: int) -> None:
        """Move a hunt on to its next stage, or let it repeat one whose simulations failed."""
        hunt = self.hunts[place]
        if hunt.failures >= MAX_FAILURES and hunt.stage is not Stage.ESTIMATE:
            self.hunts[place] = replace(hunt, stage=Stage.GIVEN_UP, told=())
            return
        told, hunt = hunt.told, replace(hunt, told=())
        match hunt.stage:
            case Stage.SCREEN | Stage.REDUCE:
                self.hunts[place] = self._reduced(hunt, told)
            case Stage.MOVE:
                self._moved(place, hunt, told)
            case Stage.SPAN | Stage.BRACKET:
                self.hunts[place] = self._apart(place, self._bracketed(hunt, told))
            case _:
                self._conclude(
                    place, replace(hunt, trials=(*hunt.trials, *(number for _, _, number in told)))
                )

    def _reduced(self, hunt: Hunt, told: Sequence[tuple[int, int, int]]) -> Hunt:
        """Return a hunt after the scenario alone, or solutions with one block less, were simulated."""
        if hunt.stage is Stage.SCREEN:
            if not told:
                return hunt
            (_, _, alone), *_ = told
            if self._is_kept(hunt, alone):
                return replace(hunt, stage=Stage.ALONE, held=alone)
            several = len(self._parts.active(self._simulated.row(hunt.held))) > 1
            return replace(hunt, stage=Stage.REDUCE if several else Stage.MOVE)
        drops = [(block, number) for purpose, block, number in told if purpose == Purpose.DROP]
        needed = [block for block, number in drops if not self._is_kept(hunt, number)]
        held = next((number for _, number in drops if self._is_kept(hunt, number)), hunt.held)
        hunt = replace(hunt, needed=(*hunt.needed, *needed), held=held)
        active = self._parts.active(self._simulated.row(held))
        dropped = len(needed) < len(drops)
        is_minimal = len(active) < 2 or not dropped or set(active) <= set(hunt.needed)
        return replace(hunt, stage=Stage.MOVE if is_minimal else Stage.REDUCE)

    def _moved(self, place: int, hunt: Hunt, told: Sequence[tuple[int, int, int]]) -> None:
        """Move a hunt on after units were moved, each alone; those that changed the verdict give a line each.

        The first of these lines is the hunt's own, the others are hunts that wait.
        """
        checks = tuple(number for purpose, _, number in told if purpose == Purpose.CHECK)
        hunt = replace(hunt, trials=(*hunt.trials, *checks))
        moves = [one for one in told if one[0] != Purpose.CHECK]
        if self._is_by_chance(checks, unsafe=not hunt.from_safe):
            self.hunts[place] = replace(hunt, stage=Stage.CHANCY)
            return
        changed = [(unit, number) for _, unit, number in moves if not self._is_kept(hunt, number)]
        moved = tuple(unit for purpose, unit, number in moves if purpose == Purpose.MOVE)
        hunt = replace(hunt, moved=(*hunt.moved, *moved))
        if changed:
            first, *others = (self._begun(hunt, unit, number) for unit, number in changed)
            self.hunts[place] = first
            waiting = (one for one in others if one.stage is Stage.SPAN)
            self.hunts += [replace(one, stage=Stage.READY) for one in waiting]
        elif moves and moves[0][0] == Purpose.APPROACH:
            # A fresh seed of the solution as it was says nothing of the solution as it is now.
            self.hunts[place] = replace(hunt, held=moves[0][2], trials=())
        elif moves:
            left = set(self._parts.movable(self._simulated.row(hunt.held))) - set(hunt.moved)
            given_up = len(hunt.moved) >= self._config.moves or not left
            self.hunts[place] = replace(hunt, stage=Stage.FIXED if given_up else Stage.MOVE)
        else:
            self.hunts[place] = hunt

    def _is_kept(self, hunt: Hunt, number: int) -> bool:
        """Return whether a solution has the verdict of a hunt's anchor."""
        return self._simulated.unsafe(number) != hunt.from_safe

    def _begun(self, hunt: Hunt, unit: int, changed: int) -> Hunt:
        """Return the hunt along a unit that changed the verdict."""
        safe, unsafe = (hunt.held, changed) if hunt.from_safe else (changed, hunt.held)
        found = replace(
            hunt,
            moved=hunt.moved if unit in hunt.moved else (*hunt.moved, unit),
            unit=unit,
            safe=safe,
            unsafe=unsafe,
            start=safe,
            end=unsafe,
            stage=Stage.SPAN if unit in self._parts.numeric else Stage.CATEGORY,
        )
        return self._bracketed(found, ()) if found.stage is Stage.SPAN else found

    def _is_by_chance(self, checks: Sequence[int], *, unsafe: bool) -> bool:
        """Return whether most of at least two fresh seeds contradict the verdict at an end of a line."""
        contradict = sum(self._simulated.unsafe(number) != unsafe for number in checks)
        return contradict >= max(2, len(checks) // 2 + 1)

    def _bracketed(self, hunt: Hunt, told: Sequence[tuple[int, int, int]]) -> Hunt:
        """Return a hunt with its bracket narrowed by probes, in the stage that follows."""
        unsafe, row = self._simulated.unsafe, self._simulated.row
        if told and hunt.stage is Stage.SPAN:
            hunt = replace(hunt, stage=Stage.BRACKET)
        checks = [(end, number) for purpose, end, number in told if purpose == Purpose.CHECK]
        hunt = replace(hunt, trials=(*hunt.trials, *(number for _, number in checks)))
        if any(self._is_by_chance([n for at, n in checks if at == end], unsafe=bool(end)) for end in (0, 1)):
            return replace(hunt, stage=Stage.CHANCY)
        for purpose, _, number in told:
            if purpose == Purpose.FAR:
                hunt = replace(hunt, end=number) if unsafe(number) else replace(hunt, window=True)
        line = line_of(hunt, self._parts, self._simulated)
        probes = [number for purpose, _, number in told if purpose == Purpose.PROBE]
        for number in sorted(probes, key=lambda number: line.place_of(row(number))):
            if unsafe(number):
                hunt = replace(hunt, unsafe=number)
                break
            hunt = replace(hunt, safe=number)
        simulated, config = self._simulated, self._config
        if probe_rows(hunt, self._parts, simulated, config) or (config.trials and hunt.stage is Stage.SPAN):
            return hunt
        return replace(hunt, stage=Stage.ESTIMATE if config.trials else Stage.THRESHOLD)

    def _apart(self, place: int, hunt: Hunt) -> Hunt:
        """Return a hunt, ended if another one along the same unit is at a place close by.

        Only where chance has no part: there, a threshold costs so little that many would lie side by side.
        """
        if self._config.trials or hunt.stage not in OPEN:
            return hunt
        others = [
            self._simulated.row(one.unsafe)
            for index, one in enumerate(self.hunts)
            if one.unit == hunt.unit and index != place and one.stage in (Stage.BRACKET, Stage.THRESHOLD)
        ]
        ends = np.array([self._simulated.row(hunt.safe), self._simulated.row(hunt.unsafe)])
        if not others:
            return hunt
        is_close = (self._metric.between(ends, np.array(others)) < APART).all(axis=0).any()
        return replace(hunt, stage=Stage.REPEATED) if is_close else hunt

    def _conclude(self, place: int, hunt: Hunt) -> None:
        """Estimate the threshold of a hunt, and end it if enough is known."""
        stages = {Outcome.THRESHOLD: Stage.THRESHOLD, Outcome.CHANCY: Stage.CHANCY}
        found = estimate_of(self._state, hunt, self._parts, self._simulated)
        stage = stages.get(found.outcome, Stage.ESTIMATE)
        if stage is Stage.ESTIMATE and found.trials >= FEWEST and found.chancy >= HOPELESS:
            stage = Stage.CHANCY
        self.hunts[place] = replace(hunt, stage=stage)
        self.estimates.pop(place, None)
        if stage is Stage.ESTIMATE:
            self.estimates[place] = found


def line_of(hunt: Hunt, parts: Parts, simulated: Simulated) -> Line:
    """Return the line of a hunt whose unit is known."""
    unit = parts.units[hunt.unit]
    return Line(parts.space, unit, simulated.row(hunt.start), simulated.row(hunt.end))


def far_row(hunt: Hunt, parts: Parts, simulated: Simulated) -> FloatArray | None:
    """Return the unsafe end moved to the limit of its range, to look for a window.

    None if the limit is not far away, or if several numbers move together.
    """
    unit = parts.units[hunt.unit]
    if len(unit) > 1:
        return None
    column, parameter = unit[0], parts.space.parameters[unit[0]]
    safe, unsafe = simulated.row(hunt.start)[column], simulated.row(hunt.end)[column]
    row = np.array(simulated.row(hunt.end))
    row[column] = parameter.most if unsafe > safe else parameter.least  # type: ignore[union-attr]
    if abs(row[column] - unsafe) < FAR * parts.space.ranges[column]:
        return None
    return valid_change(parts.space, simulated.row(hunt.end), row, unit)


def probe_rows(hunt: Hunt, parts: Parts, simulated: Simulated, config: ThresholdConfig) -> list[FloatArray]:
    """Return solutions within a hunt's bracket that divide it; none if it is narrow enough."""
    line = line_of(hunt, parts, simulated)
    low, high = (line.place_of(simulated.row(number)) for number in (hunt.safe, hunt.unsafe))
    if high - low <= max(line.resolution, COARSE if config.trials else 0.0):
        return []
    count = PROBES if config.trials else 1
    rows = [line.at(low + (high - low) * part / (count + 1)) for part in range(1, count + 1)]
    within = [row for row in rows if row is not None and low < line.place_of(row) < high]
    return list({row.tobytes(): row for row in within}.values())


def prior_of(hunt: Hunt, line: Line, simulated: Simulated) -> CurvePrior:
    """Return the prior of the curve of a hunt: its bracket and what the problem says of its unit."""
    safe, unsafe = (line.place_of(simulated.row(number)) for number in (hunt.safe, hunt.unsafe))
    return CurvePrior(
        safe=max(safe, 0.0), unsafe=min(unsafe, 1.0), resolution=line.resolution, range=line.range
    )


def estimate_of(state: ThresholdState, hunt: Hunt, parts: Parts, simulated: Simulated) -> Estimate:
    """Return the estimate of a hunt's threshold from its trials."""
    line = line_of(hunt, parts, simulated)
    trials = Trials(
        places=np.array([line.place_of(simulated.row(number)) for number in hunt.trials]),
        unsafe=np.array([simulated.unsafe(number) for number in hunt.trials], np.bool_),
    )
    rng = generator(state.ledger.seed, Stream.THRESHOLDS, Draw.ESTIMATE, hunt.held, hunt.unit, len(trials))
    return estimate(prior_of(hunt, line, simulated), trials, rng, most=state.config.trials)
