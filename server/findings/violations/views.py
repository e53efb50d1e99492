"""Response schemas of violations."""

from typing import Annotated, Any

from pydantic import Field

from brink.search.analysis.avoidable import Avoidable, AvoidedBy
from brink.server.views import AVOIDABLE, AVOIDED_BY, View


class ViolationView(View):
    """A violation of a requirement by a solution."""

    number: Annotated[int, Field(description="Number of the solution.")]
    requirement: str
    time_s: float
    type: str
    name: Annotated[str | None, Field(description="Name that a person gave it.")]
    avoidable: Annotated[Avoidable | None, Field(description=AVOIDABLE)]
    avoided_by: Annotated[AvoidedBy | None, Field(description=AVOIDED_BY)] = None
    at_fault: Annotated[
        bool, Field(description="Whether the ego vehicle was at fault by a rule of thumb; see `avoidable`.")
    ]
    signature: Annotated[
        dict[str, str], Field(description="Features that the rules derive from its circumstances.")
    ]
    circumstances: Annotated[
        dict[str, Any], Field(description="Circumstances as the simulator reported them.")
    ]


class TypeView(View):
    """A type of violation."""

    type: str
    solutions: Annotated[int, Field(description="Number of solutions with a violation of this type.")]
    avoided: Annotated[
        str,
        Field(
            description="In how many of these solutions `avoider` would have avoided it, such as `15 of 20`; their "
            "number alone if nobody would have, or if that was not measured."
        ),
    ]
    instances: Annotated[int, Field(description="Distinct instances: clusters of similar circumstances.")]
    first: Annotated[
        int, Field(description="Number of the first solution, in which the type was discovered.")
    ]
    example: Annotated[
        int,
        Field(
            description="Number of the first solution with a violation that is `avoidable` as the type is, other "
            "than the examples of earlier types, if there is one."
        ),
    ]
    numbers: Annotated[list[int], Field(description="Numbers of its solutions, in ascending order.")]
    again: Annotated[
        str,
        Field(
            description="In how many further drives of its solutions, under other seeds of the campaign, the type "
            "was seen again, such as `3 of 4`; empty if the search simulated none of them again."
        ),
    ] = ""
    named: Annotated[int, Field(description="Number of its violations that a person named.")]
    avoidable: Annotated[
        Avoidable | None,
        Field(description="The best value among its violations; null if it was measured for none of them."),
    ]
    avoider: Annotated[str, Field(description="The same in words, such as `careful driver`.")]
    avoided_by: Annotated[
        AvoidedBy | None,
        Field(
            description="How that driver avoids them: by `braking` if that avoids any of them; null if none does, or "
            "that was not recorded."
        ),
    ] = None
    avoidable_by: Annotated[
        dict[Avoidable, int],
        Field(
            description="Number of its violations by who would have avoided them, where that was measured."
        ),
    ]
    at_fault: Annotated[
        bool | None,
        Field(
            description="Whether the ego vehicle was at fault by a rule of thumb; null if its violations differ."
        ),
    ]


class Violations(View):
    """The violations of a campaign."""

    rules_version: int
    words: Annotated[str, Field(description="The finding in a sentence, about all violations.")]
    explanation: Annotated[str, Field(description="Who the reference drivers are, in sentences.")]
    types: Annotated[
        list[TypeView],
        Field(
            description="First those that a person named, then those that a careful driver would have avoided, those "
            "that take braking at once, and the rest; each by frequency. `first` gives the order of discovery."
        ),
    ]
    violations: Annotated[list[ViolationView], Field(description="In ascending order of number.")]


class AvoidableExample(View):
    """A violation that a careful driver would have avoided, the first of its type."""

    number: Annotated[int, Field(description="Number of the solution.")]
    words: Annotated[str, Field(description="What the system did, such as `hit a pedestrian at 12.8 s`.")]
    type: Annotated[str, Field(description="Its type.")]


class ViolationsFound(View):
    """Details that only violations have: examples for pictures."""

    examples: Annotated[
        list[AvoidableExample],
        Field(
            description="Examples of the most frequent types of violations that a careful driver would have avoided."
        ),
    ]
    explanation: Annotated[
        str, Field(description="Explanation of that driver, in sentences; empty if there is no example.")
    ]
