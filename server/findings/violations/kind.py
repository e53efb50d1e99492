"""Types of violations as a kind of finding."""

from collections.abc import Sequence
from typing import Final

from brink.search.analysis.avoidable import EXPLANATION, Avoidable
from brink.search.analysis.violations import FoundViolation, by_type
from brink.server.campaigns.violations import read_violations
from brink.server.findings.finding import Finding, Step, Term
from brink.server.findings.kind import Kind, Listed, Settings, Subject
from brink.server.findings.table import Column, Format, Table
from brink.server.findings.violations.analysis import seen_again, violation_types, violations_words
from brink.server.findings.violations.views import AvoidableExample, TypeView, ViolationsFound
from brink.server.findings.words import counted
from brink.server.problems.base import Problem, ReportsViolations
from brink.sim.requirements import CollisionKind
from brink.sim.verdict import clock_words, impact_of, violated_words

MOST_EXAMPLES: Final = 2
COLUMNS: Final = [
    Column(name="avoider", title="avoidable by"),
    Column(name="avoided_by", title="how"),
    Column(name="solutions", title="solutions"),
    Column(name="again", title="again"),
    Column(name="instances", title="distinct", format=Format.COUNT),
    Column(name="at_fault", title="at fault by the rule"),
    Column(name="example", title="example", format=Format.SOLUTION),
    Column(name="type", title="type of violation"),
    Column(name="first", title="first solution", format=Format.SOLUTION, detail=True),
]
LEGEND: Final = [
    "Avoidable: each drive with a violation was driven again by reference drivers among the same road users, which "
    "follow the same scripts; a violation is avoided if the driver has neither it nor a collision until 5 s "
    "afterwards",
    "Again: the same drives with other seeds that had the type too",
    "Violations with the same circumstances are of one type; who is at fault by the rule follows from who moved how, "
    "and is not a legal judgement",
]
_AT_FAULT: Final = {True: "ego", False: "others", None: "differs"}


class ViolationsSettings(Settings):
    """Who would have avoided the violations whose types to find; by default, all types are found."""

    avoidable: Avoidable | None = None


class ViolationsKind(Kind):
    """Types of violations that other road users cause."""

    id = "violations"
    title = "Types of violations"
    rank = 30
    settings = ViolationsSettings

    def is_reported_by(self, problem: Problem) -> bool:
        """Return whether the circumstances of violations are recorded."""
        return isinstance(problem, ReportsViolations)

    def fits(self, plan: object) -> bool:
        """Return False: only problems that report violations have them."""
        return False

    async def find(self, subject: Subject) -> Finding:
        """Return the types of violations, avoidable ones first."""
        sources, problem = subject.sources, subject.plan.problem
        assert isinstance(problem, ReportsViolations)
        found = await sources.pages.read(
            sources.engines, lambda c: read_violations(c, subject.campaign.id, problem)
        )
        return await sources.pages.run(lambda: self._finding(subject, found))

    def _finding(self, subject: Subject, found: Sequence[FoundViolation]) -> Finding:
        avoidable = subject.settings.avoidable
        chosen = [one for one in found if avoidable in (None, one.avoidable)]
        types = seen_again(violation_types(chosen, found), subject.read.archive)
        examples = _avoidable_examples(found)
        return Finding(
            kind=self.id,
            title=self.title,
            role=subject.role,
            sentence=violations_words(found),
            more=[EXPLANATION] if any(kind.avoidable for kind in types) else [],
            purpose="Brink searched for ways in which other road users make the driving system violate a "
            "requirement, as different from each other as possible.",
            example=_example(types),
            figures=[Term(term=f"{len(types):,}", words="types of violations")],
            legend=LEGEND if types else [],
            is_empty=not found,
            view=ViolationsFound(examples=examples, explanation=EXPLANATION if examples else ""),
            tables=[types_table(types[: subject.rows], left_out=max(0, len(types) - subject.rows))],
            steps=[
                Step(
                    kind="look",
                    question="Which violations are there?",
                    words="Lists all types of violations, and names them.",
                    command=f"brink violations {subject.campaign.id}",
                ),
                *_keep(subject, types),
            ],
        )

    def brief(self, listed: Listed) -> str:
        """Return how many types there are, and how many of them a careful driver would have avoided."""
        problem = listed.plan.problem
        assert isinstance(problem, ReportsViolations)
        with listed.archives.engines.reader.connect() as connection:
            types = by_type(read_violations(connection, listed.campaign.id, problem))
        if not types:
            return "no violation"
        words = counted(len(types), "type of violations", "types of violations")
        kinds = [one.avoidable for one in types]
        if not any(kinds):
            return words
        return f"{kinds.count(Avoidable.CAREFUL) or 'none'} of {words} avoidable"


def _keep(subject: Subject, types: Sequence[TypeView]) -> list[Step]:
    if any(kind.avoidable is Avoidable.CAREFUL for kind in types):
        return [subject.keep("--violations avoidable", "a drive of each type that a careful driver avoids")]
    return [subject.keep("--violations all", "a drive of each type")] if types else []


def _example(types: Sequence[TypeView]) -> str:
    """Return the first type in a sentence; empty if there is none."""
    if not types:
        return ""
    most = types[0]
    which = "The most frequent type" + (f" {most.avoidable.words}" if most.avoidable else "")
    drives = "drive" if most.solutions == 1 else "drives"
    return f"{which}, in {most.avoided} {drives}: {most.type}"


def types_table(types: Sequence[TypeView], left_out: int = 0) -> Table:
    """Return types of violations as a table."""
    return Table(
        name="types",
        title="Types of violations, avoidable ones first, then by frequency",
        columns=COLUMNS,
        rows=[
            [
                kind.avoider,
                kind.avoided_by or "",
                kind.avoided,
                kind.again,
                kind.instances,
                _AT_FAULT[kind.at_fault],
                kind.example,
                kind.type,
                kind.first,
            ]
            for kind in types
        ],
        left_out=left_out,
    )


def _avoidable_examples(found: Sequence[FoundViolation]) -> list[AvoidableExample]:
    """Return a violation of each of the first types that a careful driver would have avoided, one per solution."""
    examples: dict[int, AvoidableExample] = {}
    careful = [one for one in found if one.avoidable is Avoidable.CAREFUL]
    for kind in violation_types(careful):
        if len(examples) == MOST_EXAMPLES:
            break
        one = next(one for one in careful if (one.number, one.type) == (kind.example, kind.type))
        hit = next((each for each in CollisionKind if each == one.circumstances["collision"]), None)
        did = violated_words(str(one.circumstances["requirement"]), hit, impact_of(one.circumstances))
        words = f"{did} at {clock_words(float(one.circumstances['time_s']))}"
        examples.setdefault(one.number, AvoidableExample(number=one.number, words=words, type=one.type))
    return list(examples.values())


KIND = ViolationsKind()
