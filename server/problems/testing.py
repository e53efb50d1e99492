"""Contract tests for problems, to be run from your own tests; `brink plugins check` runs them on every plug-in."""

import math
from collections.abc import Callable
from typing import Any, Final

from brink.search.algorithm import Evaluation, Scored
from brink.search.streams import Stream, episode_seed, generator
from brink.server.problems.base import InProcessProblem, Problem, SimulatedProblem, Vectors
from brink.sim.catalogue import Simulator, make_simulator
from brink.sim.testing import ContractBroken, check_simulator
from brink.worker.child_protocol import completed_document
from brink.worker.wire import Completed

CANDIDATES: Final = 6


def check_problem(
    make: Callable[[], Problem],
    *,
    simulator: Callable[[], Simulator] | None = None,
    candidates: int = CANDIDATES,
    seed: int = 1,
) -> None:
    """Check that a problem fulfils its contract, and its simulator as well.

    Clauses: the id is versioned; the same candidate gives the same episode, for the simulator that the problem needs;
    the simulator passes `check_simulator` on these episodes; every result gets a verdict, with a finite robustness
    and finite objectives, and the same one each time.

    Args:
        make: Returns the problem, with the parameters to check.
        simulator: Returns a new simulator; None for the one that is registered under the id that the problem needs.
        candidates: Number of random candidates, at least 2.
        seed: Determines the candidates.

    Raises:
        ContractBroken: A clause is broken.
        SimulatorError: The simulator is not registered here, or failed.
    """
    problem, other = make(), make()
    _expect("@" in problem.id, "a versioned id, such as name@1", problem.id)
    drawn: list[tuple[Vectors, int]] = [
        (problem.space.sample(generator(seed, Stream.CONTRACT, number)), episode_seed(seed, number))
        for number in range(candidates)
    ]
    if isinstance(problem, InProcessProblem):
        assert isinstance(other, InProcessProblem)
        for vectors, _ in drawn:
            _check_same(problem.evaluate(vectors), other.evaluate(vectors))
        return
    assert isinstance(other, SimulatedProblem)
    specs = [problem.episode(vectors, number) for vectors, number in drawn]
    for spec, again in zip(specs, (other.episode(vectors, number) for vectors, number in drawn), strict=True):
        _expect(spec.digest() == again.digest(), f"the same episode again: {spec.canonical_json()}", again)
        _expect(spec.simulator == problem.needs, f"an episode for {problem.needs}", spec.simulator)
    new_simulator = simulator if simulator is not None else lambda: make_simulator(problem.needs)
    check_simulator(new_simulator, specs)
    running = new_simulator()
    for spec in specs:
        outcome = Completed.model_validate(completed_document(running.run(spec)))
        _check_same(problem.evaluation(outcome), other.evaluation(outcome))


def _check_same(evaluation: Evaluation, again: Evaluation) -> None:
    _expect(evaluation == again, f"the same evaluation again: {evaluation}", again)
    if isinstance(evaluation, Scored):
        numbers = [evaluation.robustness, *evaluation.objectives.values()]
        _expect(all(map(math.isfinite, numbers)), "finite robustness and objectives", evaluation)


def _expect(holds: bool, clause: str, shown: Any) -> None:
    if not holds:
        raise ContractBroken(f"expected: {clause}; got {shown!r}")
