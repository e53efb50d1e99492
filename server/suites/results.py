"""What a run of a suite showed: a verdict on every drive, as it is printed, compared and kept."""

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Final, Literal

from pydantic import Field

from brink.search.algorithms.suite import tallied
from brink.search.analysis.suite import SuiteVerdict, passes, verdict_on
from brink.search.wald import MOST, Decision
from brink.server.documents import Body, parse_document, parse_yaml
from brink.server.errors import InvalidInput

VERSION: Final = 1
MOST_RESULT_BYTES: Final = 16 * 1024 * 1024


class CaseResult(Body):
    """The verdict on one drive."""

    name: str
    system: str
    found: Annotated[str, Field(description="What it was found to be: safe or unsafe; empty if unknown.")] = (
        ""
    )
    expect: Annotated[str, Field(description="What passes: safe or unsafe.")]
    verdict: Annotated[SuiteVerdict, Field(strict=False)]
    passed: Annotated[bool, Field(description="Whether it is as expected.")]
    decision: Annotated[Decision, Field(strict=False, description="What its simulations show.")]
    unsafe: Annotated[int, Field(ge=0, description="Simulations that violated.")] = 0
    evaluated: Annotated[int, Field(ge=0, description="Simulations with a verdict.")] = 0
    failed: Annotated[int, Field(ge=0, description="Simulations without one.")] = 0
    reason: Annotated[
        str, Field(description="Why it cannot run, or what it was in the earlier run; else empty.")
    ] = ""
    words: Annotated[str, Field(description="The drive in words.")] = ""
    campaign: Annotated[str, Field(description="Id of the campaign that simulated it; empty for none.")] = ""
    solution: Annotated[
        int | None, Field(description="Number of its first simulation with the verdict in that campaign.")
    ] = None
    episode: str = ""

    @property
    def simulated(self) -> str:
        """How often it was unsafe, in words."""
        failed = f", {self.failed} failed" if self.failed else ""
        return f"{self.unsafe} of {self.evaluated}{failed}" if self.evaluated or self.failed else ""

    @property
    def shown(self) -> str:
        """What the run showed of it, such as ``broken: unsafe 5 of 5, expected safe``."""
        shown = f"unsafe {self.simulated}" if self.simulated else ""
        return f"{self.verdict.value}: " + ", ".join(
            filter(None, (shown, f"expected {self.expect}", self.reason))
        )

    def against(self, before: "CaseResult | None", label: str) -> "CaseResult":
        """Return the result compared with that of an earlier run and its label, if that had a clear one."""
        if before is None or before.decision not in (Decision.SAFE, Decision.UNSAFE):
            return self
        if self.verdict in (SuiteVerdict.NOT_REPRODUCED, SuiteVerdict.CANNOT_RUN):
            return self
        verdict = verdict_on(self.decision, self.expect, before=before.decision.value)
        turned = self.decision in (Decision.SAFE, Decision.UNSAFE) and self.decision is not before.decision
        reason = f"{before.decision.value} in {label}" if turned else self.reason
        return self.model_copy(
            update={"verdict": verdict, "passed": passes(verdict, self.expect), "reason": reason}
        )


class SuiteResults(Body):
    """The results of a run, and the file that ``--json`` prints."""

    results: Literal[1] = VERSION
    suite: Annotated[str, Field(description="Name of the suite.")]
    label: Annotated[str, Field(description="What was tested, in a few words.")]
    at: Annotated[str, Field(description="When the run ended, in UTC.")]
    changes: dict[str, Any] = Field(default_factory=dict)
    against: Annotated[str, Field(description="Label of the earlier run that it is compared with.")] = ""
    complete: Annotated[bool, Field(description="Whether all simulations have ended.")] = True
    cases: list[CaseResult]

    @property
    def passed(self) -> bool:
        """Whether all is as expected."""
        return all(case.passed for case in self.cases)

    def of(self, verdict: SuiteVerdict) -> list[CaseResult]:
        """Return the drives with a verdict."""
        return [case for case in self.cases if case.verdict is verdict]

    @property
    def words(self) -> str:
        """How many drives have each verdict, in a sentence."""
        return verdict_words([case.verdict for case in self.cases])

    def compared(self, earlier: "SuiteResults") -> "SuiteResults":
        """Return the results compared with those of an earlier run, drive by drive."""
        before = {case.name: case for case in earlier.cases}
        cases = [case.against(before.get(case.name), earlier.label) for case in self.cases]
        return self.model_copy(update={"cases": cases, "against": earlier.label})


def sorted_cases(cases: Sequence[CaseResult]) -> list[CaseResult]:
    """Return drives in order of attention: those that are not as expected first."""
    order = list(SuiteVerdict)
    return sorted(cases, key=lambda case: (case.passed, order.index(case.verdict)))


def verdict_words(verdicts: Sequence[SuiteVerdict]) -> str:
    """Return how many drives have each verdict, such as ``2 of 60 drives broken, 1 fixed, 57 still safe``."""
    counts = {verdict: list(verdicts).count(verdict) for verdict in SuiteVerdict}
    parts = [f"{count:,} {verdict.value}" for verdict, count in counts.items() if count]
    drives = f"{len(verdicts):,} drive{'' if len(verdicts) == 1 else 's'}"
    return f"{drives}: {', '.join(parts)}" if parts else "no drive"


def judged(
    params: Mapping[str, Any], ended: Mapping[int, bool | None], *, system: str, campaign: str
) -> list[CaseResult]:
    """Return the verdicts on the drives of a campaign of a suite, in its order.

    Args:
        params: Settings of its algorithm.
        ended: Whether each of its candidates that has ended was unsafe, by number; None if it failed.
        system: Name of the system.
        campaign: Id of the campaign.
    """
    drives, most = len(params["solutions"]), params.get("most", MOST)
    cases = []
    for place, tally in enumerate(tallied(drives, ended, most=most)):
        expect = _at(params, "expect", place) or "unsafe"
        reproduce = _at(params, "reproduce", place)
        decision = tally.decision
        verdict = verdict_on(decision, expect, reproduce=reproduce)
        cases.append(
            CaseResult(
                name=_at(params, "names", place) or f"drive {place + 1}",
                system=system,
                expect=expect,
                found=reproduce,
                verdict=verdict,
                passed=passes(verdict, expect),
                decision=decision,
                unsafe=tally.unsafe,
                evaluated=tally.evaluated,
                failed=tally.failed,
                reason=_why(verdict, tally.failed),
                campaign=campaign,
                solution=tally.examples.get(decision is Decision.UNSAFE),
                episode=_at(params, "episodes", place),
            )
        )
    return cases


def version_label(notes: str, campaign: str) -> str:
    """Return what a campaign tested: its notes, where each run of the version left its label.

    Args:
        notes: The notes.
        campaign: Id of the campaign, if it has none.
    """
    return ", ".join(filter(None, map(str.strip, notes.splitlines()))) or f"campaign {campaign}"


def _at(params: Mapping[str, Any], name: str, place: int) -> str:
    values: Sequence[str] = params.get(name) or ()
    return values[place] if values else ""


def _why(verdict: SuiteVerdict, failed: int) -> str:
    if verdict is SuiteVerdict.CANNOT_RUN:
        return f"all {failed} simulations failed"
    if verdict is SuiteVerdict.NOT_REPRODUCED:
        return "nothing has changed since it was found otherwise"
    return ""


def parse_results(text: str, where: str) -> SuiteResults:
    """Read the results of an earlier run.

    Raises:
        InvalidInput: They are none.
    """
    try:
        return parse_document(parse_yaml(text), SuiteResults, "what brink suite run --json printed")
    except InvalidInput as error:
        raise InvalidInput.at(where, str(error)) from None
