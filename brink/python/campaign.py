"""A campaign written in Python, and every other form that `brink.run` and `Client.submit` accept."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

from brink.python.start import Start, started
from brink.server.campaigns.body import CampaignBody, parse_body, read_campaign_file

CampaignLike: TypeAlias = "Campaign | CampaignBody | Mapping[str, Any] | str | Path"
"""A campaign, or its file, or the content of its file."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Campaign:
    """A campaign: a problem, an algorithm and a budget.

    docs/reference/problems.md lists problems, algorithms and their parameters.

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
        start_from: Prior knowledge: an earlier campaign, its result or id, or a data frame with a column for
            each parameter and one for ``robustness``.
        more: Further fields of the campaign file, such as ``repeats`` or ``execution``.
    """

    problem: str
    simulations: int
    algorithm: str = "edge@1"
    name: str = ""
    seed: int = 1
    problem_params: Mapping[str, Any] = field(default_factory=dict)
    algorithm_params: Mapping[str, Any] = field(default_factory=dict)
    odd: Mapping[str, Any] = field(default_factory=dict)
    start_from: Start = None
    more: Mapping[str, Any] = field(default_factory=dict)

    def document(self) -> dict[str, Any]:
        """Return the campaign as in a campaign file, without its prior knowledge."""
        odd = {"odd": dict(self.odd)} if self.odd else {}
        return {
            "name": self.name or f"{self.problem.partition('@')[0]}, {self.algorithm.partition('@')[0]}",
            "problem": {"id": self.problem, "params": {**self.problem_params, **odd}},
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
        return started(parse_body(campaign.document()), campaign.start_from)
    return parse_body(dict(campaign))
