"""The body of ``POST /campaigns``, and campaign files, which have the same fields.

Tags and notes belong to people: they may change at any time, so they are not part of what identifies a submission.
"""

import csv
import unicodedata
from collections.abc import Iterable, Mapping
from importlib.metadata import entry_points
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Self, TypeVar

from pydantic import AfterValidator, Field, model_validator

from brink.server.documents import (
    Body,
    check_printable,
    errors_in_file,
    hash_document,
    parse_document,
    read_yaml,
)
from brink.server.errors import InvalidInput
from brink.server.seeding import SeederSettings, seeder
from brink.sim.errors import DefinitionError
from brink.user_file import read_text
from brink.worker.wire import JsonValues, Number

LONGEST_NAME = 200
PROBLEM_FILES: Final = "brink.problem_files"
"""Entry points by the ids of problems: functions that read the files which parameters in a campaign file name."""
LARGEST_CSV_BYTES: Final = 4 * 1024**2
DEFAULT_T_B = 0.10
"""Default threshold: solutions with a fitness of at most this count as boundary solutions."""
DEFAULT_D_TH = 0.20
"""Default threshold: boundary solutions at least this far apart count as distinct."""

DEFAULT_EPS = 0.02
"""Default of the largest distance between the two sides of a pair."""
DEFAULT_PAIRS_D_TH = 0.2
"""Default of the smallest distance between two distinct pairs."""

DEFAULT_MAX_LOSSES = 10
"""Default of how often a job may lose its worker: generous, because machines are preempted more often than they are
killed by what they run."""

MOST_TAGS: Final = 32
LONGEST_TAG: Final = 40
LONGEST_NOTES: Final = 10_000
_IN_TAGS: Final = "-_.:/+#@"


def check_tag(text: str) -> str:
    """Return a tag with its case folded, the form in which it is stored and compared.

    Raises:
        ValueError: It is not a short word.
    """
    tag = folded(text.strip())
    known = all(unicodedata.category(one)[0] in "LMN" or one in _IN_TAGS for one in tag)
    if not 1 <= len(tag) <= LONGEST_TAG or not known:
        raise ValueError(
            f"expected a word of 1 to {LONGEST_TAG} letters, digits or characters of {_IN_TAGS}, without spaces"
        )
    return tag


def check_notes(text: str) -> str:
    """Return notes with line feeds as the only line ends.

    Raises:
        ValueError: They contain other control characters than tabs.
    """
    notes = text.replace("\r\n", "\n").replace("\r", "\n")
    if any(unicodedata.category(one) in ("Cc", "Cs") and one not in "\n\t" for one in notes):
        raise ValueError("expected text without control characters")
    return notes


def _as_set(tags: list[str]) -> list[str]:
    return sorted(set(tags))


Tag = Annotated[str, Field(max_length=LONGEST_TAG), AfterValidator(check_tag)]
Tags = Annotated[list[Tag], Field(max_length=MOST_TAGS), AfterValidator(_as_set)]
Notes = Annotated[str, Field(max_length=LONGEST_NOTES), AfterValidator(check_notes)]


MOST_KNOWN = 5_000
"""Maximum number of results that a campaign starts from; limited because every checkpoint contains them."""
MOST_GIVEN = 1_000
"""Maximum number of solutions in a campaign's body."""


if TYPE_CHECKING:
    Seeding = SeederSettings
else:
    Seeding = seeder().settings_type

SeederSection = Annotated[
    Seeding | None, Field(description="Language model for algorithms that request seeds.")
]


class PluginChoice(Body):
    """A plug-in and its parameters."""

    id: Annotated[
        str,
        Field(min_length=1, max_length=100, examples=["urban-injected@1"]),
        AfterValidator(check_printable),
    ]
    params: Annotated[JsonValues, Field(max_length=1_000)] = Field(default_factory=dict)


Problem = TypeVar("Problem", bound=PluginChoice)


class Budget(Body):
    """Limits on the cost of a campaign."""

    simulations: Annotated[int, Field(ge=1, le=10_000_000)]


class Execution(Body):
    """How a campaign's simulations are executed."""

    cache: Annotated[bool, Field(description="Whether to reuse the results of identical simulations.")] = True
    max_attempts: Annotated[
        int, Field(ge=1, le=20, description="Failed attempts before a job is quarantined.")
    ] = 3
    max_losses: Annotated[
        int,
        Field(
            ge=1,
            le=1000,
            exclude_if=lambda given: given == DEFAULT_MAX_LOSSES,  # for the hashes of older submissions
            description="Leases lost with their workers before a job is quarantined; they are not failed attempts.",
        ),
    ] = DEFAULT_MAX_LOSSES
    max_failed_share: Annotated[
        float, Field(ge=0, le=1, description="Share of failed candidates above which the campaign pauses.")
    ] = 0.2
    keep_traces: Annotated[
        int,
        Field(
            ge=0,
            le=1000,
            description="Number of distinct boundary solutions whose traces are kept as evidence.",
        ),
    ] = 12


class KnownSolution(Body):
    """A solution known before a campaign starts."""

    values: Annotated[
        JsonValues,
        Field(
            description="Every parameter's value, by component.parameter.",
            examples=[{"scenario.road": "dry"}],
        ),
    ]
    robustness: Annotated[
        Number | None,
        Field(
            description="Its known result, negative if unsafe; without it, the solution is simulated first."
        ),
    ] = None


class StartFrom(Body):
    """The prior knowledge of a campaign: an earlier campaign, or given solutions."""

    campaign: Annotated[
        str | None,
        Field(
            min_length=2, max_length=16, description="Id of a campaign that has ended, or a unique prefix."
        ),
    ] = None
    results: Annotated[
        bool,
        Field(
            description="Whether to use the campaign's results; if not, its solutions are simulated first, at "
            "which counts against the budget."
        ),
    ] = True
    limit: Annotated[
        int | None,
        Field(
            ge=1,
            le=MOST_KNOWN,
            description="Maximum number of results or solutions of that campaign, nearest to the boundary first.",
        ),
    ] = None
    solutions: Annotated[list[KnownSolution] | None, Field(min_length=1, max_length=MOST_GIVEN)] = None
    outside_odd: Annotated[
        int | None,
        Field(
            ge=0,
            exclude_if=lambda given: given is None,  # for the hashes of older submissions
            description="Set by the coordinator: solutions of that campaign that were left out, as they are outside "
            "the ODD of this one.",
        ),
    ] = None

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if (self.campaign is None) == (self.solutions is None):
            raise ValueError("expected either campaign or solutions")
        if self.solutions is not None and (self.limit is not None or not self.results):
            raise ValueError("expected limit and results only with campaign")
        return self


class CampaignBody(Body):
    """A campaign: a problem, an algorithm, a budget, a seed."""

    name: Annotated[
        str,
        Field(min_length=1, max_length=LONGEST_NAME, examples=["night-rain"]),
        AfterValidator(check_printable),
    ]
    problem: PluginChoice
    algorithm: PluginChoice
    budget: Budget
    seed: Annotated[int, Field(ge=0, lt=2**53)] = 1
    priority: Annotated[
        int, Field(ge=-100, le=100, description="Campaigns with a higher priority are served first.")
    ] = 0
    execution: Execution = Field(default_factory=Execution)
    repeats: Annotated[
        int,
        Field(
            ge=0,
            le=10_000,
            description="Number of simulations of each distinct boundary solution with other seeds after the search.",
        ),
    ] = 0
    ground_truth: Annotated[
        bool,
        Field(description="Whether to simulate with ground truth in place of the machine-learned component."),
    ] = False
    llm: SeederSection = None
    start_from: Annotated[
        StartFrom | None, Field(description="Known solutions and results to start from.")
    ] = None
    sources: Annotated[
        dict[
            Annotated[str, Field(max_length=200), AfterValidator(check_printable)],
            Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")],
        ],
        Field(
            max_length=64,
            exclude_if=lambda given: not given,  # for the hashes of older submissions
            description="Set by the coordinator: the SHA-256 of the source of each plug-in, except Brink's own.",
        ),
    ] = Field(default_factory=dict)
    tags: Tags = Field(default_factory=list, description="Short words for finding the campaign later.")
    notes: Annotated[Notes, Field(description="Free-text notes about the campaign.")] = ""

    def within_odd(self, odd: Mapping[str, Any]) -> Self:
        """Return the campaign with further limits of its operational design domain; they replace limits it has.

        Args:
            odd: Limits by component.parameter.
        """
        own = self.problem.params.get("odd", {})
        if not odd or not isinstance(own, Mapping):  # a wrong one is refused with the other parameters
            return self
        params = {**self.problem.params, "odd": {**own, **odd}}
        return self.model_copy(update={"problem": PluginChoice(id=self.problem.id, params=params)})

    def document_hash(self) -> str:
        """Return a hash that identifies identical submissions, whatever their tags and notes are."""
        document = self.document()
        document.pop("sources", None)  # `brink run` compares them with those of an earlier campaign
        if self.llm is None:
            del document["llm"]  # the hashes of older submissions stay valid
        if not self.repeats:
            del document["repeats"]
        if not self.ground_truth:
            del document["ground_truth"]
        if self.start_from is None:
            del document["start_from"]
        return hash_document(document)

    def document(self) -> dict[str, Any]:
        """Return the campaign as it is stored: without tags and notes, which have columns of their own."""
        return self.model_dump(mode="json", exclude={"tags", "notes"})


class CampaignChange(Body):
    """A change to the editable fields of a campaign; omitted fields stay as they are."""

    tags: Annotated[Tags | None, Field(description="All new tags.")] = None
    add_tags: Tags = Field(default_factory=list, description="Tags to add.")
    remove_tags: Tags = Field(
        default_factory=list, description="Tags to remove; those that it does not have are ignored."
    )
    notes: Annotated[Notes | None, Field(description="The new notes.")] = None

    @model_validator(mode="after")
    def _check_either_all_or_some(self) -> Self:
        if self.tags is not None and (self.add_tags or self.remove_tags):
            raise ValueError("expected either tags or add_tags and remove_tags, not both")
        return self

    def tags_after(self, before: Iterable[str]) -> list[str]:
        """Return the tags of a campaign after the change, in alphabetical order.

        Args:
            before: Its tags before the change.

        Raises:
            InvalidInput: There would be too many.
        """
        if self.tags is not None:
            return self.tags
        after = sorted({*before, *self.add_tags} - set(self.remove_tags))
        if len(after) > MOST_TAGS:
            raise InvalidInput.at(
                "/add_tags", f"expected at most {MOST_TAGS} tags a campaign, got {len(after)}: remove some"
            )
        return after


def folded(text: str) -> str:
    """Return a text folded so that texts which differ only in case or in the encoding of accents are equal."""
    return unicodedata.normalize("NFC", unicodedata.normalize("NFD", text).casefold())


def search_words(text: str) -> list[str]:
    """Return the words to search for, folded as in `search_text`."""
    return folded(text).split()


def search_text(name: str, notes: str, tags: Iterable[str]) -> str:
    """Return the searchable text of a campaign, with its case folded."""
    return folded("\n".join([name, " ".join(tags), notes]))


def parse_body(document: object) -> CampaignBody:
    """Validate the document of a campaign.

    Raises:
        InvalidInput: With a pointer to each invalid field.
    """
    return parse_document(document, CampaignBody, "a campaign with name, problem, algorithm and budget")


def read_campaign_file(path: Path) -> CampaignBody:
    """Read a campaign file.

    Raises:
        InvalidInput: The file cannot be read, is not YAML, or is not a campaign.
    """
    with errors_in_file(path):
        return with_files(parse_body(read_yaml(path)), path.parent)


def _with_rows(distribution: Mapping[str, Any], folder: Path, pointer: str) -> dict[str, Any]:
    """Return an operational distribution with the observations of the CSV file that it names.

    Raises:
        InvalidInput: The file cannot be read, or is not a table.
    """
    from brink.search.distribution import FROM, ROWS, rows_of_table  # slow to import

    if ROWS in distribution or not isinstance(name := distribution[FROM], str):
        message = f"expected the path of a CSV file, and no {ROWS} beside it, got {distribution[FROM]!r:.80}"
        raise InvalidInput.at(pointer, message)
    try:
        lines = list(csv.reader(read_text(folder / name, LARGEST_CSV_BYTES).splitlines()))
    except (OSError, ValueError, csv.Error) as error:
        raise InvalidInput.at(pointer, f"cannot read {name}: {error}") from None
    if len(lines) < 2:
        raise InvalidInput.at(pointer, f"{name}: expected a line of parameters and at least one of values")
    others = {key: value for key, value in distribution.items() if key != FROM}
    columns = [column.strip() for column in lines[0]]
    return {**others, ROWS: rows_of_table(columns, [line for line in lines[1:] if line])}


def _with_program(params: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    if not str(params.get("driving")).startswith("command:"):
        return dict(params)
    from brink.sim.driving_systems.command import read_reference  # loads the driving world

    return {**params, "driving": read_reference(str(params["driving"]), folder)}


def changes_with_files(changes: Mapping[str, Any], option: str) -> dict[str, Any]:
    """Return changes of the parameters of a problem, with the id of a program that is named by its file.

    Args:
        changes: New values by name.
        option: What gave the changes, for errors.

    Raises:
        InvalidInput: The file is no definition, or the program cannot run here.
    """
    try:
        return _with_program(changes, Path())
    except DefinitionError as error:
        raise InvalidInput.at(f"{option} {error.field}", str(error)) from None


def with_files(body: CampaignBody, folder: Path) -> CampaignBody:
    """Return a campaign whose problem takes its files along; see `problem_with_files`."""
    return body.model_copy(update={"problem": problem_with_files(body.problem, folder, "/problem")})


def problem_with_files(problem: Problem, folder: Path, pointer: str) -> Problem:
    """Return a problem with the content of the files that it takes along, and the id of its program.

    Args:
        problem: The problem, which names them by path.
        folder: Folder of relative paths.
        pointer: JSON pointer to the problem, for errors.

    Raises:
        InvalidInput: A file cannot be read, or is not what it should be.
    """
    params = dict(problem.params)
    try:
        for reader in entry_points(group=PROBLEM_FILES, name=problem.id):
            params = reader.load()(params, folder)
        params = _with_program(params, folder)
    except DefinitionError as error:
        raise InvalidInput.at(f"{pointer}/params/{error.field}", str(error)) from None
    if isinstance(distribution := params.get("distribution"), Mapping) and "from" in distribution:
        params["distribution"] = _with_rows(distribution, folder, f"{pointer}/params/distribution/from")
    return problem.model_copy(update={"params": params})
