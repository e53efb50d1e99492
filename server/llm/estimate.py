"""What a campaign's prompts will take, before it is submitted."""

from dataclasses import dataclass, replace
from typing import Final

from brink.search.algorithm import SeedRequest
from brink.search.traffic.participants import RoadLimits
from brink.server.llm.budget import cost_of, times, together, tokens_of, worst_usage
from brink.server.llm.form import as_text
from brink.server.llm.prompts import example, question
from brink.server.llm.settings import LlmSettings
from brink.server.llm.wire import Usage

_SHOWN: Final = 3
"""Known solutions of either kind that a differential request is assumed to show."""

_NOTHING: Final = Usage(prompt_tokens=0, completion_tokens=0, estimated=True)


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """What calls are expected to take.

    Attributes:
        calls: Calls, without repair turns.
        most_calls: Calls if each needs a repair turn, within ``max_calls``.
        usage: Tokens of `calls`.
        most_usage: Tokens of `most_calls`, each reply as long as it may be.
        cost: Of `usage`; None if a price is unknown.
        most_cost: Of `most_usage`; None if a price is unknown.
        solutions_a_reply: How many solutions fit into the longest reply.
    """

    calls: int
    most_calls: int
    usage: Usage
    most_usage: Usage
    cost: float | None
    most_cost: float | None
    solutions_a_reply: int

    @property
    def words(self) -> str:
        """On one line."""
        cost = "unknown" if self.cost is None else f"{self.cost:.3g}"
        most = "unknown" if self.most_cost is None else f"{self.most_cost:.3g}"
        return (
            f"about {self.calls} calls (at most {self.most_calls}), {self.usage.total} tokens (at most "
            f"{self.most_usage.total}), cost {cost} (at most {most}); a reply has room for about "
            f"{self.solutions_a_reply} solutions"
        )


def estimate(
    settings: LlmSettings,
    *,
    road: RoadLimits,
    most: int,
    system: str,
    initial: int,
    differential: int,
    differential_calls: int,
) -> Estimate:
    """Return what a campaign's calls will take.

    Args:
        settings: Of the model.
        road: Where participants are.
        most: Most participants of a solution.
        system: The system under test, in a few words.
        initial: Solutions of the first request; 0 if there is none.
        differential: Solutions of each later request.
        differential_calls: How many later requests are assumed.
    """
    shown = (example(road, most),) * _SHOWN
    first = SeedRequest(number=0, count=initial)
    later = SeedRequest(number=1, count=max(differential, 1), exposed=shown, silent=shown)
    firsts = 1 if initial else 0
    calls = min(firsts + differential_calls, settings.max_calls)
    repairs = min(calls, settings.max_calls - calls)
    a_solution = tokens_of(len(as_text([example(road, most)])))
    usage = most_usage = _NOTHING
    for request, made, repaired in (
        (first, firsts, min(repairs, firsts)),
        (later, calls - firsts, max(repairs - firsts, 0)),
    ):
        worst = worst_usage(settings, question(request, road, most, system))
        expected = replace(worst, completion_tokens=min(request.count * a_solution, settings.max_tokens))
        usage = together(usage, times(expected, made))
        # A repair turn repeats the question and what was accepted of its answer.
        repair = replace(worst, prompt_tokens=worst.total)
        most_usage = together(most_usage, together(times(worst, made), times(repair, repaired)))
    return Estimate(
        calls=calls,
        most_calls=calls + repairs,
        usage=usage,
        most_usage=most_usage,
        cost=cost_of(usage, settings),
        most_cost=cost_of(most_usage, settings),
        solutions_a_reply=max(1, settings.max_tokens // a_solution),
    )
