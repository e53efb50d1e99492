"""Campaigns written in Python, what they start from, and every other form that `brink.run` accepts."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias, runtime_checkable

import numpy as np

from brink.python.frames import parameter_columns
from brink.search.algorithm import Known
from brink.search.space import SearchSpace
from brink.server.campaigns.body import CampaignBody, StartFrom, parse_body, read_campaign_file, with_files
from brink.server.campaigns.known import given_records, known_of
from brink.server.campaigns.plan import make_plan
from brink.server.documents import parse_document
from brink.server.errors import InvalidInput

if TYPE_CHECKING:
    import pandas as pd


@runtime_checkable
class HasId(Protocol):
    """A campaign, or its result."""

    @property
    def id(self) -> str: ...  # noqa: D102


Start: TypeAlias = "str | HasId | Mapping[str, Any] | pd.DataFrame | None"
"""The id of a campaign, a campaign, its result, the field of a campaign file, a data frame, or nothing."""
ROBUSTNESS = "robustness"


CampaignLike: TypeAlias = "Campaign | CampaignBody | Mapping[str, Any] | str | Path"
"""A campaign, or its file, or the content of its file."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Campaign:
    """A campaign: a problem, an algorithm and a budget.

    docs/reference/problems.md lists problems and algorithms, ``brink plugins show ID`` the parameters of each.

    Attributes:
        problem: Id of the problem, such as ``urban-injected@1``.
        algorithm: Id of the algorithm.
        simulations: Number of simulations.
        name: Name of the campaign.
        seed: Seed of the search: the same campaign with the same seed gives the same result.
        problem_params: Parameters of the problem that differ from their defaults.
        algorithm_params: The same for the algorithm.
        odd: Operational design domain: limits by component.parameter, each one value, a list of choices, or a mapping
            with ``min``, ``max`` or both.
        constraints: Conditions that every solution meets, such as ``gap > 2 * speed / 3.6``.
        distribution: Operational distribution: how often values occur, by component.parameter; see
            docs/reference/search-space.md.
        start_from: Prior knowledge: an earlier campaign, its result or id, or a data frame with a column for
            each parameter and one for ``robustness``.
        more: Further fields of the campaign file, such as ``repeats`` or ``execution``.
    """

    problem: str
    simulations: int
    algorithm: str = "edge@2"
    name: str = ""
    seed: int = 1
    problem_params: Mapping[str, Any] = field(default_factory=dict)
    algorithm_params: Mapping[str, Any] = field(default_factory=dict)
    odd: Mapping[str, Any] = field(default_factory=dict)
    constraints: Sequence[str] = ()
    distribution: Mapping[str, Any] = field(default_factory=dict)
    start_from: Start = None
    more: Mapping[str, Any] = field(default_factory=dict)

    def document(self) -> dict[str, Any]:
        """Return the campaign as in a campaign file, without its prior knowledge."""
        limits: dict[str, Any] = {"odd": dict(self.odd)} if self.odd else {}
        if self.constraints:
            limits |= {"constraints": list(self.constraints)}
        if self.distribution:
            limits |= {"distribution": dict(self.distribution)}
        return {
            "name": self.name or f"{self.problem.partition('@')[0]}, {self.algorithm.partition('@')[0]}",
            "problem": {"id": self.problem, "params": {**self.problem_params, **limits}},
            "algorithm": {"id": self.algorithm, "params": dict(self.algorithm_params)},
            "budget": {"simulations": self.simulations},
            "seed": self.seed,
            **self.more,
        }


def body_of(campaign: CampaignLike) -> CampaignBody:
    """Return the body of a campaign, in whatever form it is given.

    Args:
        campaign: A `Campaign`, the path of a campaign file, or its content.

    Raises:
        InvalidInput: A field is missing, unknown or invalid, or the file cannot be read.
    """
    if isinstance(campaign, CampaignBody):
        return campaign
    if isinstance(campaign, str | Path):
        return read_campaign_file(Path(campaign))
    if isinstance(campaign, Campaign):
        return started(with_files(parse_body(campaign.document()), Path()), campaign.start_from)
    return with_files(parse_body(dict(campaign)), Path())


def started(body: CampaignBody, start_from: Start) -> CampaignBody:
    """Return a campaign with prior knowledge.

    Args:
        body: The campaign.
        start_from: What it starts from; None leaves the campaign as it is.

    Raises:
        InvalidInput: A data frame lacks a parameter, or has an empty value.
    """
    if start_from is None:
        return body
    return body.model_copy(update={"start_from": start_of(start_from, lambda: make_plan(body).problem.space)})


def start_of(start_from: Start, space: Any) -> StartFrom:
    """Return the field ``start_from`` of a campaign file.

    Args:
        start_from: What the campaign starts from.
        space: Returns its search space; called for a data frame.

    Raises:
        InvalidInput: A data frame lacks a parameter, or has an empty value.
    """
    match start_from:
        case str():
            document: dict[str, Any] = {"campaign": start_from}
        case Mapping():
            document = dict(start_from)
        case HasId():
            document = {"campaign": start_from.id}
        case _ if start_from is not None and hasattr(start_from, "to_dict"):
            document = {"solutions": solutions_of(start_from, space())}
        case _:
            raise InvalidInput.at(
                "start_from",
                "expected the id of a campaign, a result, a data frame or a mapping, "
                f"got {type(start_from).__name__}",
            )
    return parse_document(document, StartFrom, "what to start from: a campaign or solutions")


def solutions_of(frame: "pd.DataFrame", space: SearchSpace) -> list[dict[str, Any]]:
    """Return the rows of a data frame as known solutions.

    Args:
        frame: A column for each parameter, named as in `Result.to_pandas` or component.parameter; with a column
            ``robustness``, rows that have one are results, and the others are simulated first.
        space: The search space.

    Raises:
        InvalidInput: A column is missing, or a value is.
    """
    columns = {
        full: next((name for name in (full, short) if name in frame.columns), None)
        for full, short in zip(space.column_names(), parameter_columns(space), strict=True)
    }
    if missing := [full for full, column in columns.items() if column is None]:
        raise InvalidInput.at(
            "start_from", f"expected a column for each parameter; missing {', '.join(missing)}"
        )
    rows: Sequence[Mapping[Any, Any]] = frame.to_dict("records")
    at_times = [name for name, one in zip(space.column_names(), space.parameters, strict=True) if one.when]
    return [_solution(place, row, columns, at_times) for place, row in enumerate(rows)]


def _solution(
    place: int, row: Mapping[Any, Any], columns: Mapping[str, str | None], at_times: Collection[str]
) -> dict[str, Any]:
    values = {full: _plain(row[column]) for full, column in columns.items()}
    values = {full: value for full, value in values.items() if value is not None or full not in at_times}
    if empty := [name for name, value in values.items() if value is None]:
        raise InvalidInput.at(
            "start_from",
            f"row {place}: expected a value of {empty[0]}, got none; to start from a campaign's results, whose "
            "inactive parameters are empty, pass the result itself",
        )
    robustness = _plain(row.get(ROBUSTNESS))
    return {"values": values} if robustness is None else {"values": values, ROBUSTNESS: robustness}


def _plain(value: Any) -> Any:
    """Return a value as in JSON; None for an empty one."""
    plain = value.item() if isinstance(value, np.generic) else value
    return None if plain is None or plain != plain else plain


def known_from(start_from: StartFrom, space: SearchSpace) -> Known:
    """Return the prior knowledge of a study, which cannot refer to campaigns.

    Args:
        start_from: Known solutions.
        space: The search space.

    Raises:
        InvalidInput: It names a campaign, or a solution does not fit the space.
    """
    if start_from.solutions is None:
        raise InvalidInput.at("start_from", "expected a data frame or solutions: a study knows no campaigns")
    return known_of(given_records(space, start_from.solutions), space.dimension)
