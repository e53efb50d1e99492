"""What has become of the drives of a suite, as a kind of finding."""

from brink.search.wald import CLEAR, MOST, WRONG
from brink.server.campaigns.follow_ups.store import read_ended
from brink.server.findings.finding import Finding, Step, Term
from brink.server.findings.kind import Kind, Listed, Subject
from brink.server.findings.suite.table import cases_table
from brink.server.findings.words import so_far
from brink.server.suites.results import CaseResult, judged, sorted_cases, verdict_words

LEGEND = [
    f"Safe: violations are rare. Unsafe: drives without one are rare. A sequential test decides after {CLEAR} to "
    f"{MOST} simulations; of drives that violate with half of the seeds, it calls at most {WRONG:.0%} safe and "
    f"{WRONG:.0%} unsafe. All others are unclear",
    "Expected safe: a regression test. Expected unsafe: a known hazard, which passes as long as it is there and when "
    "it is gone",
]


class SuiteKind(Kind):
    """The verdict on each drive of a suite."""

    id = "suite"
    title = "Hazards found earlier"
    rank = 5
    is_exclusive = True

    async def find(self, subject: Subject) -> Finding:
        """Return the verdicts, those that need attention first."""
        campaign, sources = subject.campaign, subject.sources
        ended = await sources.pages.read(sources.engines, lambda c: read_ended(c, campaign.id))
        cases = sorted_cases(
            judged(
                campaign.body.algorithm.params, ended, system=campaign.body.problem.id, campaign=campaign.id
            )
        )
        passed = sum(case.passed for case in cases)
        words = verdict_words([case.verdict for case in cases])
        return Finding(
            kind=self.id,
            title=self.title,
            role=subject.role,
            sentence=so_far(campaign, words),
            more=[
                "all are as expected" if passed == len(cases) else f"{len(cases) - passed} not as expected"
            ],
            purpose="Brink simulated drives again that were found earlier, to see which are safe now.",
            figures=[Term(term=f"{passed:,} of {len(cases):,}", words="drives are as expected")],
            legend=LEGEND,
            tables=[cases_table(cases, subject.rows)],
            steps=[*_watch(subject, cases), _compare(subject)],
        )

    def brief(self, listed: Listed) -> str:
        """Return how many simulations were unsafe: what they mean takes all of them."""
        return f"{listed.campaign.unsafe:,} unsafe simulations"


def _watch(subject: Subject, cases: list[CaseResult]) -> list[Step]:
    failing = [case for case in cases if not case.passed and case.solution is not None]
    if not failing:
        return []
    number, name = failing[0].solution, failing[0].name
    return [
        Step(
            kind="look",
            question=f"What happens in {name}?",
            label=f"Open solution {number}",
            words="Shows one of its drives.",
            place=f"{subject.path}/solutions/{number}",
            command=f"brink replay {subject.campaign.id} {number} --out hazard.mp4",
        )
    ]


def _compare(subject: Subject) -> Step:
    return Step(
        kind="versions",
        question="Which version broke or fixed what?",
        label="Compare versions",
        words="Shows the drives by all versions that simulated this suite here.",
        place=f"{subject.path}/versions",
    )


KIND = SuiteKind()
