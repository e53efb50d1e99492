"""The body of an experiment, as users submit it, and the campaigns it consists of."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import AfterValidator, BeforeValidator, Field, ValidationError, model_validator

from brink.server.campaigns.body import (
    DEFAULT_EPS,
    DEFAULT_PAIRS_D_TH,
    LONGEST_NAME,
    Budget,
    CampaignBody,
    Execution,
    PluginChoice,
    SeederSection,
    problem_with_files,
)
from brink.server.documents import (
    Body,
    check_printable,
    errors_in_file,
    hash_document,
    parse_document,
    read_yaml,
)
from brink.server.errors import FieldError, InvalidInput

MAX_CAMPAIGNS = 500
"""Maximum for one experiment: all of its campaigns are checked and stored at once."""

Name = Annotated[str, Field(min_length=1, max_length=60), AfterValidator(check_printable)]
Seed = Annotated[int, Field(ge=0, lt=2**53)]


class Choice(PluginChoice):
    """A plug-in, its parameters, and its name in tables."""

    name: Annotated[Name | None, Field(description="Name in tables; defaults to the id.")] = None

    @property
    def label(self) -> str:
        """The name in tables."""
        return self.name or self.id


class Method(Choice):
    """An algorithm to compare."""

    llm: SeederSection = None


class FollowUpChoice(Body):
    """How to follow up what the campaigns of an experiment found."""

    confirm: Annotated[
        int,
        Field(
            ge=0,
            le=10_000,
            description="Maximum number of simulations with other seeds of each side of each distinct pair, or of "
            "both ends of each threshold: 0, or at least 15.",
        ),
    ] = 0
    component: Annotated[
        bool,
        Field(
            description="Whether to simulate each unsafe side or end with ground truth in place of the component."
        ),
    ] = False


class PairsChoice(FollowUpChoice):
    """Which pairs across the boundary to count in every campaign, and how to follow them up."""

    eps: Annotated[
        float,
        Field(
            ge=0,
            le=1,
            description="Largest distance between the sides of a pair, the same for all campaigns.",
        ),
    ] = DEFAULT_EPS
    d_th: Annotated[
        float,
        Field(
            ge=0,
            le=1,
            description="Smallest distance between two distinct pairs, the same for all campaigns.",
        ),
    ] = DEFAULT_PAIRS_D_TH


class ThresholdsChoice(FollowUpChoice):
    """Which thresholds to count in every campaign, and how to follow them up."""

    d_th: Annotated[
        float,
        Field(
            ge=0,
            le=1,
            description="Smallest distance between two distinct thresholds of one kind, the same for all campaigns.",
        ),
    ] = DEFAULT_PAIRS_D_TH


class SeedRange(Body):
    """Consecutive seeds."""

    first: Seed = 1
    count: Annotated[int, Field(ge=1, le=MAX_CAMPAIGNS)]


def _expand_range(seeds: object) -> object:
    """Return the seeds of a range as a list, and anything else unchanged."""
    if not isinstance(seeds, Mapping):
        return seeds
    try:
        named = SeedRange.model_validate(dict(seeds))
    except ValidationError:
        raise ValueError(
            f"expected a list of seeds, or first (0 or more) and count (1 to {MAX_CAMPAIGNS})"
        ) from None
    return list(range(named.first, named.first + named.count))


class ExperimentBody(Body):
    """An experiment: one campaign for every combination of algorithm, problem and seed."""

    name: Annotated[
        str, Field(min_length=1, max_length=120, examples=["paper-rq1"]), AfterValidator(check_printable)
    ]
    problems: Annotated[list[Choice], Field(min_length=1, max_length=20)]
    algorithms: Annotated[list[Method], Field(min_length=1, max_length=20)]
    seeds: Annotated[
        list[Seed],
        BeforeValidator(_expand_range, json_schema_input_type=list[Seed] | SeedRange),
        Field(
            min_length=1,
            max_length=MAX_CAMPAIGNS,
            description="A list, or {first, count}.",
            examples=[{"first": 1, "count": 10}],
        ),
    ]
    budget: Budget
    priority: Annotated[
        int, Field(ge=-100, le=100, description="Campaigns with a higher priority are served first.")
    ] = 0
    execution: Execution = Field(default_factory=Execution)
    pairs: Annotated[
        PairsChoice | None,
        Field(description="Compare the methods by the pairs across the boundary that they find, too."),
    ] = None
    thresholds: Annotated[
        ThresholdsChoice | None,
        Field(description="Compare the methods by the thresholds that they find, too."),
    ] = None

    @model_validator(mode="after")
    def _has_unique_names(self) -> Self:
        for what, names in (
            ("problems", [choice.label for choice in self.problems]),
            ("algorithms", [choice.label for choice in self.algorithms]),
            ("seeds", [str(seed) for seed in self.seeds]),
        ):
            twice = [name for name, times in Counter(names).items() if times > 1]
            if twice:
                hint = "" if what == "seeds" else "; give each a different name"
                raise ValueError(f"{what}: expected each only once, got {twice[0]!r} more than once{hint}")
        if self.campaigns > MAX_CAMPAIGNS:
            raise ValueError(f"expected at most {MAX_CAMPAIGNS} campaigns, got {self.campaigns}")
        return self

    @property
    def campaigns(self) -> int:
        """Number of campaigns."""
        return len(self.problems) * len(self.algorithms) * len(self.seeds)

    def document_hash(self) -> str:
        """Return a hash that identifies identical submissions."""
        return hash_document(self.document())

    def document(self) -> dict[str, Any]:
        """Return the experiment as a document to submit or to store, without the optional sections that it lacks."""
        document = self.model_dump(mode="json")
        for section in ("pairs", "thresholds"):
            if document[section] is None:
                del document[section]  # the hashes of older submissions stay valid
        return document

    def follow_ups(self) -> dict[str, FollowUpChoice]:
        """Return how to follow up what is compared, by the section that asks for it."""
        sections = {"pairs": self.pairs, "thresholds": self.thresholds}
        return {name: chosen for name, chosen in sections.items() if chosen is not None}

    def sized(self, seeds: int | None, simulations: int | None) -> "ExperimentBody":
        """Return the experiment at another size.

        Args:
            seeds: Number of seeds, counted from the first; None for those of the experiment.
            simulations: Budget of each campaign; None for that of the experiment.

        Raises:
            InvalidInput: The size is not possible.
        """
        document = self.document()
        if seeds is not None:
            document["seeds"] = {"first": self.seeds[0], "count": seeds}
        if simulations is not None:
            document["budget"] = {**document["budget"], "simulations": simulations}
        return parse_experiment(document)

    def cells(self) -> list["Cell"]:
        """Return the campaigns ordered by seed, so that each seed's comparison is complete before the next begins."""
        return [
            self._cell(place, *found)
            for place, found in enumerate(
                (seed, problem, method)
                for seed in self.seeds
                for problem in range(len(self.problems))
                for method in range(len(self.algorithms))
            )
        ]

    def _cell(self, place: int, seed: int, problem: int, method: int) -> "Cell":
        case, algorithm = self.problems[problem], self.algorithms[method]
        on = f", {case.label}" if len(self.problems) > 1 else ""
        body = CampaignBody(
            name=f"{self.name}: {algorithm.label}{on}, seed {seed}"[:LONGEST_NAME],
            problem=PluginChoice(id=case.id, params=case.params),
            algorithm=PluginChoice(id=algorithm.id, params=algorithm.params),
            budget=self.budget,
            seed=seed,
            priority=self.priority,
            execution=self.execution,
            llm=algorithm.llm,
        )
        return Cell(
            place=place,
            method=algorithm.label,
            problem=case.label,
            body=body,
            pointers=(f"/problems/{problem}", f"/algorithms/{method}"),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Cell:
    """A campaign of an experiment.

    Attributes:
        place: Position in the experiment.
        method: Name of its algorithm.
        problem: Name of its problem.
        body: Body of the campaign.
        pointers: JSON pointers to its problem and its algorithm in the experiment.
    """

    place: int
    method: str
    problem: str
    body: CampaignBody
    pointers: tuple[str, str]

    def in_experiment(self, error: InvalidInput) -> InvalidInput:
        """Return an error in the campaign's body as an error in the experiment's body."""
        problem, algorithm = self.pointers
        places = {"/problem": problem, "/algorithm": algorithm, "/llm": f"{algorithm}/llm"}

        def moved(pointer: str) -> str:
            head, rest = "/".join(pointer.split("/")[:2]), pointer.split("/")[2:]
            return "/".join([places.get(head, head), *rest])

        return InvalidInput(
            FieldError(pointer=moved(item.pointer), message=item.message, nearest=item.nearest)
            for item in error.errors
        )


def parse_experiment(document: object) -> ExperimentBody:
    """Validate the document of an experiment.

    Raises:
        InvalidInput: With a pointer to each invalid field.
    """
    expected = "an experiment with name, problems, algorithms, seeds and budget"
    return parse_document(document, ExperimentBody, expected)


def read_experiment_file(path: Path) -> ExperimentBody:
    """Read an experiment file.

    Raises:
        InvalidInput: The file, or one that a problem names, cannot be read, or is not what it should be.
    """
    with errors_in_file(path):
        body = parse_experiment(read_yaml(path))
        problems = [
            problem_with_files(problem, path.parent, f"/problems/{place}")
            for place, problem in enumerate(body.problems)
        ]
        return body.model_copy(update={"problems": problems})
