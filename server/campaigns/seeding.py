"""Where seeds come from that an algorithm waits for; asking may take minutes, so that nobody waits for it."""

from collections.abc import Sequence
from typing import Protocol

from brink.search.algorithm import Proposal, SeedRequest
from brink.server.llm.settings import LlmSettings
from brink.server.problems.base import Problem


class SeedSource(Protocol):
    """Gives seeds, the same ones for the same request of a campaign whenever it is asked."""

    def proposals(
        self, campaign_id: str, settings: LlmSettings | None, problem: Problem, request: SeedRequest
    ) -> Sequence[Proposal] | None:
        """Return what came, perhaps nothing; None while it is not known yet.

        The first call begins to ask; when the answer is there the campaign is advanced.
        """
        ...
