"""The campaigns that simulate a suite: one for each system, with the changes of a run.

Drives that cannot be simulated any more are kept with the reason: a parameter out of range, another space, a missing
plug-in, a simulator that is newer than the one here.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Final

from pydantic import ValidationError

from brink.search.algorithms.suite import Suite as SuiteAlgorithm
from brink.search.errors import SearchError
from brink.search.space import FloatArray, SearchSpace
from brink.search.streams import episode_seed
from brink.search.wald import MOST
from brink.server.campaigns.body import Budget, CampaignBody, Execution, PluginChoice, changes_with_files
from brink.server.campaigns.known import encoded_row
from brink.server.campaigns.plan import Plan, make_plan
from brink.server.documents import hash_document, placed_in_file
from brink.server.errors import FieldError, InvalidInput, ServerError
from brink.server.problems.base import Problem, SimulatedProblem
from brink.server.problems.catalogue import check_extra, problem_type
from brink.server.suites.file import Drive, Entry, SuiteFile, System
from brink.server.user_code import USER_CODE
from brink.sim.catalogue import with_sources
from brink.sim.errors import SimulatorError

ALGORITHM: Final = PluginChoice(id=SuiteAlgorithm.id)
"""The algorithm of every campaign of a suite, without its drives."""
SEED: Final = 0
"""Seed of every campaign of a suite: the episode seeds of a drive follow from its entry."""
DIGITS: Final = 16
"""Hexadecimal digits of the digest of an episode."""
CLASHES: Final = (ServerError, SimulatorError, SearchError, ValidationError)
"""Why a system cannot be made."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """A drive of a suite: what a run has a verdict on.

    Attributes:
        name: Its name, unique in the suite.
        place: Place of its entry in the file.
        entry: The entry.
        side: Which drive of the entry: ``unsafe`` or ``safe``, as it was found.
        drive: The drive.
    """

    name: str
    place: int
    entry: Entry
    side: str
    drive: Drive


def cases_of(file: SuiteFile) -> list[Case]:
    """Return all drives of a suite, in the order of the file."""
    return [
        Case(name=entry.case(side), place=place, entry=entry, side=side, drive=drive)
        for place, entry in enumerate(file.entries)
        for side, drive in entry.drives()
    ]


@dataclass(frozen=True, slots=True, kw_only=True)
class SystemRun:
    """The simulation of the drives of one system.

    Attributes:
        system: Name of the system.
        body: The campaign; None if none of its drives can be simulated.
        cases: The drives that it simulates, in its order.
        refused: Each other drive, and why it cannot be simulated.
        version: What is tested, in a few words.
        unaffected: Changes that the problem has no parameter for.
        words: The drives in words, by name.
    """

    system: str
    body: CampaignBody | None
    cases: tuple[Case, ...]
    refused: tuple[tuple[Case, str], ...]
    version: str
    unaffected: tuple[str, ...] = ()
    words: Mapping[str, str] = field(default_factory=dict)

    def labelled(self, label: str) -> CampaignBody:
        """Return the campaign with notes that say what is tested.

        Args:
            label: What is tested; empty to say what is changed.

        Raises:
            ValueError: There is no campaign.
        """
        if self.body is None:
            raise ValueError(f"none of the drives of {self.system} can be simulated")
        return self.body.model_copy(update={"notes": label or self.version})


def changed_params(params: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return the parameters of a problem with changes; another driving system keeps no settings of the old one.

    Args:
        params: The parameters.
        changes: New values by name.
    """
    changed = {**params, **changes}
    if "driving" in changes and "driving_settings" in params:
        changed["driving_settings"] = changes.get("driving_settings", {})
    return changed


def check_changes(file: SuiteFile, changes: Mapping[str, Any], option: str = "--set") -> None:
    """Check that each change is of a parameter that a problem of the suite has.

    Raises:
        InvalidInput: One is not.
    """
    known = {name for system in file.systems.values() for name in _parameters(system)}
    for name in changes:
        if known and name not in known:
            raise InvalidInput.at(
                option,
                f"expected a parameter of {' or '.join(sorted({s.problem for s in file.systems.values()}))}, such as "
                f"{', '.join(sorted(known)[:6])}; got {name!r}",
            )


def _parameters(system: System) -> set[str]:
    """Return the names of the parameters of a system's problem; none if its plug-in is missing."""
    try:
        return set(problem_type(system.problem).params_type.__dataclass_fields__)
    except CLASHES:
        return set()


def prepare_runs(
    file: SuiteFile,
    changes: Mapping[str, Any],
    *,
    name: str,
    path: Path | None = None,
    here: bool = True,
    option: str = "--set",
) -> list[SystemRun]:
    """Return the campaigns that simulate a suite, in the order of its systems.

    Args:
        file: The suite.
        changes: New values of parameters, for every problem that has them.
        name: Name of the suite.
        path: Its file, for the lines of wrong values.
        here: Whether this machine simulates it, and so needs the extras.
        option: What gave the changes, for errors.

    Raises:
        InvalidInput: No problem has a parameter that is to be changed, or a program cannot run.
    """
    check_changes(file, changes, option)
    changes = changes_with_files(changes, option)
    cases = cases_of(file)
    runs = []
    for system_name, system in file.systems.items():
        own = [case for case in cases if case.entry.system == system_name]
        if own:
            runs.append(_prepare(system_name, system, own, changes, name, path, here=here))
    return runs


def _prepare(
    name: str,
    system: System,
    cases: list[Case],
    changes: Mapping[str, Any],
    suite: str,
    path: Path | None,
    *,
    here: bool,
) -> SystemRun:
    applied = {key: value for key, value in changes.items() if key in _parameters(system)}
    version = ", ".join(f"{key}={value}" for key, value in applied.items()) or "current version"
    prepared = partial(
        SystemRun,
        system=name,
        version=version,
        unaffected=tuple(key for key in changes if key not in applied),
    )
    try:
        body = system_body(f"suite {suite}: {name}", system, applied)
        plan = make_plan(body)
        problem = plan.problem
        if here:
            check_extra(problem)
            problem.install()
        if wrong := USER_CODE.call(problem.id, "its inputs", problem.wrong_inputs):
            raise InvalidInput(FieldError(pointer=key, message=message) for key, message in wrong)
        _check_not_newer(system, problem)
    except CLASHES as error:
        return prepared(body=None, cases=(), refused=tuple((case, str(error)) for case in cases))
    rows: dict[str, FloatArray] = {}
    refused: list[tuple[Case, str]] = []
    for case in cases:
        try:
            rows[case.name] = row_of(problem.space, case, path)
        except InvalidInput as error:
            refused.append((case, str(error)))
    kept = tuple(case for case in cases if case.name in rows)
    if not kept:
        return prepared(body=None, cases=(), refused=tuple(refused))
    episodes = [episode_of(plan, rows[case.name], case.entry.seed) for case in kept]
    same = [digest == case.drive.episode for digest, case in zip(episodes, kept, strict=True)]
    most = 1 if problem.ignores_seeds else MOST
    params = {
        "solutions": [rows[case.name].tolist() for case in kept],
        "seeds": [case.entry.seed for case in kept],
        "names": [case.name for case in kept],
        "expect": [case.drive.expect for case in kept],
        "reproduce": [case.side if unchanged else "" for case, unchanged in zip(kept, same, strict=True)],
        "episodes": episodes,
        "most": most,
    }
    complete = body.model_copy(
        update={
            "algorithm": ALGORITHM.model_copy(update={"params": params}),
            "budget": Budget(simulations=most * len(kept)),
        }
    )
    return prepared(
        body=complete,
        cases=kept,
        refused=tuple(refused),
        words={case.name: problem.words(problem.space.split(rows[case.name])) for case in kept},
    )


def system_body(name: str, system: System, changes: Mapping[str, Any]) -> CampaignBody:
    """Return a campaign on a system, without the drives to simulate.

    Args:
        name: Name of the campaign; a longer one is cut.
        system: The system.
        changes: New values of parameters.
    """
    return CampaignBody(
        name=name[:200],
        problem=PluginChoice(id=system.problem, params=changed_params(system.params, changes)),
        algorithm=ALGORITHM,
        budget=Budget(simulations=1),
        seed=SEED,
        ground_truth=system.ground_truth,
        execution=Execution(keep_traces=0, max_failed_share=1.0),  # failures are counted by drive
    )


def row_of(space: SearchSpace, case: Case, path: Path | None = None) -> FloatArray:
    """Return the values of a drive as a row of the space.

    Args:
        space: The space.
        case: The drive.
        path: The file that it is from, for the lines of wrong values.

    Raises:
        InvalidInput: The space has other parameters, or a value is out of range.
    """
    errors: list[FieldError] = []
    pointer = f"/entries/{case.place}/{case.side}/values"
    row = encoded_row(space, case.drive.values, pointer, errors)
    if row is None:
        raise InvalidInput(errors if path is None else placed_in_file(errors, path))
    return row


def episode_of(plan: Plan, row: FloatArray, seed: int) -> str:
    """Return the digest of the first episode of a drive: with an equal one, a simulation gives an equal result.

    Args:
        plan: A plan of the problem.
        row: The drive, shape ``(d,)``.
        seed: The seed of its entry.
    """
    return episode_digest(plan, row, episode_seed(SEED, seed))


def episode_digest(plan: Plan, row: FloatArray, seed: int) -> str:
    """Return the digest of the episode of a drive under an episode seed.

    Args:
        plan: A plan of the problem.
        row: The drive, shape ``(d,)``.
        seed: The episode seed.
    """
    problem, vectors = plan.problem, plan.problem.space.split(row)
    if isinstance(problem, SimulatedProblem):
        return with_sources(problem.episode(vectors, seed)).digest()[:DIGITS]
    about = [plan.body.problem.model_dump(mode="json"), plan.body.sources, row.tolist(), seed]
    return hash_document(about)[:DIGITS]


def simulator_of(problem: Problem) -> str:
    """Return the id of the simulator that a problem needs; empty if nothing is simulated."""
    return problem.needs if isinstance(problem, SimulatedProblem) else ""


def _check_not_newer(system: System, problem: Problem) -> None:
    """Check that the drives were not found with a later version of the simulator than this Brink has.

    Raises:
        InvalidInput: They were.
    """
    found, here = system.simulator.rpartition("@"), simulator_of(problem).rpartition("@")
    if found[0] == here[0] and found[2].isdecimal() and here[2].isdecimal() and int(found[2]) > int(here[2]):
        raise InvalidInput.at(
            "simulator",
            f"found with {system.simulator}, and this Brink has {simulator_of(problem)}: update it",
        )


def system_of(plan: Plan) -> System:
    """Return what a campaign tests."""
    body = plan.body
    return System(
        problem=body.problem.id,
        params=dict(body.problem.params),
        ground_truth=body.ground_truth,
        simulator=simulator_of(plan.problem),
        requirements=list(plan.problem.requirements),
        sources={name: digest for name, digest in body.sources.items() if not name.startswith("algorithms/")},
    )


def system_name(system: System, taken: Mapping[str, System]) -> str:
    """Return the name of a system among others: that of an equal one, or a new one from the name of its problem."""
    for name, one in taken.items():
        if one == system:
            return name
    stem = system.problem.rpartition("@")[0]
    names: Iterable[str] = (stem, *(f"{stem}-{count}" for count in range(2, len(taken) + 3)))
    return next(name for name in names if name not in taken)
