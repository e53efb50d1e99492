"""What is checked before a campaign is stored, and how it is stored with its first generation."""

import secrets
from collections.abc import Sequence
from dataclasses import dataclass

from sqlalchemy import Connection

from brink.search.errors import ConfigError, UnsupportedSpace
from brink.server.campaigns import step_store, store
from brink.server.campaigns.body import CampaignBody
from brink.server.campaigns.plan import Live, Plan, first_generation, make_plan
from brink.server.campaigns.values import Campaign, NewSolution
from brink.server.errors import FieldError, InvalidInput
from brink.server.llm.settings import LlmSettings
from brink.server.problems.base import ChecksInputs, Describes, InProcessProblem
from brink.server.problems.catalogue import config_field_error

LLM = "llm"
"""What an algorithm's setting `seeder` is that wants seeds from a language model."""


def check_submission(body: CampaignBody) -> tuple[Live, list[NewSolution]]:
    """Return the first generation of a campaign that can run.

    Raises:
        InvalidInput: It cannot; with a pointer to each wrong field.
    """
    checked_plan(body)
    return first_generation(body)


def checked_plan(body: CampaignBody) -> Plan:
    """Return the plan of a campaign that can run.

    Raises:
        InvalidInput: It cannot; with a pointer to each wrong field.
    """
    plan = make_plan(body)
    if isinstance(plan.problem, ChecksInputs) and (wrong := plan.problem.wrong_inputs()):
        raise InvalidInput(
            [FieldError(pointer=f"/problem/params/{name}", message=message) for name, message in wrong]
        )
    _check_seeder(plan)
    if body.repeats:
        check_repeatable(plan)
    try:
        plan.algorithm.check(plan.problem.space, plan.config, budget=body.budget.simulations)
    except UnsupportedSpace as error:
        message = f"{body.algorithm.id} cannot search the space of {body.problem.id}: {error}"
        raise InvalidInput([FieldError(pointer="/algorithm/id", message=message)]) from None
    except ConfigError as error:
        if error.field == "budget":
            message = str(error).removeprefix("budget: ")
            raise InvalidInput([FieldError(pointer="/budget/simulations", message=message)]) from None
        raise InvalidInput([config_field_error(error, "/algorithm/params")]) from None
    return plan


def check_repeatable(plan: Plan) -> None:
    """Check that solutions of a campaign may turn out otherwise with another seed.

    Raises:
        InvalidInput: They cannot.
    """
    if isinstance(plan.problem, InProcessProblem):
        message = f"{plan.body.problem.id} is computed, not simulated: with other seeds it says the same"
        raise InvalidInput([FieldError(pointer="/repeats", message=message)])


def _check_seeder(plan: Plan) -> None:
    """Check that who asks for a language model has one, and the other way round.

    Raises:
        InvalidInput: One of the two is missing.
    """
    asks = getattr(plan.config, "seeder", None) == LLM
    if asks and plan.body.llm is None:
        message = "expected a language model, such as {endpoint: http://127.0.0.1:8000/v1, model: ...}"
        raise InvalidInput([FieldError(pointer="/llm", message=message)])
    if plan.body.llm is not None and not asks:
        message = f"{plan.body.algorithm.id} does not ask it; expected algorithm.params.seeder: llm"
        raise InvalidInput([FieldError(pointer="/llm", message=message)])
    if asks and not isinstance(plan.problem, Describes):
        message = f"{plan.body.problem.id} cannot be described to a language model"
        raise InvalidInput([FieldError(pointer="/problem/id", message=message)])


def _check_endpoint(llm: LlmSettings | None, allowed: str) -> None:
    """Check that a campaign may ask its language model from here, with the key that it names.

    Whoever may submit a campaign could otherwise have any variable of this machine sent anywhere.

    Raises:
        InvalidInput: It may not.
    """
    if llm is None:
        return
    bases = [base for one in allowed.split(",") if (base := one.strip().rstrip("/"))]
    own = llm.on_this_machine and llm.api_key_env is None
    listed = any(base == "*" or f"{llm.endpoint}/".startswith(f"{base}/") for base in bases)
    if not own and not listed:
        message = (
            f"this coordinator may ask {', '.join(bases) or 'models on its own machine, without a key'}, not "
            f"{llm.endpoint}; whoever runs it can allow that in BRINK_LLM_ENDPOINTS"
        )
        raise InvalidInput([FieldError(pointer="/llm/endpoint", message=message)])


@dataclass(frozen=True, slots=True, kw_only=True)
class Prepared:
    """A campaign that can run, not stored yet.

    Attributes:
        id: Its id.
        body: As it was submitted.
        live: With its first generation asked.
        solutions: That generation.
    """

    id: str
    body: CampaignBody
    live: Live
    solutions: Sequence[NewSolution]


def prepared(body: CampaignBody, llm_endpoints: str) -> Prepared:
    """Check a campaign, and ask for its first generation.

    Args:
        body: What was asked for.
        llm_endpoints: Which language models may be asked from here.

    Raises:
        InvalidInput: It cannot run.
    """
    _check_endpoint(body.llm, llm_endpoints)
    live, solutions = check_submission(body)
    return Prepared(id=secrets.token_hex(4), body=body, live=live, solutions=solutions)


def store_prepared(connection: Connection, campaign: Prepared, key: str | None = None) -> Campaign:
    """Store a campaign with its first generation."""
    store.insert_campaign(
        connection, campaign.id, campaign.live.plan.body, campaign.body.document_hash(), key
    )
    stored = store.named_campaign(connection, campaign.id)
    step_store.insert_solutions(connection, stored, 0, campaign.solutions)
    return stored
