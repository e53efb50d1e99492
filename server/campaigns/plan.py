"""What a campaign's body asks for: its problem, its algorithm, its first generation, its archive."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from brink.search.algorithm import Algorithm, Candidate, Question, Seeded, SeedRequest
from brink.search.algorithms.multi_objective import MultiObjectiveConfig
from brink.search.algorithms.repeats import RepeatsConfig
from brink.search.archive import Archive, Neighbourhood
from brink.search.streams import episode_seed
from brink.server.campaigns.body import CampaignBody, PluginChoice
from brink.server.campaigns.values import NewJob, NewSolution, StoredArchive
from brink.server.errors import FieldError, InvalidInput
from brink.server.problems.base import InProcessProblem, MeasuresOnData, Problem, SimulatedProblem
from brink.server.problems.catalogue import make_algorithm, make_params, make_problem, read_problem_params
from brink.server.states import JobKind


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """A campaign's problem and algorithm, made from its body."""

    problem: Problem
    algorithm: Algorithm
    config: Any
    neighbourhood: Neighbourhood
    body: CampaignBody
    """With every parameter spelled out: what is stored, so that no later default changes a campaign."""


def make_plan(body: CampaignBody) -> Plan:
    """Return the problem and the algorithm of a campaign, checked against each other.

    Raises:
        InvalidInput: With a pointer to each wrong field.
    """
    problem_params = read_problem_params(body.problem.id, body.problem.params)
    problem = make_problem(body.problem.id, asdict(problem_params))
    algorithm = make_algorithm(body.algorithm.id)
    known = set(algorithm.config_type.__dataclass_fields__)
    defaults = {name: value for name, value in problem.algorithm_defaults.items() if name in known}
    config = make_params(algorithm.config_type, {**defaults, **body.algorithm.params}, "/algorithm/params")
    neighbourhood = Neighbourhood.of(config)
    resolved = body.model_copy(
        update={
            "problem": PluginChoice(id=body.problem.id, params=asdict(problem_params)),
            "algorithm": PluginChoice(id=body.algorithm.id, params=asdict(config)),
        }
    )
    return Plan(
        problem=problem, algorithm=algorithm, config=config, neighbourhood=neighbourhood, body=resolved
    )


def looks_for_boundary(algorithm_id: str) -> bool:
    """Return whether an algorithm looks for the hazard boundary; others look for different violations."""
    try:
        algorithm = make_algorithm(algorithm_id)
    except InvalidInput:  # a plug-in that is not here: its campaigns can be looked at all the same
        return True
    return not issubclass(algorithm.config_type, MultiObjectiveConfig | RepeatsConfig)


@dataclass(frozen=True, slots=True, kw_only=True)
class Live:
    """A campaign's state in memory: its pending generation is what the database calls the current one."""

    plan: Plan
    generation: int
    state: Any


def first_generation(body: CampaignBody) -> tuple[Live, list[NewSolution]]:
    """Return the state of a new campaign with its first generation asked, and that generation's rows."""
    plan = make_plan(body)
    state = plan.algorithm.start(
        plan.problem.space, plan.config, seed=body.seed, budget=body.budget.simulations
    )
    state, candidates = asked(plan, state)
    return Live(plan=plan, generation=0, state=state), new_solutions(
        plan.problem, candidates, state, body.seed
    )


def asked(plan: Plan, state: Any) -> tuple[Any, tuple[Candidate, ...]]:
    """Return a state with its next generation asked, and that; none while it is finished, or waits for seeds."""
    if wanted_seeds(plan, state) is not None or plan.algorithm.finished(state):
        return state, ()
    return plan.algorithm.ask(state)


def wanted_seeds(plan: Plan, state: Any) -> SeedRequest | None:
    """Return what seeds an algorithm waits for, or None."""
    return plan.algorithm.wanted(state) if isinstance(plan.algorithm, Seeded) else None


def new_solutions(
    problem: Problem, candidates: Sequence[Candidate], state: Any, campaign_seed: int
) -> list[NewSolution]:
    """Return the rows of a generation that was asked for.

    Args:
        problem: What is searched.
        candidates: The generation.
        state: The algorithm's; may say where candidates come from.
        campaign_seed: The campaign's seed.

    Raises:
        InvalidInput: A data-set evaluation is asked of a problem that has none.
    """
    solutions = []
    origins = getattr(state, "queue_origins", None) or [None] * len(candidates)
    for candidate, origin in zip(candidates, origins, strict=True):
        chance = candidate.number if candidate.seed_number is None else candidate.seed_number
        seed = episode_seed(campaign_seed, chance)
        job = None if isinstance(problem, InProcessProblem) else _job(problem, candidate, seed)
        if candidate.question is Question.DATASET and job is None:
            raise _no_data(problem)
        kind = JobKind.DATASET if candidate.question is Question.DATASET else JobKind.EPISODE
        solutions.append(
            NewSolution(
                number=candidate.number,
                vector=vector_bytes(candidate),
                seed=seed,
                job=job,
                kind=kind,
                origin=None if origin is None else str(origin),
            )
        )
    return solutions


def _job(problem: SimulatedProblem, candidate: Candidate, seed: int) -> NewJob:
    if candidate.question is Question.DATASET:
        if not isinstance(problem, MeasuresOnData):
            raise _no_data(problem)
        spec = problem.dataset_evaluation(candidate.vectors)
        needs, timeout_s = problem.dataset_needs, problem.dataset_timeout_s
    else:
        spec = problem.episode(candidate.vectors, seed)
        needs, timeout_s = problem.needs, problem.timeout_s
    return NewJob(spec=spec.canonical_json(), spec_hash=spec.digest(), needs=needs, timeout_s=timeout_s)


def _no_data(problem: Problem) -> InvalidInput:
    message = f"this algorithm measures on a data set, which {problem.id} does not have"
    return InvalidInput([FieldError(pointer="/algorithm/id", message=message)])


def vector_bytes(candidate: Candidate) -> bytes:
    """Return a complete solution as it is stored."""
    return np.concatenate(candidate.vectors).astype("<f8").tobytes()


def restored_archive(plan: Plan, stored: StoredArchive) -> Archive:
    """Return the archive that was stored, without computing a distance."""
    return Archive.restore(
        plan.problem.space,
        plan.neighbourhood,
        numbers=stored.numbers,
        vectors=stored.vectors,
        unsafe=stored.unsafe,
        robustness=stored.robustness,
        neighbours=stored.neighbours,
        unsafe_neighbours=stored.unsafe_neighbours,
    )
