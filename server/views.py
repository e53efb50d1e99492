"""Base class of all response schemas, and the schema of a solution."""

from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

from brink.search.analysis.avoidable import Avoidable, AvoidedBy
from brink.server.states import OutcomeKind, SolutionVerdict

AVOIDABLE = (
    "Who would have avoided it: a careful driver (UN Regulation No. 157, Annex 3), only an ideal one who brakes at "
    "once, or neither (no); null if that was not measured."
)


AVOIDED_BY = (
    "How that driver avoids it: by `braking` before the time of the violation, for a road user or a red light, or by "
    "`driving on`, having passed earlier or kept its lane; null if no driver avoids it, or that was not recorded."
)


class View(BaseModel):
    """Base class of all response schemas. Validators are built on first use: the command line needs few of them."""

    model_config = ConfigDict(frozen=True, defer_build=True)


class ViolatedView(View):
    """A requirement that an episode violated."""

    requirement: str
    time_s: Annotated[float | None, Field(description="Simulated time of the first violation, if recorded.")]
    words: Annotated[str, Field(description="What the ego did, such as `hit a pedestrian`.")]
    decides: Annotated[bool, Field(description="Whether the campaign's verdict depends on it.")]
    avoidable: Annotated[Avoidable | None, Field(description=AVOIDABLE)] = None
    avoided_by: Annotated[AvoidedBy | None, Field(description=AVOIDED_BY)] = None
    avoidable_words: Annotated[
        str,
        Field(
            description="The same in words, such as `avoidable by a careful driver`; empty if not measured."
        ),
    ] = ""


class ActivityView(View):
    """Which parameters were active in the episode of a solution, and the values that they had there."""

    inactive: Annotated[
        list[str],
        Field(
            description="Parameters whose value cannot have influenced the episode, as component.parameter: for "
            "example, those of a trajectory that begins after the episode ended."
        ),
    ]
    effective: Annotated[
        dict[str, dict[str, Any]],
        Field(description="Values as the episode had them: a time window that its end cut off ends there."),
    ]
    idle: Annotated[list[str], Field(description="Components that were inactive in the episode.")]


class SolutionView(View):
    """A complete solution with its decoded parameters."""

    number: int
    generation: int
    verdict: Annotated[
        SolutionVerdict,
        Field(description="Safe or unsafe by the campaign's requirements; see `outcome` for the others."),
    ]
    outcome: Annotated[
        str | None,
        Field(
            description="What its simulation showed about all recorded requirements, such as `front gap held; hit a "
            "pedestrian at 12.8 s`; null without a verdict."
        ),
    ] = None
    kind: Annotated[
        OutcomeKind | None,
        Field(
            description="Whether it violated no recorded requirement (held), only others than those that decide "
            "(other), or one that decides (violated); null without a verdict."
        ),
    ] = None
    requirements: Annotated[
        list[str], Field(description="Requirements that decide the verdict; empty if unknown.")
    ] = []
    violated: Annotated[
        list[ViolatedView], Field(description="Violated requirements: those that decide first, then by time.")
    ] = []
    robustness: float | None
    objectives: dict[str, float] | None
    failure: str | None
    origin: Annotated[
        str | None,
        Field(description="How it was generated: random, heuristic, mutation, crossover, llm, llm_repair."),
    ]
    fitness: Annotated[
        float | None,
        Field(
            description="Boundary fitness; null, like the neighbour counts, before it is evaluated, and of searches "
            "that do not find a boundary."
        ),
    ] = None
    neighbours: int | None = None
    unsafe_neighbours: int | None = None
    interval: Annotated[
        tuple[float, float] | None,
        Field(description="Wilson interval of the unsafe share in its neighbourhood."),
    ] = None
    seed: int
    attempts: int | None
    losses: Annotated[int | None, Field(description="Attempts among them whose worker stopped responding.")]
    words: Annotated[str, Field(description="Description in words.")]
    parameters: Annotated[
        dict[str, dict[str, Any]],
        Field(description="Values by component, then by name, as they were chosen."),
    ]
    titles: Annotated[
        dict[str, str],
        Field(
            description="Display names of parameters, with their units, by component.parameter; the others go "
            "by their names. Only for a single solution."
        ),
    ] = {}
    activity: Annotated[
        ActivityView | None,
        Field(description="Which of them were active in the episode; null if that was not recorded."),
    ] = None
    verdicts: Annotated[dict[str, Any] | None, Field(description="Verdicts of all requirements.")] = None
    features: dict[str, Any] | None = None
    provenance: dict[str, Any] | None = None
    spec: Annotated[
        dict[str, Any] | None, Field(description="Specification of the episode, for simulating it again.")
    ] = None
