"""Turns a campaign's body into a search: makes and checks problem and algorithm, asks for the first generation."""

import itertools
import logging
import secrets
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from operator import itemgetter
from typing import Any, Final, TypeVar

import numpy as np
from sqlalchemy import Connection

from brink.search.algorithm import (
    UNDECLARED,
    AnyAlgorithm,
    Candidate,
    Known,
    KnowsFlight,
    OpaqueAlgorithm,
    Question,
    Seeded,
    SeedRequest,
    State,
    WarmStarts,
    ask_each,
    declared_finds,
    declared_minimises,
)
from brink.search.analysis.boundary import MOST_COST, IndexArray, distinct_boundary
from brink.search.archive import ARRAYS, Archive, Neighbourhood
from brink.search.errors import ConfigError, UnsupportedSpace
from brink.search.streams import episode_seed
from brink.server.campaigns import step_store, store
from brink.server.campaigns.body import DEFAULT_D_TH, DEFAULT_T_B, CampaignBody, PluginChoice, StartFrom
from brink.server.campaigns.known import KnownRecord, given_records, insert_known, known_of
from brink.server.campaigns.memory import memory_of
from brink.server.campaigns.step_store import PIECE, Asked, NewSolution, StoredArchive
from brink.server.campaigns.store import CAMPAIGNS, Campaign
from brink.server.errors import FieldError, InvalidInput
from brink.server.problems.base import InProcessProblem, MeasuresOnData, Problem, SimulatedProblem
from brink.server.problems.catalogue import (
    ALGORITHMS,
    algorithms_that,
    config_field_error,
    make_algorithm,
    make_params,
    run_plugin,
    spelled_out,
)
from brink.server.queue.job_store import NewJob
from brink.server.seeding import Access, seeder
from brink.server.states import JobKind
from brink.server.user_code import USER_CODE, guarded_like
from brink.sim.catalogue import GROUPS, named_sources, with_sources
from brink.sim.episode import digest_of

T = TypeVar("T")

log = logging.getLogger(__name__)

SIZE_GROWTH: Final = 1.25
"""A search is measured again once its number of generations has grown by this factor."""
MOST_IN_FLIGHT: Final = 20_000
"""Maximum number of candidates that a submitted campaign may have in flight. A thousand workers that simulate eight
each keep 8,000 in flight."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """The problem and the algorithm of a campaign.

    Attributes:
        config: The algorithm's parameters.
        body: The body with every parameter spelled out. It is stored in this form, so that new defaults in later
            versions do not change the campaign.
    """

    problem: Problem
    algorithm: OpaqueAlgorithm
    config: object
    neighbourhood: Neighbourhood
    body: CampaignBody

    @property
    def finds(self) -> tuple[str, ...]:
        """The kinds of findings that the algorithm declares."""
        return declared_finds(self.algorithm)

    def is_for(self, kind: str) -> bool:
        """Return whether the search is for a kind of finding: the first that its algorithm declares."""
        return self.finds[:1] == (kind,)


@dataclass(frozen=True, slots=True, kw_only=True)
class LiveSearch:
    """A campaign's search in memory.

    What it asks for is stored in pieces. Nothing is told before all of it is stored: a search that had been told a
    generation before it asked for the last one in flight would depend on who was fast.

    Attributes:
        generation: Number of generations told.
        asked: Number of generations asked for.
        state: The algorithm's state.
        unstored: Candidates that were asked for and are not stored yet, each with the number of its generation.
        is_stored: Whether nothing is left to ask for or to store before the next generation is told.
        size: About how much memory the state takes, in bytes, as last measured.
        sized_at: Number of generations told when it was measured.
    """

    plan: Plan
    generation: int
    asked: int
    state: State
    unstored: tuple[tuple[int, Candidate], ...] = ()
    is_stored: bool = False
    size: int = 0
    sized_at: int = 0

    def measured(self) -> "LiveSearch":
        """Return the search with its size, measured again if it has grown much; slow if the search is large."""
        if self.size and self.generation <= SIZE_GROWTH * self.sized_at:
            return self
        plan = self.plan
        size = memory_of(self.state, without=(plan, plan.problem, plan.algorithm, plan.config))
        return replace(self, size=size, sized_at=self.generation)


@dataclass(frozen=True, slots=True, kw_only=True)
class Start:
    """The prior knowledge of a campaign, resolved.

    Attributes:
        records: The known solutions.
        start_from: The field of its body, with every value spelled out.
    """

    records: Sequence[KnownRecord]
    start_from: StartFrom


@dataclass(frozen=True, slots=True, kw_only=True)
class PreparedCampaign:
    """A checked campaign that is not stored yet.

    Attributes:
        body: The body as it was submitted.
        plan: Its plan.
        row: Its row in the database.
        first: Its search, and the first piece of what that asks for; None to leave both to its first step.
        known: What it starts from.
    """

    id: str
    body: CampaignBody
    plan: Plan
    row: Mapping[str, Any]
    first: tuple[LiveSearch, Asked] | None
    known: Sequence[KnownRecord] = field(default=())


def make_plan(body: CampaignBody) -> Plan:
    """Make the problem and the algorithm of a campaign.

    Raises:
        InvalidInput: With a pointer to each invalid field.
        CodeStalled: A plug-in did not return in time.
    """
    problem, problem_params = spelled_out(body.problem.id, body.problem.params)
    if body.ground_truth:
        problem = with_truth(problem)
    algorithm = make_algorithm(body.algorithm.id)
    settings = set(algorithm.config_type.__dataclass_fields__)
    defaults = {name: value for name, value in problem.algorithm_defaults.items() if name in settings}
    values = {**defaults, **body.algorithm.params}
    config = run_plugin(
        ALGORITHMS,
        body.algorithm.id,
        "config_type",
        lambda: make_params(algorithm.config_type, values, "/algorithm/params"),
    )
    resolved = body.model_copy(
        update={
            "problem": PluginChoice(id=body.problem.id, params=problem_params),
            "algorithm": PluginChoice(id=body.algorithm.id, params=asdict(config)),
            "sources": _sources(problem, problem_params, body.algorithm.id, asdict(config)),
        }
    )
    return Plan(
        problem=problem,
        algorithm=algorithm,
        config=config,
        neighbourhood=Neighbourhood.of(config),
        body=resolved,
    )


def _sources(
    problem: Problem, params: Mapping[str, Any], algorithm: str, config: Mapping[str, Any]
) -> dict[str, str]:
    """Return the digests of the sources of all plug-ins that decide a campaign's results, except Brink's own."""
    run = [problem.needs] if isinstance(problem, SimulatedProblem) else []
    run += problem.requirements
    return named_sources([problem.id, params, algorithm, config, run], GROUPS)


def with_truth(problem: Problem) -> SimulatedProblem:
    """Return a problem with ground truth in place of its component.

    Raises:
        InvalidInput: It has no component that can be replaced.
    """
    if not isinstance(problem, SimulatedProblem) or not problem.has_component:
        message = f"{problem.id} has no component that ground truth can replace"
        raise InvalidInput.at("/ground_truth", message)
    truth = problem.with_truth()
    if truth is None:
        message = (
            f"{problem.id} has ground truth in place of a component already: its scenarios alone are to blame"
        )
        raise InvalidInput.at("/ground_truth", message)
    truth.space = problem.space  # the same, within the ODD
    return guarded_like(problem, truth)


def make_checked_plan(body: CampaignBody) -> Plan:
    """Make the plan of a campaign, and check that the campaign can run.

    Raises:
        InvalidInput: With a pointer to each invalid field.
    """
    plan = make_plan(body)
    # It may load what a user brought: a detector, a function, an environment.
    if wrong := USER_CODE.call(plan.problem.id, "its inputs", plan.problem.wrong_inputs):
        raise InvalidInput(
            [FieldError(pointer=f"/problem/params/{name}", message=message) for name, message in wrong]
        )
    _check_criticality(plan)
    _check_measures(plan)
    seeder().check(body.llm, plan.config, body.algorithm.id, plan.problem)
    if body.start_from is not None and not isinstance(plan.algorithm, WarmStarts):
        able = ", ".join(algorithms_that(WarmStarts))
        message = f"{body.algorithm.id} cannot start from known solutions; {able} can"
        raise InvalidInput.at("/start_from", message)
    if body.repeats:
        check_repeatable(plan)
    _check_flight(plan)
    try:
        plan.algorithm.check(plan.problem.space, plan.config, budget=body.budget.simulations)
    except UnsupportedSpace as error:
        message = f"{body.algorithm.id} cannot search the space of {body.problem.id}: {error}"
        raise InvalidInput.at("/algorithm/id", message) from None
    except ConfigError as error:
        if error.field == "budget":
            raise InvalidInput.at("/budget/simulations", str(error).removeprefix("budget: ")) from None
        raise InvalidInput([config_field_error(error, "/algorithm/params")]) from None
    return plan


def check_repeatable(plan: Plan) -> None:
    """Check that other seeds can change the verdict on a solution.

    Raises:
        InvalidInput: The problem is computed, not simulated.
    """
    if plan.problem.ignores_seeds:
        message = f"{plan.body.problem.id} is computed, not simulated: other seeds give the same verdicts"
        raise InvalidInput.at("/repeats", message)


def _check_flight(plan: Plan) -> None:
    """Check that a search does not keep more candidates in flight than a coordinator should hold.

    Stored campaigns need not pass this: older versions accepted more.

    Raises:
        InvalidInput: It does.
    """
    if not isinstance(plan.algorithm, KnowsFlight):
        return
    size, generations = plan.algorithm.flight(plan.config)
    if min(size * generations, plan.body.budget.simulations) <= MOST_IN_FLIGHT:
        return
    name = next(
        (one for one in ("generation_size", "population_size") if hasattr(plan.config, one)), "params"
    )
    most = f"expected at most {MOST_IN_FLIGHT:,} candidates in flight"
    if generations == 1:
        message = f"{most}, got up to {size:,} in one generation; choose a smaller {name}"
        raise InvalidInput.at(f"/algorithm/params/{name}", message)
    message = (
        f"{most}, got {name} {size:,} x in_flight {generations:,} = {size * generations:,}; with this {name}, "
        f"in_flight may be at most {max(1, MOST_IN_FLIGHT // size):,}"
    )
    raise InvalidInput.at("/algorithm/params/in_flight", message)


def _is_large(plan: Plan) -> bool:
    """Return whether a search has generations of more than a piece."""
    return isinstance(plan.algorithm, KnowsFlight) and plan.algorithm.flight(plan.config)[0] > PIECE


def _check_measures(plan: Plan) -> None:
    """Check that the problem has what an algorithm needs that collects kinds of behaviour.

    Raises:
        InvalidInput: It declares no measures.
    """
    problem = plan.problem
    if not getattr(plan.algorithm, "needs_measures", False) or problem.measures or problem.names_niches:
        return
    message = (
        f"{plan.body.algorithm.id} collects solutions by measures of what they do, and {plan.body.problem.id} "
        "declares none: choose a problem that has measures, or another algorithm"
    )
    raise InvalidInput.at("/algorithm/id", message)


def _check_criticality(plan: Plan) -> None:
    """Check that an algorithm guided by criticality is guided towards violations of the requirement.

    Stored campaigns need not pass this: older versions accepted what is rejected here.

    Raises:
        InvalidInput: It is not.
    """
    if not getattr(plan.config, "by_criticality", False):
        return
    if (wrong := plan.problem.wrong_criticality()) is not None:
        name, message = wrong
        raise InvalidInput.at(f"/problem/params/{name}", message)


def check_submission(body: CampaignBody, start: Start | None = None) -> tuple[LiveSearch, Asked]:
    """Check that a campaign can run, and return its search with the first piece of what it asks for.

    Args:
        body: The campaign's body.
        start: What it starts from. None if it starts from nothing, or if that is not at hand: solutions in the body
            are then read from there, and an earlier campaign is left to the coordinator that has it.

    Raises:
        InvalidInput: With a pointer to each invalid field.
    """
    return _begun(make_checked_plan(body), body, start)


def _begun(plan: Plan, body: CampaignBody, start: Start | None) -> tuple[LiveSearch, Asked]:
    given = body.start_from.solutions if body.start_from is not None else None
    if start is not None:
        records, body = start.records, body.model_copy(update={"start_from": start.start_from})
    else:
        records = given_records(plan.problem.space, given) if given is not None else ()
    try:
        return first_generations(body, records)
    except ConfigError as error:  # more points than the budget has simulations
        message = f"{str(error).removeprefix('budget: ')}; start_from.limit takes fewer"
        raise InvalidInput.at("/budget/simulations", message) from None


def prepare_campaign(
    body: CampaignBody, start: Start | None = None, access: Access | None = None, *, asks: bool = True
) -> PreparedCampaign:
    """Check a campaign and start its search.

    Args:
        body: The campaign's body.
        start: What it starts from; None for nothing.
        access: What campaigns may call; None for this machine alone, without a key.
        asks: Whether to start the search now, and not with the campaign's first step. A search with large
            generations starts with that anyway, unless it starts from something: other submissions wait for this one.

    Raises:
        InvalidInput: With a pointer to each invalid field.
    """
    (access or seeder().access("")).check(body.llm)
    plan = make_checked_plan(body)
    first = None
    if asks and (start is not None or not _is_large(plan)):
        first = _begun(plan, body, start)
        plan = first[0].plan
    known = () if start is None else start.records
    campaign_id = secrets.token_hex(4)
    row = store.campaign_row(campaign_id, plan.body, body.document_hash())
    return PreparedCampaign(id=campaign_id, body=body, plan=plan, row=row, first=first, known=known)


def store_campaigns(
    connection: Connection, campaigns: Sequence[PreparedCampaign], key: str | None = None
) -> None:
    """Store campaigns, each with the first piece of what its search asks for.

    Args:
        connection: In a write transaction.
        campaigns: The campaigns, whose first pieces have no more solutions together than one piece may have.
        key: Idempotency key of a single campaign.
    """
    store.insert_campaigns(connection, [campaign.row for campaign in campaigns], key)
    for campaign in campaigns:
        store.insert_tags(connection, campaign.id, campaign.plan.body.tags)
        insert_known(connection, campaign.id, campaign.known)
        if campaign.first is not None:
            step_store.insert_generations(
                connection, CAMPAIGNS.get(connection, campaign.id), campaign.first[1]
            )


def store_campaign(connection: Connection, campaign: PreparedCampaign) -> Campaign:
    """Store one campaign with the first piece of what its search asks for, and return it."""
    store_campaigns(connection, [campaign])
    return CAMPAIGNS.get(connection, campaign.id)


def finds_of(algorithm_id: str) -> tuple[str, ...]:
    """Return the kinds of findings that an algorithm declares; the boundary if it cannot be loaded."""
    algorithm = _loaded(algorithm_id)
    return UNDECLARED if algorithm is None else declared_finds(algorithm)


def minimises_of(algorithm_id: str) -> str:
    """Return the name of what an algorithm minimises; empty for nothing, or if it cannot be loaded."""
    algorithm = _loaded(algorithm_id)
    return "" if algorithm is None else declared_minimises(algorithm)


def _loaded(algorithm_id: str) -> AnyAlgorithm | None:
    try:
        return make_algorithm(algorithm_id)
    except InvalidInput:  # campaigns can be viewed without their plug-ins
        return None
    except Exception:  # and with plug-ins that fail, or do not return
        log.exception("plug-in cannot be loaded", extra={"plugin": algorithm_id})
        return None


def find_boundary(archive: Archive, t_b: float, d_th: float) -> IndexArray:
    """Return the distinct boundary solutions as positions in the archive, best first, unless that takes too long.

    At the usual thresholds, they are counted with each generation, and may be counted once more.

    Args:
        archive: The evaluated solutions.
        t_b: Maximum fitness of a boundary solution.
        d_th: Minimum distance between two boundary solutions.

    Raises:
        BoundaryTooLarge: There are too many to compare with each other.
    """
    usual = (t_b, d_th) == (DEFAULT_T_B, DEFAULT_D_TH)
    return distinct_boundary(archive, t_b, d_th, most_cost=None if usual else MOST_COST)


def first_generations(body: CampaignBody, known: Sequence[KnownRecord] = ()) -> tuple[LiveSearch, Asked]:
    """Start a campaign's search; return it with the first piece of what it asks for.

    Args:
        body: The campaign's body.
        known: What it starts from.
    """
    live, asked = next_piece(start_search(body, known))
    return live.measured(), asked


def start_search(body: CampaignBody, known: Sequence[KnownRecord] = ()) -> LiveSearch:
    """Return a campaign's search, which has not asked for anything.

    Args:
        body: The campaign's body.
        known: What it starts from.
    """
    plan = make_plan(body)
    state = _first_state(plan, known_of(known, plan.problem.space.dimension))
    return LiveSearch(plan=plan, generation=0, asked=0, state=state)


def _first_state(plan: Plan, known: Known) -> State:
    space, seed, budget = plan.problem.space, plan.body.seed, plan.body.budget.simulations
    if not len(known) and not len(known.points):
        return plan.algorithm.start(space, plan.config, seed=seed, budget=budget)
    assert isinstance(plan.algorithm, WarmStarts)  # checked on submission
    state: State = plan.algorithm.start_with(space, plan.config, seed=seed, budget=budget, known=known)
    return state


def ask_more(live: LiveSearch, most: int) -> LiveSearch:
    """Return a search after it has asked for further generations that may be in flight.

    Args:
        live: The search. It asks for nothing if it is over or waits for seeds.
        most: It stops once more candidates than this are not stored.
    """
    unstored = list(live.unstored)
    if seed_request(live.plan, live.state) is not None:
        return live
    generations = ask_each(live.plan.algorithm, live.state)
    while (asked := of_state(live.plan, "ask", lambda: next(generations, None))) is not None:
        state, candidates = asked
        unstored += [(live.asked, candidate) for candidate in candidates]
        live = replace(live, state=state, asked=live.asked + 1)
        if len(unstored) > most:
            break
    return replace(live, unstored=tuple(unstored))


def next_piece(live: LiveSearch) -> tuple[LiveSearch, Asked]:
    """Take the next solutions to store from what a search asks for, at most `PIECE`.

    Args:
        live: The search, of which something may be left to ask for or to store.

    Returns:
        The search without them, and the solutions with their simulations.

    Raises:
        InvalidInput: The algorithm needs a data set, which the problem does not have.
    """
    asking = ask_more(live, PIECE)
    piece, left = asking.unstored[:PIECE], asking.unstored[PIECE:]
    state = asking.state
    pending = of_state(live.plan, "pending", lambda: tuple(state.pending))
    origins = of_state(live.plan, "queue_origins", lambda: tuple(getattr(state, "queue_origins", ())))
    # In the order of numbers, beginning with the oldest candidate in flight.
    origin_of = dict(enumerate(origins, pending[0].number)) if pending else {}
    asked = Asked(
        first=piece[0][0] if piece else live.asked,
        generations=[
            new_solutions(
                live.plan.problem, [candidate for _, candidate in group], origin_of, live.plan.body.seed
            )
            for _, group in itertools.groupby(piece, key=itemgetter(0))
        ],
        end=pending[-1].number + 1 if pending else None,
    )
    return replace(asking, unstored=left, is_stored=not left), asked


def seed_request(plan: Plan, state: State) -> SeedRequest | None:
    """Return the seeds that the algorithm waits for, or None."""
    return plan.algorithm.wanted(state) if isinstance(plan.algorithm, Seeded) else None


def of_state(plan: Plan, what: str, run: Callable[[], T]) -> T:
    """Run code of an algorithm's state, which may be the user's.

    Args:
        plan: Its plan.
        what: What is asked for, for messages.
        run: The code.
    """
    return run_plugin(ALGORITHMS, plan.body.algorithm.id, what, run)


def new_solutions(
    problem: Problem, candidates: Sequence[Candidate], origins: Mapping[int, object], campaign_seed: int
) -> list[NewSolution]:
    """Return the candidates of a generation as solutions to store, with their simulations.

    Args:
        problem: The campaign's problem.
        candidates: The generation.
        origins: Where candidates come from, by number, as far as the algorithm says.
        campaign_seed: The campaign's seed.

    Raises:
        InvalidInput: The algorithm needs a data set, which the problem does not have.
    """
    solutions = []
    simulated = (
        None if isinstance(problem, InProcessProblem) else problem
    )  # slow: it looks up every attribute
    for candidate in candidates:
        origin = origins.get(candidate.number)
        number = candidate.number if candidate.seed_number is None else candidate.seed_number
        seed = episode_seed(campaign_seed, number)
        job = None if simulated is None else _job(simulated, candidate, seed)
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
        spec = with_sources(problem.dataset_evaluation(candidate.vectors))
        needs, timeout_s = problem.dataset_needs, problem.dataset_timeout_s
    else:
        spec = with_sources(problem.episode(candidate.vectors, seed))
        needs, timeout_s = problem.needs, problem.timeout_s
    text = spec.canonical_json()
    return NewJob(spec=text, spec_hash=digest_of(text), needs=needs, timeout_s=timeout_s)


def _no_data(problem: Problem) -> InvalidInput:
    message = f"this algorithm measures on a data set, which {problem.id} does not have"
    return InvalidInput.at("/algorithm/id", message)


def vector_bytes(candidate: Candidate) -> bytes:
    """Return a complete solution as it is stored: little-endian float64 values of all components."""
    return np.concatenate(candidate.vectors).astype("<f8").tobytes()


def restored_archive(plan: Plan, stored: StoredArchive) -> Archive:
    """Return the stored archive, without computing distances."""
    arrays = {name: getattr(stored, name) for name in ARRAYS}
    return Archive.restore(plan.problem.space, plan.neighbourhood, **arrays)
