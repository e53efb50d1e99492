"""Suites over the API: entries from what a campaign found, and runs of all systems of a suite."""

import re
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from hashlib import sha256
from typing import Final

import numpy as np
from pydantic import TypeAdapter

from brink.api.client import Api
from brink.api.follow_ups import OPEN
from brink.api.results import FetchedArchive, fetch_archive
from brink.api.runs import CampaignRun, resume_or_submit
from brink.search.analysis.avoidable import Avoidable
from brink.search.analysis.confirmation import Confirmation
from brink.search.analysis.suite import SuiteVerdict
from brink.search.wald import Decision
from brink.server.api.schemas import CampaignView, Progress
from brink.server.errors import InvalidInput
from brink.server.findings.finding import Finding
from brink.server.findings.follow_ups import ShareView
from brink.server.findings.pairs.views import MOST_PAIRS, PairsView
from brink.server.findings.table import MOST_ROWS
from brink.server.findings.thresholds.views import ThresholdsView
from brink.server.findings.violations.views import Violations
from brink.server.states import CampaignStatus
from brink.server.suites.campaigns import DIGITS, Case, SystemRun, episode_digest, episode_of, system_of
from brink.server.suites.file import Drive, Entry, NewEntry, System, units_of
from brink.server.suites.results import CaseResult, SuiteResults

LONGEST_STEM: Final = 48
_MOMENT: Final = re.compile(r" (at|from|after) \d+(\.\d+)? s\b")
_SEED_BITS: Final = 30


@dataclass(frozen=True, slots=True, kw_only=True)
class Chosen:
    """Which drives of a campaign to take.

    Attributes:
        pairs: ``confirmed`` or ``all`` pairs, or some as ``SAFE-UNSAFE,…`` by the numbers of their drives; empty for
            none.
        violations: ``avoidable`` or ``all`` types of violations, one drive of each; empty for none.
        solutions: Solutions by number.
        thresholds: Whether to take the drives at both ends of every threshold.
    """

    pairs: str = ""
    violations: str = ""
    solutions: Sequence[int] = ()
    thresholds: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class _Found:
    """A drive or a pair of a campaign: numbers of its sides, and how often each was unsafe."""

    words: str
    note: str = ""
    tag: str = ""
    unsafe: int | None = None
    safe: int | None = None
    unsafe_again: tuple[int, int] = (1, 1)
    safe_again: tuple[int, int] = (0, 1)


@dataclass(frozen=True, slots=True, kw_only=True)
class NewEntries:
    """Entries from a campaign.

    Attributes:
        campaign: Its full id.
        system: What it tested.
        entries: The entries, whose system is still empty.
        notes: What was left out and why, in sentences.
    """

    campaign: str
    system: System
    entries: Sequence[NewEntry]
    notes: Sequence[str]

    def named(self, system: str, name: str, taken: Sequence[str]) -> list[NewEntry]:
        """Return the entries with the name of their system and names that no other entry has.

        Args:
            system: Name of the system.
            name: How to name them, numbered if there are several; empty to name them by what happened.
            taken: Names of other entries.
        """
        used = set(taken)
        named = []
        for new in self.entries:
            stem = name or new.entry.name
            free = (stem if count == 1 else f"{stem}-{count}" for count in range(1, len(used) + 2))
            chosen = next(one for one in free if one not in used)
            used.add(chosen)
            entry = new.entry.model_copy(update={"name": chosen, "system": system})
            named.append(replace(new, entry=entry))
        return named


async def find_entries(api: Api, campaign: str, chosen: Chosen) -> NewEntries:
    """Return entries for what a campaign found.

    Args:
        api: Coordinator of the campaign.
        campaign: Id of the campaign.
        chosen: What to take of it.

    Raises:
        InvalidInput: Nothing is chosen, or there is none of it.
        CoordinatorError: The campaign does not exist.
    """
    fetched = await fetch_archive(api, campaign)
    verdicts = dict(zip(fetched.archive.numbers.tolist(), fetched.archive.unsafe.tolist(), strict=True))
    found: list[_Found] = []
    notes: list[str] = []
    if chosen.pairs:
        found += await _pairs(api, campaign, notes, chosen.pairs)
    if chosen.thresholds:
        found += await _thresholds(api, campaign, notes)
    if chosen.violations:
        found += await _violations(api, campaign, verdicts, notes, only_avoidable=chosen.violations != "all")
    found += _solutions(fetched, chosen.solutions, verdicts)
    if not found:
        raise InvalidInput.at(
            "--pairs, --violations, --solutions, --thresholds",
            f"expected drives of campaign {campaign}: {'; '.join(notes) or 'nothing is chosen'}",
        )
    new, changed = [], 0
    for one in found:
        entry, is_changed = _entry(fetched, one)
        changed += is_changed
        new.append(NewEntry(entry=entry, units=units_of(fetched.plan.problem.space)))
    if changed:
        notes.append(
            f"{changed} of {len(new)} entries were found with other code than is installed here, so a run cannot "
            "tell whether they are reproduced"
        )
    return NewEntries(campaign=fetched.id, system=system_of(fetched.plan), entries=new, notes=notes)


async def _pairs(api: Api, campaign: str, notes: list[str], wanted: str) -> list[_Found]:
    view = await api.read(PairsView, f"/campaigns/{campaign}/pairs", {"limit": MOST_PAIRS})
    if wanted in ("confirmed", "all"):
        pairs = [
            one for one in view.pairs if wanted == "all" or one.confirmation.state is Confirmation.CONFIRMED
        ]
        if len(pairs) < len(view.pairs):
            notes.append(
                f"{len(view.pairs) - len(pairs)} of {len(view.pairs)} pairs are not confirmed: brink pairs "
                f"{campaign} --confirm 30 tries to"
            )
        elif not pairs:
            notes.append("there is no pair")
    else:
        by_numbers = {frozenset((one.safe.number, one.unsafe.number)): one for one in view.pairs}
        pairs = []
        for text in wanted.split(","):
            pair = by_numbers.get(frozenset(map(int, text.split("-"))))
            if pair is None:
                raise InvalidInput.at(
                    "--pairs", f"campaign {campaign} has no pair {text}: brink pairs {campaign} lists them"
                )
            pairs.append(pair)
    return [
        _Found(
            words=one.unsafe.outcome,
            note=one.change,
            tag="pair",
            unsafe=one.unsafe.number,
            safe=one.safe.number,
            unsafe_again=_again(one.confirmation.unsafe, one.unsafe.evaluated, unsafe=True),
            safe_again=_again(one.confirmation.safe, one.safe.evaluated, unsafe=False),
        )
        for one in pairs
    ]


async def _thresholds(api: Api, campaign: str, notes: list[str]) -> list[_Found]:
    found = await api.read(Finding, f"/campaigns/{campaign}/findings/thresholds", {"rows": MOST_ROWS})
    thresholds = ThresholdsView.model_validate(found.view).thresholds if found.view else []
    ends = [(one, one.pair) for one in thresholds if one.pair is not None]
    if not ends:
        notes.append("there is no threshold with drives at both ends")
    return [
        _Found(
            words=pair.unsafe.outcome,
            note=one.words,
            tag="threshold",
            unsafe=pair.unsafe.number,
            safe=pair.safe.number,
            unsafe_again=_again(pair.unsafe.again, 1, unsafe=True),
            safe_again=_again(pair.safe.again, 1, unsafe=False),
        )
        for one, pair in ends
    ]


async def _violations(
    api: Api, campaign: str, verdicts: Mapping[int, bool], notes: list[str], *, only_avoidable: bool
) -> list[_Found]:
    view = await api.read(Violations, f"/campaigns/{campaign}/violations")
    types = [one for one in view.types if not only_avoidable or one.avoidable is Avoidable.CAREFUL]
    found = []
    for one in types:
        unsafe = [number for number in (one.example, *one.numbers) if verdicts.get(number)]
        if unsafe:
            found.append(_Found(words=one.type, note=one.type, tag="violation", unsafe=unsafe[0]))
    if len(found) < len(types):
        notes.append(f"{len(types) - len(found)} types of violations are not of the campaign's requirement")
    if len(types) < len(view.types):
        notes.append(
            f"{len(view.types) - len(types)} of {len(view.types)} types of violations would not have been avoided by "
            "a careful driver"
        )
    elif not types:
        notes.append("there is no violation")
    return found


def _solutions(fetched: FetchedArchive, numbers: Sequence[int], verdicts: Mapping[int, bool]) -> list[_Found]:
    found = []
    for number in numbers:
        if number not in verdicts:
            raise InvalidInput.at("--solutions", f"campaign {fetched.id} has no evaluated solution {number}")
        found.append(
            _Found(words="unsafe", unsafe=number) if verdicts[number] else _Found(words="safe", safe=number)
        )
    return found


def _again(share: ShareView, evaluated: int, *, unsafe: bool) -> tuple[int, int]:
    """Return how often a side was unsafe, and of how many: with other seeds if that is known, else in the search."""
    if share.evaluated:
        return share.unsafe, share.evaluated
    return (evaluated if unsafe else 0), evaluated


def _entry(fetched: FetchedArchive, found: _Found) -> tuple[Entry, bool]:
    """Return an entry without a system, and whether the code of what it was found with has changed since."""
    drives: dict[str, Drive] = {}
    is_changed = False
    numbers = [number for number in (found.unsafe, found.safe) if number is not None]
    seed = _seed(fetched, numbers)
    for side, number, (unsafe, of) in (
        ("unsafe", found.unsafe, found.unsafe_again),
        ("safe", found.safe, found.safe_again),
    ):
        if number is not None:
            drive, same = _drive(fetched, number, side, unsafe, of, seed)
            drives[side] = drive
            is_changed |= not same
    words = _MOMENT.sub("", found.words)
    stem = re.sub(r"[^\w]+", "-", words.lower()).strip("-")[:LONGEST_STEM].strip("-")
    entry = Entry(
        name=f"{stem or 'drive'}-{numbers[0]}",
        system="-",
        seed=seed,
        campaign=fetched.id,
        tags=[found.tag] if found.tag else [],
        note=found.note,
        **drives,
    )
    return entry, is_changed


def _seed(fetched: FetchedArchive, numbers: Sequence[int]) -> int:
    """Return a seed that follows from the values of the drives, far from those of the search."""
    places = [_place(fetched, number) for number in numbers]
    digest = sha256(fetched.archive.vectors[places].tobytes()).digest()
    least: int = 2**_SEED_BITS
    return least + int.from_bytes(digest[:8]) % (least - 1_000)


def _place(fetched: FetchedArchive, number: int) -> int:
    places = np.flatnonzero(fetched.archive.numbers == number)
    return int(places[0])


def _drive(
    fetched: FetchedArchive, number: int, side: str, unsafe: int, of: int, seed: int
) -> tuple[Drive, bool]:
    """Return a drive, and whether the episode of its solution is the same with the code that is installed here."""
    plan, place = fetched.plan, _place(fetched, number)
    row = fetched.archive.vectors[place]
    same = True
    if fetched.digests and fetched.seeds is not None and (known := fetched.digests[place]):
        same = episode_digest(plan, row, int(fetched.seeds[place])) == known[:DIGITS]
    space = plan.problem.space
    values = {
        f"{component}.{name}": value
        for component, named in space.decode(space.split(row)).items()
        for name, value in named.items()
    }
    drive = Drive(
        expect="unsafe" if side == "unsafe" else "safe",
        unsafe=unsafe,
        of=of,
        found=f"{datetime.now(UTC):%Y-%m-%d}",
        solution=number,
        episode=episode_of(plan, row, seed) if same else "",
        values=values,
    )
    return drive, same


Follow = Callable[[str], Awaitable[object]]
"""Waits until a campaign ends."""


async def run_suite(
    api: Api, runs: Sequence[SystemRun], follow: Follow, *, label: str = "", resume: bool = True
) -> tuple[list[CaseResult], bool]:
    """Simulate a suite and return the verdicts in the order of its systems, and whether all simulations have ended.

    Args:
        api: The coordinator.
        runs: The campaigns, as `brink.server.suites.campaigns.prepare_runs` returned them.
        follow: Waits for a campaign.
        label: What is tested, which the notes of the campaigns say; empty to say what is changed.
        resume: Whether to continue, or return, an earlier run of the same version.
    """
    cases: list[CaseResult] = []
    complete = True
    for run in runs:
        cases += [_refused(run, case, reason) for case, reason in run.refused]
        if run.body is None:
            continue
        body = run.labelled(label)
        work = CampaignRun(body, pictures=False)
        found = await work.latest(api, [*OPEN, CampaignStatus.FINISHED]) if resume else None
        campaign, _ = await resume_or_submit(work, api, found)
        if found is not None:
            await _note(api, campaign, body.notes)
        if found is None or found.status is not CampaignStatus.FINISHED:
            await follow(campaign)
        progress = await api.read(Progress, f"/campaigns/{campaign}/progress")
        complete &= progress.status is CampaignStatus.FINISHED
        cases += await campaign_cases(api, campaign, run)
    return cases, complete


async def _note(api: Api, campaign: str, label: str) -> None:
    """Add a label to the notes of a campaign that simulates a version under another name."""
    before = (await api.read(CampaignView, f"/campaigns/{campaign}")).body.notes
    if label not in before.splitlines():
        notes = "\n".join(filter(None, [before, label]))
        await api.send(CampaignView, f"/campaigns/{campaign}", {"notes": notes}, method="PATCH")


async def campaign_cases(api: Api, campaign: str, run: SystemRun) -> list[CaseResult]:
    """Return the verdicts of one campaign of a suite so far, in its order."""
    judged = TypeAdapter(list[CaseResult]).validate_python(await api.get(f"/campaigns/{campaign}/suite"))
    known = {case.name: case for case in judged}
    return [
        known[case.name].model_copy(
            update={"system": run.system, "found": case.side, "words": run.words[case.name]}
        )
        for case in run.cases
    ]


def _refused(run: SystemRun, case: Case, reason: str) -> CaseResult:
    return CaseResult(
        name=case.name,
        system=run.system,
        found=case.side,
        expect=case.drive.expect,
        verdict=SuiteVerdict.CANNOT_RUN,
        passed=False,
        decision=Decision.CANNOT_RUN,
        reason=reason,
    )


def suite_results(
    name: str,
    runs: Sequence[SystemRun],
    cases: Sequence[CaseResult],
    order: Sequence[str],
    *,
    changes: Mapping[str, object],
    label: str,
    complete: bool,
) -> SuiteResults:
    """Return the results of a run.

    Args:
        name: Name of the suite.
        runs: Its campaigns.
        cases: The verdicts.
        order: Names of the drives in the order of the file.
        changes: What was changed.
        label: What was tested; empty to say what was changed.
        complete: Whether all simulations have ended.
    """
    places = {one: place for place, one in enumerate(order)}
    versions = list(dict.fromkeys(run.version for run in runs))
    return SuiteResults(
        suite=name,
        label=label or "; ".join(versions),
        at=f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ}",
        changes=dict(changes),
        complete=complete,
        cases=sorted(cases, key=lambda case: places[case.name]),
    )
