"""The violations that a campaign found, with their types: by the rules, or as somebody named them."""

import logging
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Row

from brink.server.problems.base import TellsViolations
from brink.server.violations.instances import instances, scaled_circumstances
from brink.server.violations.rules import Signature, signature_of
from brink.worker.wire import Completed

log = logging.getLogger(__name__)


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


def found_violations(
    rows: Iterable[Row[*tuple[Any, ...]]], names: Mapping[tuple[int, str], str], problem: TellsViolations
) -> list[FoundViolation]:
    """Return the violations of unsafe solutions.

    Args:
        rows: Number and result of each, ascending by number.
        names: What people say, by number and requirement.
        problem: Says which violations count.
    """
    return [
        FoundViolation(
            number=row.number,
            circumstances=circumstances,
            signature=signature,
            name=names.get((row.number, str(circumstances["requirement"]))),
        )
        for row in rows
        if row.result is not None
        for circumstances in problem.violations(Completed.model_validate_json(row.result))
        if (signature := _signature(row.number, circumstances)) is not None
    ]


def _signature(number: int, circumstances: Mapping[str, Any]) -> Signature | None:
    """Return the type of a violation; None if a worker told its circumstances in another form."""
    try:
        scaled_circumstances(circumstances)
        return signature_of(circumstances)
    except (LookupError, TypeError, ValueError) as error:
        log.warning("solution %d: a violation that cannot be read: %r", number, error)
        return None


def by_type(found: Sequence[FoundViolation]) -> list[ViolationType]:
    """Return violations by type, in the order of finding."""
    types: dict[str, list[FoundViolation]] = {}
    for violation in found:
        types.setdefault(violation.type, []).append(violation)
    return [ViolationType(words=words, violations=tuple(its)) for words, its in types.items()]
