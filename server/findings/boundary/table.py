"""Boundary solutions as a table with one row for each solution: CSV, JSON Lines or Parquet."""

import json
from collections.abc import Mapping, Sequence
from typing import Any, Final

from brink.search.parameters import Categorical, Integer
from brink.search.space import SearchSpace
from brink.server.campaigns.body import CampaignBody
from brink.server.campaigns.store import Campaign
from brink.server.findings.boundary.views import Boundary
from brink.server.findings.table import Cell, Row, table_bytes
from brink.server.views import SolutionView

MEANINGS: Final = {
    "number": "number of the solution in its campaign",
    "verdict": "safe or unsafe by the requirements of the campaign, from its simulation during the search",
    "outcome": "what that simulation showed about all recorded requirements, with the moments of violations",
    "robustness": "robustness of the campaign's requirement: distance to violation, negative if violated",
    "fitness": "distance of its neighbourhood from the boundary; 0 on the boundary",
    "neighbours": "evaluated solutions within the radius, including itself",
    "unsafe_neighbours": "unsafe solutions among the neighbours",
    "interval_low": "lower limit of the Wilson interval of the unsafe share of its neighbourhood",
    "interval_high": "upper limit of that interval",
    "strict": "whether the interval contains p_th and the neighbourhood has both verdicts",
    "seed": "seed of its episode: the same seed gives the same episode, bit for bit",
    "words": "description of the solution in words",
    "campaign": "id of the campaign",
    "problem": "problem that the campaign searched",
    "algorithm": "algorithm that the campaign used",
    "campaign_seed": "seed of the search",
    "generation": "generation of the solution",
    "robustness.*": "robustness of each requirement, in its unit; negative if violated",
    "violated_at_s.*": "simulated time at which each requirement was first violated; empty if it held",
    "feature.*": "other measurements of the episode",
    "version.*": "version of each part of the software that ran the simulation",
    "idle": "components that were inactive in its episode; empty if none, or if it was not recorded",
    "*.*": "parameter of a component, decoded, as its episode had it; empty if it was inactive in the episode",
    "component.*": "number of ground-truth boxes (seen), of detections (said), or of false positives (invented)",
}
"""Meaning of the columns; an asterisk stands for any name."""
_TIMINGS: Final = ("cpu_s", "simulated_s")


_SOLUTION: Final[Mapping[str, type]] = {
    "number": int,
    "verdict": str,
    "outcome": str,
    "robustness": float,
    "fitness": float,
    "neighbours": int,
    "unsafe_neighbours": int,
    "interval_low": float,
    "interval_high": float,
    "strict": bool,
    "seed": int,
    "words": str,
    "idle": str,
}
_CAMPAIGN: Final[Mapping[str, type]] = {
    "campaign": str,
    "problem": str,
    "algorithm": str,
    "campaign_seed": int,
    "generation": int,
}


def boundary_columns(space: SearchSpace) -> dict[str, type]:
    """Return the columns of every table of boundary solutions in a search space, with the type of their values.

    Columns for what was measured in the episodes follow.
    """
    return {**_SOLUTION, **parameter_columns(space), **_CAMPAIGN}


def parameter_columns(space: SearchSpace) -> dict[str, type]:
    """Return a column for each parameter of a space, as component.parameter, with the type of its values."""
    kinds: dict[type, type] = {Categorical: str, Integer: int}
    return {
        f"{component.name}.{one.name}": kinds.get(type(one), float)
        for component in space.components
        for one in component.parameters
    }


def boundary_file(boundary: Boundary, campaign: Campaign, space: SearchSpace, form: str) -> bytes:
    """Encode boundary solutions as a file.

    Args:
        boundary: The solutions with all details.
        campaign: The campaign.
        space: Its search space.
        form: ``csv``, ``jsonl`` or ``parquet``.

    Raises:
        InvalidInput: The format is Parquet, and pyarrow is not installed.
    """
    return table_bytes(boundary_rows(boundary, campaign.id, campaign.body), form, boundary_columns(space))


def boundary_rows(boundary: Boundary, campaign: str, body: CampaignBody) -> list[Row]:
    """Return boundary solutions as rows that all have the same columns.

    Args:
        boundary: The solutions with all details.
        campaign: Id of the campaign.
        body: Body of the campaign.
    """
    strict = set(boundary.strict)
    rows: list[Row] = []
    for solution in boundary.solutions:
        low, high = solution.interval or (None, None)
        row: Row = {
            "number": solution.number,
            "verdict": str(solution.verdict),
            "outcome": solution.outcome,
            "robustness": solution.robustness,
            "fitness": solution.fitness,
            "neighbours": solution.neighbours,
            "unsafe_neighbours": solution.unsafe_neighbours,
            "interval_low": low,
            "interval_high": high,
            "strict": solution.number in strict,
            "seed": solution.seed,
            "words": solution.words,
        }
        row.update(_parameters(solution))
        row.update(
            {
                "campaign": campaign,
                "problem": body.problem.id,
                "algorithm": body.algorithm.id,
                "campaign_seed": body.seed,
                "generation": solution.generation,
            }
        )
        for name, verdict in (solution.verdicts or {}).items():
            row[f"robustness.{name}"] = verdict["robustness"]
            row[f"violated_at_s.{name}"] = verdict.get("violated_at_s")
        row.update({f"feature.{name}": _cell(value) for name, value in (solution.features or {}).items()})
        provenance = solution.provenance or {}
        row.update({f"version.{name}": _cell(v) for name, v in provenance.items() if name not in _TIMINGS})
        rows.append(row)
    return _with_all_columns(rows)


def _parameters(solution: SolutionView) -> Row:
    """Return the parameters that were active in the episode, or all if that was not recorded."""
    activity = solution.activity
    shown = solution.parameters if activity is None else activity.effective
    inactive = frozenset(() if activity is None else activity.inactive)
    row: Row = {"idle": "" if activity is None else ", ".join(activity.idle)}
    for component, values in shown.items():
        names = {f"{component}.{name}": value for name, value in values.items()}
        row.update({name: None if name in inactive else _cell(value) for name, value in names.items()})
    return row


def _cell(value: Any) -> Cell:
    return value if value is None or isinstance(value, str | int | float | bool) else json.dumps(value)


def _with_all_columns(rows: Sequence[Mapping[str, Cell]]) -> list[Row]:
    """Return rows that all have the same columns, in order of first appearance."""
    columns = list(dict.fromkeys(name for row in rows for name in row))
    return [{name: row.get(name) for name in columns} for row in rows]
