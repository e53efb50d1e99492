"""The violations that a campaign found, with their types: by the rules, or as somebody named them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from brink.search.analysis.violation_instances import instances
from brink.search.analysis.violation_types import Signature


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundViolation:
    """One violation of one solution.

    Attributes:
        number: The solution.
        circumstances: As the simulator told them.
        signature: What the rules make of them.
        name: What a person says it is, or None.
    """

    number: int
    circumstances: Mapping[str, Any]
    signature: Signature
    name: str | None

    @property
    def type(self) -> str:
        """Its type in words."""
        return self.name or str(self.signature)


@dataclass(frozen=True, slots=True, kw_only=True)
class ViolationType:
    """All violations of one type.

    Attributes:
        words: The type.
        violations: Ascending by number.
    """

    words: str
    violations: tuple[FoundViolation, ...]

    @property
    def instances(self) -> int:
        """How many distinct ones there are among them."""
        return instances([violation.circumstances for violation in self.violations])


def by_type(found: Sequence[FoundViolation]) -> list[ViolationType]:
    """Return violations by type, in the order of finding."""
    types: dict[str, list[FoundViolation]] = {}
    for violation in found:
        types.setdefault(violation.type, []).append(violation)
    return [ViolationType(words=words, violations=tuple(its)) for words, its in types.items()]
