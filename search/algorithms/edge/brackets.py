"""How a generation's evaluations open, narrow and check brackets."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from brink.search.algorithm import Candidate, Evaluation, Scored
from brink.search.algorithms.edge.prior import least_clear
from brink.search.algorithms.edge.state import Bracket, EdgeConfig, EdgeState, Job, Purpose, Solutions, Status
from brink.search.pairs import Steps, midpoints
from brink.search.space import BoolArray, FloatArray

MAX_FAILURES: Final = 3
"""Probes or checks of a bracket that may fail before it is given up."""


def clear_solutions(state: EdgeState) -> BoolArray:
    """Return which solutions of the archive are not too close to call, shape ``(n,)``."""
    archive = state.ledger.archive
    safe, unsafe = least_clear(archive, state.ledger.known, state.config.margin)
    clear: BoolArray = np.abs(archive.robustness) >= np.where(archive.unsafe, unsafe, safe)
    return clear


def learnt(
    state: EdgeState, told: Sequence[Candidate], jobs: Sequence[Job], evaluations: Mapping[int, Evaluation]
) -> EdgeState:
    """Return the state with brackets opened, narrowed and checked by a generation's evaluations.

    Args:
        state: The state whose ledger has been told the generation.
        told: The generation.
        jobs: The purpose of each of its candidates.
        evaluations: Its evaluations, by number.
    """
    lesson = _Lesson(state)
    for candidate, (purpose, of, side) in zip(told, jobs, strict=True):
        evaluation = evaluations[candidate.number]
        scored = evaluation if isinstance(evaluation, Scored) else None
        if candidate.seed_number is not None:
            lesson.seeds[candidate.number] = candidate.seed_number
        if purpose is Purpose.PARTNER and scored is not None:
            lesson.take_partner(candidate.number, of, unsafe=scored.unsafe)
        elif purpose in (Purpose.PROBE, Purpose.CHECK) and scored is None:
            lesson.take_failure(of, purpose)
        elif purpose is Purpose.PROBE and scored is not None:
            lesson.take_probe(candidate.number, of, unsafe=scored.unsafe)
        elif purpose is Purpose.CHECK and scored is not None:
            lesson.take_check(of, side, unsafe=scored.unsafe)
    lesson.drop_near()
    return replace(
        state,
        brackets=tuple(lesson.brackets),
        seeds=lesson.seeds,
        partnered=state.partnered + sum(purpose is Purpose.PARTNER for purpose, _, _ in jobs),
        resolved=tuple(lesson.resolved),
    )


class _Lesson:
    """The brackets of a state while a generation's evaluations change them.

    Attributes:
        brackets: All brackets.
        seeds: As in the state.
        resolved: As in the state.
    """

    def __init__(self, state: EdgeState) -> None:
        self._archive = state.ledger.archive
        self._solutions = Solutions(self._archive)
        self._steps = Steps(state.ledger.space)
        self._clear = clear_solutions(state)
        self._config = state.config
        self._prior = state.prior
        self.brackets = list(state.brackets)
        self.seeds = dict(state.seeds)
        self.resolved = list(state.resolved)

    def take_partner(self, number: int, anchor: int, *, unsafe: bool) -> None:
        """Open a bracket if a partner changed the verdict and is not too close to call."""
        place = self._solutions.place
        if unsafe != self._archive.unsafe[place(anchor)] and self._clear[place(number)]:
            safe_side, unsafe_side = (anchor, number) if unsafe else (number, anchor)
            opened = Bracket(safe=safe_side, unsafe=unsafe_side, seed=self.seeds.get(anchor, anchor))
            self.brackets.append(self._narrowed(opened))

    def take_failure(self, of: int, purpose: Purpose) -> None:
        """Count a probe or check that failed; probes of brackets that are no longer open do not count."""
        bracket = self.brackets[of]
        if purpose is Purpose.PROBE and bracket.status is not Status.OPEN:
            return
        failures = bracket.failures + 1
        status = Status.GIVEN_UP if failures >= MAX_FAILURES else bracket.status
        self.brackets[of] = replace(bracket, failures=failures, status=status)

    def take_probe(self, number: int, of: int, *, unsafe: bool) -> None:
        """Let a probe replace the side with the same verdict."""
        bracket = self.brackets[of]
        if bracket.status is Status.OPEN:
            narrower = replace(bracket, unsafe=number) if unsafe else replace(bracket, safe=number)
            self.brackets[of] = self._narrowed(narrower)

    def take_check(self, of: int, side: int, *, unsafe: bool) -> None:
        """Count a check, and record the bracket as resolved if it was the last one, or changed the verdict."""
        self.brackets[of] = _checked(self.brackets[of], side, unsafe, self._config.checks)
        if self.brackets[of].status in (Status.KEPT, Status.CHANCY):
            self.resolved.append(of)

    def _narrowed(self, bracket: Bracket) -> Bracket:
        row = self._solutions.row
        if not self._steps.is_tight(row(bracket.safe), row(bracket.unsafe), self._config.eps):
            return replace(bracket, status=Status.OPEN)
        return replace(bracket, status=Status.TIGHT if self._config.checks else Status.KEPT)

    def drop_near(self) -> None:
        """Drop the open brackets that will probably end closer to a tight pair than distinct pairs may be.

        Tight pairs among the known results count as well.

        Their middle may still move by almost half their length. One that was dropped because of a pair that turned
        out chancy is opened again as soon as some other pair is tight.
        """
        brackets, steps = self.brackets, self._steps
        tight = [b for b in brackets if b.status in (Status.TIGHT, Status.KEPT)]
        places = [place for place, b in enumerate(brackets) if b.status in (Status.OPEN, Status.NEAR)]
        middles = [midpoints(*ends(tight, self._solutions), steps.space)] if tight else []
        if self._prior is not None and len(self._prior.middles):
            middles.append(self._prior.middles)
        if not middles or not places:
            return
        safe, unsafe = ends([brackets[place] for place in places], self._solutions)
        lengths = np.array([steps.distance(a, b) for a, b in zip(safe, unsafe, strict=True)])
        towards = steps.metric.between(midpoints(safe, unsafe, steps.space), np.concatenate(middles))
        near: BoolArray = towards + 0.25 * lengths[:, None] < self._config.d_th
        for place, drop in zip(places, near, strict=True):
            brackets[place] = replace(brackets[place], status=Status.NEAR if drop.any() else Status.OPEN)


def ends(brackets: Sequence[Bracket], solutions: Solutions) -> tuple[FloatArray, FloatArray]:
    """Return the safe and the unsafe sides of brackets, both shape ``(n, d)``."""
    return (
        np.array([solutions.row(b.safe) for b in brackets]),
        np.array([solutions.row(b.unsafe) for b in brackets]),
    )


def _checked(bracket: Bracket, side: int, unsafe: bool, checks: int) -> Bracket:
    if unsafe != bool(side):
        return replace(bracket, status=Status.CHANCY)
    if side:
        bracket = replace(bracket, unsafe_checks=bracket.unsafe_checks + 1)
    else:
        bracket = replace(bracket, safe_checks=bracket.safe_checks + 1)
    done = min(bracket.safe_checks, bracket.unsafe_checks) >= checks
    return replace(bracket, status=Status.KEPT) if done else bracket


def cost(length: float, config: EdgeConfig) -> float:
    """Return how many simulations a bracket of the given length is expected to take until it is checked."""
    return math.ceil(math.log2(max(length / config.eps, 1.0))) + 2.0 * config.checks


def checks_left(bracket: Bracket, config: EdgeConfig) -> int:
    """Return how many checks a tight pair still needs."""
    return 2 * config.checks - bracket.safe_checks - bracket.unsafe_checks
