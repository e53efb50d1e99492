"""The types of violations of a campaign."""

from collections import Counter
from collections.abc import Sequence

import numpy as np

from brink.search.analysis.avoidable import EXPLANATION, Avoidable, AvoidedBy, avoidable_first, by_words
from brink.search.analysis.violations import (
    RULES_VERSION,
    FoundViolation,
    ViolationType,
    by_type,
    is_at_fault,
)
from brink.search.archive import Archive
from brink.server.campaigns.archives import ReadArchive
from brink.server.campaigns.store import Campaign
from brink.server.campaigns.violations import read_violations, set_name
from brink.server.db.writer import Writer
from brink.server.errors import NotFound
from brink.server.findings.sources import Sources
from brink.server.findings.violations.views import TypeView, Violations, ViolationView
from brink.server.problems.base import ReportsViolations


async def find_violations(
    sources: Sources, campaign: Campaign, avoidable: Avoidable | None = None, *, types_only: bool = False
) -> Violations:
    """Return the violations of a campaign, grouped by type; those that a careful driver would have avoided first.

    Args:
        sources: Where findings are read from.
        campaign: The campaign.
        avoidable: Leave out violations that are not avoidable in this way; None keeps all.
        types_only: Whether to leave out the violations themselves.

    Raises:
        NotFound: Its problem does not report violations.
    """
    read = await sources.archives.get(campaign)
    found = await _reported(sources, campaign, read)

    def view() -> Violations:
        chosen = [one for one in found if avoidable in (None, one.avoidable)]
        return Violations(
            rules_version=RULES_VERSION,
            words=violations_words(found),
            explanation=EXPLANATION,
            types=seen_again(violation_types(chosen, found), read.archive),
            violations=[] if types_only else [violation_view(one) for one in chosen],
        )

    return await sources.pages.run(view)


async def name_violation(
    sources: Sources, writer: Writer, campaign: Campaign, number: int, requirement: str, name: str | None
) -> None:
    """Name a violation, which then belongs to the type of that name.

    Args:
        sources: Where findings are read from.
        writer: Writes the name.
        campaign: The campaign.
        number: The solution.
        requirement: The requirement that it violates.
        name: The name; None removes it, so that the rules assign the type again.

    Raises:
        NotFound: There is no such violation.
    """
    found = await _reported(sources, campaign, await sources.archives.get(campaign))
    known = [str(one.circumstances["requirement"]) for one in found if one.number == number]
    if requirement not in known:
        raise NotFound(
            f"campaign {campaign.id}: solution {number} has no violation of {requirement[:64]!r}; "
            f"it has {', '.join(known) or 'none'}"
        )
    await writer.write(lambda connection: set_name(connection, campaign.id, number, requirement, name))


async def _reported(sources: Sources, campaign: Campaign, read: ReadArchive) -> list[FoundViolation]:
    problem = read.plan.problem
    if not isinstance(problem, ReportsViolations):
        raise NotFound(
            f"campaign {campaign.id}: violations are sorted into types only where other traffic causes them, as for "
            f"npc-actions@1, not for {campaign.body.problem.id}; see what it found with: brink report {campaign.id}"
        )
    return await sources.pages.read(sources.engines, lambda c: read_violations(c, campaign.id, problem))


def violation_types(
    found: Sequence[FoundViolation], among: Sequence[FoundViolation] | None = None
) -> list[TypeView]:
    """Return the types of violations, each with an example of its own where it has one.

    First come those that a person named, then those that a careful driver would have avoided; each by frequency.

    Args:
        found: The violations.
        among: All violations, if `found` is a choice among them.
    """
    solutions: dict[str, set[int]] = {}
    for one in found if among is None else among:
        solutions.setdefault(one.type, set()).add(one.number)
    types = [_type_view(kind, len(solutions[kind.words])) for kind in by_type(found)]
    types.sort(
        key=lambda kind: (not kind.named, avoidable_first(kind.avoidable), -kind.solutions, kind.first)
    )
    return _with_examples(types, found)


def _with_examples(types: Sequence[TypeView], found: Sequence[FoundViolation]) -> list[TypeView]:
    """Return types, each with its first fitting solution as the example, unless an earlier type has the same one.

    Where there is none, it is the first fitting one: a drive may violate two requirements at once.
    """
    fitting: dict[tuple[str, Avoidable | None], set[int]] = {}
    for one in found:
        fitting.setdefault((one.type, one.avoidable), set()).add(one.number)
    taken: set[int] = set()
    chosen = []
    for kind in types:
        numbers = fitting[kind.type, kind.avoidable]
        example = min(numbers - taken or numbers)
        taken.add(example)
        chosen.append(kind.model_copy(update={"example": example}))
    return chosen


def seen_again(types: Sequence[TypeView], archive: Archive) -> list[TypeView]:
    """Return types, each with the number of repeated drives, and of those that showed the type again."""
    if not types:
        return []
    _, which = np.unique(archive.vectors, axis=0, return_inverse=True)
    drives = np.bincount(which.reshape(-1))
    solution = dict(zip(archive.numbers.tolist(), which.reshape(-1).tolist(), strict=True))
    told = []
    for kind in types:
        mine = [solution[number] for number in kind.numbers if number in solution]
        further = int(sum(drives[one] - 1 for one in set(mine)))
        words = f"{len(mine) - len(set(mine)):,} of {further:,}" if further else ""
        told.append(kind.model_copy(update={"again": words}))
    return told


def violations_words(found: Sequence[FoundViolation]) -> str:
    """Return a sentence on how many types of violations a careful driver would have avoided."""
    if not found:
        return "no violations"
    types = len({one.type for one in found})
    solutions = len({one.number for one in found})
    all_types = f"{types:,} {'type' if types == 1 else 'types'} of violations"
    all_solutions = f"{solutions:,} {'solution' if solutions == 1 else 'solutions'}"
    if all(one.avoidable is None for one in found):
        return f"{all_types} in {all_solutions}; not measured whether a careful driver would have avoided any"
    careful = [one for one in found if one.avoidable is Avoidable.CAREFUL]
    if not careful:
        return f"a careful driver would have avoided none of {all_types}, in {all_solutions}"
    avoided = len({one.type for one in careful})
    numbers = len({one.number for one in careful})
    return (
        f"a careful driver would have avoided {avoided:,} of {all_types}, {_by_braking(careful)}in {numbers:,} of "
        f"{all_solutions} with violations"
    )


def _by_braking(careful: Sequence[FoundViolation]) -> str:
    """Return how many types of violations a careful driver avoids by braking; empty if that was not recorded."""
    if any(one.avoided_by is None for one in careful):
        return ""
    braking = len({one.type for one in careful if one.avoided_by is AvoidedBy.BRAKING})
    return f"{braking:,} of them by braking, "


def _type_view(kind: ViolationType, solutions: int) -> TypeView:
    violations = kind.violations
    numbers = sorted({violation.number for violation in violations})
    faults = {is_at_fault(violation.circumstances) for violation in violations}
    counts = Counter(violation.avoidable for violation in violations)
    return TypeView(
        type=kind.words,
        solutions=len(numbers),
        avoided=_avoided_words(kind, solutions),
        instances=kind.instances,
        first=numbers[0],
        example=numbers[0],
        numbers=numbers,
        named=sum(violation.name is not None for violation in violations),
        avoidable=kind.avoidable,
        avoider=by_words(kind.avoidable),
        avoided_by=kind.avoided_by,
        avoidable_by={one: counts[one] for one in Avoidable},
        at_fault=faults.pop() if len(faults) == 1 else None,
    )


def _avoided_words(kind: ViolationType, solutions: int) -> str:
    """Return in how many of a type's solutions the violation is as avoidable as the type itself."""
    avoided = len({one.number for one in kind.violations if one.avoidable is kind.avoidable})
    nobody = kind.avoidable in (None, Avoidable.NO)
    return f"{solutions:,}" if nobody and avoided == solutions else f"{avoided:,} of {solutions:,}"


def violation_view(one: FoundViolation) -> ViolationView:
    """Return the response schema of a violation."""
    return ViolationView(
        number=one.number,
        requirement=str(one.circumstances["requirement"]),
        time_s=float(one.circumstances["time_s"]),
        type=one.type,
        name=one.name,
        avoidable=one.avoidable,
        avoided_by=one.avoided_by,
        at_fault=is_at_fault(one.circumstances),
        signature=one.signature.to_json(),
        circumstances=dict(one.circumstances),
    )
