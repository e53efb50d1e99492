"""What a user submits: the body of ``POST /campaigns``, and a campaign file with the same fields.

Bad input is answered with a pointer to each wrong field, what was expected, and the nearest valid name.
"""

from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, Field

from brink.server.documents import Body, hash_of, parsed, read_yaml, without_controls
from brink.server.llm.settings import LlmSettings
from brink.worker.wire import JsonValues

DEFAULT_T_B = 0.10
"""Largest fitness of a boundary solution, unless a request says otherwise."""
DEFAULT_D_TH = 0.20
"""Least distance between distinct boundary solutions, unless a request says otherwise."""


class PluginChoice(Body):
    """A plug-in and its parameters."""

    id: Annotated[str, Field(min_length=1, max_length=100, examples=["urban-injected@1"])]
    params: JsonValues = Field(default_factory=dict)


class Budget(Body):
    """What a campaign may cost."""

    simulations: Annotated[int, Field(ge=1, le=10_000_000)]


class Execution(Body):
    """How a campaign's simulations are run."""

    cache: Annotated[bool, Field(description="Take over results of the same simulation done before.")] = True
    max_attempts: Annotated[int, Field(ge=1, le=20, description="Tries before quarantine.")] = 3
    max_failed_share: Annotated[
        float, Field(ge=0, le=1, description="Share of failed candidates past which the campaign pauses.")
    ] = 0.2
    keep_traces: Annotated[
        int,
        Field(ge=0, le=1000, description="Distinct boundary solutions whose traces are kept as evidence."),
    ] = 12


class CampaignBody(Body):
    """A campaign: a problem, an algorithm, a budget, a seed."""

    name: Annotated[
        str, Field(min_length=1, max_length=200, examples=["night-rain"]), AfterValidator(without_controls)
    ]
    problem: PluginChoice
    algorithm: PluginChoice
    budget: Budget
    seed: Annotated[int, Field(ge=0, lt=2**53)] = 1
    priority: Annotated[int, Field(ge=-100, le=100, description="Higher goes first.")] = 0
    execution: Execution = Field(default_factory=Execution)
    repeats: Annotated[
        int,
        Field(
            ge=0,
            le=10_000,
            description="Simulations with other seeds of each distinct boundary solution, after the search.",
        ),
    ] = 0
    llm: Annotated[
        LlmSettings | None, Field(description="Language model that seeds an algorithm which asks for seeds.")
    ] = None

    def document_hash(self) -> str:
        """Return a hash by which the same submission is known again."""
        document = self.model_dump(mode="json")
        if self.llm is None:
            del document["llm"]  # as it was before there were language models
        if not self.repeats:
            del document["repeats"]  # and repeats
        return hash_of(document)


def parse_body(document: object) -> CampaignBody:
    """Read a campaign.

    Raises:
        InvalidInput: With a pointer to each wrong field.
    """
    return parsed(document, CampaignBody, "a campaign with name, problem, algorithm and budget")


def read_campaign_file(path: Path) -> CampaignBody:
    """Read a campaign file.

    Raises:
        InvalidInput: The file cannot be read, is no YAML, or is no campaign.
    """
    return parse_body(read_yaml(path))
