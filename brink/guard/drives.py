"""Recorded drives: what a guard would observe in the episodes of campaigns or in random ones, and when they fail.

Features are not stored with the results of campaigns. Episodes are deterministic, so they are run again here, in
parallel processes (docs/adr/0055).
"""

import json
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Self, TypeAlias

import numpy as np
from numpy.typing import NDArray

from brink.guard.choices import DEFAULT_PROBLEM
from brink.guard.features import ALL_FEATURES, FEATURES_ID
from brink.packed import read_arrays
from brink.search.analysis.guard_training import DriveSeries
from brink.search.archive import Archive
from brink.search.space import FloatArray, IntArray
from brink.search.streams import Stream, episode_seed, generator
from brink.server.campaigns.body import PluginChoice
from brink.server.errors import Conflict, InvalidInput
from brink.server.problems.base import SimulatedProblem
from brink.server.problems.requirements import formulas_in
from brink.sim.catalogue import with_sources
from brink.sim.driving.interface import PERCEPTION_STEP_S
from brink.sim.episode import EpisodeSpec, Json, Verdict
from brink.user_file import read_file
from brink.worker.pool import process_pool, single_threaded

OnProgress: TypeAlias = Callable[[int, int], None]
"""Called with the number of completed drives and their total."""
HalfArray: TypeAlias = NDArray[np.float16]

SIMULATORS: Final = ("brink-drive@3", "brink-drive-errors@2")
"""Ids of the simulators whose drives can be recorded."""
MOST_DIFFERENT: Final = 0.02
"""Share of the drives of a campaign that may end differently: on another class of processor, a few do."""
LARGEST_BYTES: Final = 2 * 1024**3
"""Maximum size of a file of drives, packed and unpacked."""
_STORED: Final = 3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Drive:
    """One recorded drive.

    Attributes:
        digest: Digest of its episode's specification.
        scenario: Its scenario, as canonical JSON.
        behaviour: Its behaviour, as canonical JSON.
        seed: Its episode seed.
        features: Features at the perception steps, in the order of `ALL_FEATURES`, shape ``(steps, features)``.
        begins_s: Time of the first features.
        violated_at_s: Time of the first violation of each requirement that was evaluated; None if it held.
        robustness: Robustness of each of these requirements.
        ended_at_s: When the drive ended.
    """

    digest: str
    scenario: str
    behaviour: str
    seed: int
    features: HalfArray
    begins_s: float
    violated_at_s: Mapping[str, float | None]
    robustness: Mapping[str, float]
    ended_at_s: float

    def first_violation_s(self, requirements: Sequence[str]) -> float | None:
        """Return when the first of some requirements was violated; None if all held.

        Raises:
            Conflict: A requirement was not evaluated.
        """
        for name in requirements:
            if name not in self.violated_at_s:
                known = ", ".join(self.violated_at_s)
                raise Conflict(f"{name} was not evaluated in these drives, only {known}")
        times = [self.violated_at_s[name] for name in requirements]
        return min((one for one in times if one is not None), default=None)

    @property
    def times_s(self) -> FloatArray:
        """Times of the features, shape ``(steps,)``."""
        return self.begins_s + PERCEPTION_STEP_S * np.arange(len(self.features), dtype=np.float64)

    def series(self, requirements: Sequence[str], features: int) -> DriveSeries:
        """Return the training series of the drive, until its first violation.

        Args:
            requirements: Ids of the requirements.
            features: Number of features, from the first.
        """
        at_s = self.first_violation_s(requirements)
        times_s = self.times_s
        kept = np.ones(times_s.size, np.bool_) if at_s is None else times_s < at_s
        return DriveSeries(
            features=self.features[kept, :features],
            until_s=(np.inf if at_s is None else at_s) - times_s[kept],
            scenario=self.scenario,
            behaviour=self.behaviour if reports_anything(self.behaviour) else None,
        )


def check_problem(problem: object) -> SimulatedProblem:
    """Return a problem whose drives a guard can watch.

    Raises:
        InvalidInput: It is another one.
    """
    if isinstance(problem, SimulatedProblem) and problem.needs in SIMULATORS:
        return problem
    raise InvalidInput.at(
        "/problem/id",
        "a guard watches urban drives with an obstacle detector: expected urban-injected@1 or urban-errors@1, "
        f"got {getattr(problem, 'id', problem)}",
    )


def problem_of(about: Mapping[str, Any]) -> PluginChoice:
    """Return the id and parameters of the problem whose drives a guard was fitted to.

    Args:
        about: Provenance of the guard.
    """
    stored = about.get("problem")
    if not isinstance(stored, Mapping):
        return PluginChoice(id=DEFAULT_PROBLEM)
    try:
        return PluginChoice.model_validate(stored)
    except ValueError:
        return PluginChoice(id=DEFAULT_PROBLEM)


def with_requirements(choice: PluginChoice, requirements: Sequence[str]) -> PluginChoice:
    """Return a problem of urban drives whose verdict is given by some requirements, if any are named."""
    if not requirements:
        return choice
    formulas = formulas_in(choice.params.get("requirement", []))
    stated = [{name: formulas[name]} if name in formulas else name for name in requirements]
    return PluginChoice(id=choice.id, params={**choice.params, "requirement": stated})


def check_requirements(problem: SimulatedProblem, requirements: Sequence[str]) -> None:
    """Check that the drives of a problem are judged by some requirements.

    Raises:
        Conflict: They are not.
    """
    (spec,) = random_specs(problem, 1, 0)
    for name in requirements:
        if name not in spec.requirements:
            raise Conflict(f"{name} was not evaluated in these drives, only {', '.join(spec.requirements)}")


def random_specs(problem: SimulatedProblem, count: int, seed: int) -> list[EpisodeSpec]:
    """Return the episodes of random drives: independent draws from a problem's space, each with its own seed."""
    space = problem.space
    return [
        with_sources(
            problem.episode(space.sample(generator(seed, Stream.START, number)), episode_seed(seed, number))
        )
        for number in range(count)
    ]


def solution_specs(
    problem: SimulatedProblem, archive: Archive, seeds: IntArray, digests: Sequence[str], whose: str
) -> list[EpisodeSpec]:
    """Return the episodes of the evaluated solutions of a campaign: exactly those that were simulated.

    A solution may share the episode seed of another one, as both sides of a pair do, so seeds are those that were
    stored.

    Args:
        problem: The campaign's problem.
        archive: Its solutions.
        seeds: Episode seed of each solution, shape ``(n,)``.
        digests: Digest of each episode that was simulated.
        whose: Whose solutions they are, for the error.

    Raises:
        Conflict: An episode differs from the one that was simulated.
    """
    specs = [
        with_sources(problem.episode(problem.space.split(row), seed))
        for row, seed in zip(archive.vectors, seeds.tolist(), strict=True)
    ]
    numbers = archive.numbers.tolist()
    other = [
        number
        for number, spec, digest in zip(numbers, specs, digests, strict=True)
        if spec.digest() != digest
    ]
    if other:
        raise Conflict(
            f"{len(other):,} of {len(specs):,} episodes of {whose} differ from those that were simulated "
            f"({_named('solution', other)}): another version of Brink describes them differently"
        )
    return specs


def _named(what: str, numbers: Sequence[int], most: int = 5) -> str:
    """Return a list of names, such as "solutions 3, 8 and 12 others"."""
    if len(numbers) == 1:
        return f"{what} {numbers[0]}"
    shown = ", ".join(str(one) for one in numbers[:most])
    rest = len(numbers) - most
    return f"{what}s {shown}" + (f" and {rest:,} others" if rest > 0 else "")


def check_verdicts(
    drives: Sequence[Drive], requirements: Sequence[str], archive: Archive, whose: str
) -> None:
    """Check that the drives of a campaign ended as in the campaign.

    Args:
        drives: The recorded drives, one for each solution.
        requirements: Ids of the requirements that decide.
        archive: The campaign's solutions, with their verdicts.
        whose: Whose drives they are, for the error.

    Raises:
        Conflict: More than a few ended differently.
    """
    again = np.array([one.first_violation_s(requirements) is not None for one in drives], np.bool_)
    differ = archive.numbers[again != archive.unsafe].tolist()
    if len(differ) > MOST_DIFFERENT * len(drives):
        raise Conflict(
            f"{len(differ):,} of {len(drives):,} drives of {whose} end differently when re-run "
            f"({_named('solution', differ)}), although their episodes are the same: they were simulated by another "
            "version of Brink"
        )


def record(
    specs: Sequence[EpisodeSpec], *, processes: int = 1, on_progress: OnProgress | None = None
) -> list[Drive]:
    """Run episodes and return the recorded drives, in order; an episode that is given twice runs once.

    Args:
        specs: The episodes.
        processes: Number of processes; 1 runs them in this process.
        on_progress: Progress callback.

    Raises:
        InvalidEpisode: An episode cannot be recorded.
        SimulationCrashed: The physics engine failed.
    """
    if processes <= 1:
        return _recorded(specs, None, on_progress)
    with Recorders(processes) as recorders:
        return recorders.record(specs, on_progress=on_progress)


class Recorders:
    """Processes that record drives, for several calls. Use it as a context manager.

    Args:
        processes: Number of processes.
    """

    def __init__(self, processes: int) -> None:
        self._processes = processes
        self._pool: ProcessPoolExecutor | None = None

    def __enter__(self) -> Self:
        """Return this object; processes start with the first episode."""
        return self

    def __exit__(self, *_: object) -> None:
        """Stop the processes."""
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)
            self._pool = None

    def record(self, specs: Sequence[EpisodeSpec], *, on_progress: OnProgress | None = None) -> list[Drive]:
        """Run episodes and return the recorded drives, in order; see `record`."""
        if self._processes > 1 and self._pool is None:
            with single_threaded():
                self._pool = process_pool(self._processes)
        with single_threaded():  # a pool starts its processes when they are first needed
            return _recorded(specs, self._pool, on_progress)


def _recorded(
    specs: Sequence[EpisodeSpec], pool: ProcessPoolExecutor | None, on_progress: OnProgress | None
) -> list[Drive]:
    texts = [spec.canonical_json() for spec in specs]
    places: dict[str, EpisodeSpec] = dict(zip(texts, specs, strict=True))
    unique = list(places.values())
    found: Iterator[Drive] = (
        map(record_one, unique) if pool is None else pool.map(record_one, unique, chunksize=4)
    )
    known: dict[str, Drive] = {}
    for done, (text, drive) in enumerate(zip(places, found, strict=True), start=1):
        known[text] = drive
        if on_progress is not None:
            on_progress(done, len(unique))
    return [known[text] for text in texts]


def record_one(spec: EpisodeSpec) -> Drive:
    """Run one episode in this process and return the recorded drive."""
    from brink.guard.recorder import record_drive  # loads the physics engine

    recorded = record_drive(spec)
    return Drive(
        digest=spec.digest(),
        scenario=scenario_of(spec),
        behaviour=behaviour_of(spec),
        seed=spec.seed,
        features=recorded.features,
        begins_s=recorded.begins_s,
        violated_at_s={name: _time(verdict) for name, verdict in recorded.verdicts.items()},
        robustness={name: verdict.robustness for name, verdict in recorded.verdicts.items()},
        ended_at_s=recorded.ended_at_s,
    )


def reports_anything(behaviour: str) -> bool:
    """Return whether a behaviour, as canonical JSON, has any trajectory or error."""
    return any(isinstance(value, list) and value for value in json.loads(behaviour).values())


def scenario_of(spec: EpisodeSpec) -> str:
    """Return the scenario of an episode as canonical JSON."""
    return _canonical(spec.scenario)


def behaviour_of(spec: EpisodeSpec) -> str:
    """Return the behaviour of an episode as canonical JSON."""
    return _canonical(spec.behaviour)


def _canonical(document: Mapping[str, Json]) -> str:
    return json.dumps(dict(document), sort_keys=True, separators=(",", ":"))


def _time(verdict: Verdict) -> float | None:
    return verdict.violated_at_s if verdict.violated else None


def save_drives(file: Path, drives: Sequence[Drive]) -> None:
    """Write drives to a compressed npz file that holds numbers and text alone."""
    requirements = list(drives[0].violated_at_s) if drives else []
    header = {
        "version": _STORED,
        "features": FEATURES_ID,
        "requirements": requirements,
        "digests": [one.digest for one in drives],
        "scenarios": [one.scenario for one in drives],
        "behaviours": [one.behaviour for one in drives],
        "seeds": [one.seed for one in drives],
    }
    times = [
        [np.nan if (t := one.violated_at_s[name]) is None else t for name in requirements] for one in drives
    ]
    temporary = file.with_suffix(".part.npz")
    np.savez_compressed(
        temporary,
        allow_pickle=False,
        header=np.frombuffer(json.dumps(header).encode(), np.uint8),
        features=np.concatenate([one.features for one in drives])
        if drives
        else np.zeros((0, len(ALL_FEATURES)), np.float16),
        steps=np.array([len(one.features) for one in drives], np.int64),
        violated_at_s=np.array(times, np.float64).reshape(len(drives), -1),
        robustness=np.array([[one.robustness[name] for name in requirements] for one in drives], np.float64),
        begins_s=np.array([one.begins_s for one in drives], np.float64),
        ended_at_s=np.array([one.ended_at_s for one in drives], np.float64),
    )
    temporary.replace(file)


def load_drives(file: Path) -> list[Drive] | None:
    """Return the drives in a file; None if it is missing, damaged, or of another version."""
    try:
        arrays = read_arrays(read_file(file, LARGEST_BYTES), LARGEST_BYTES)
        header = json.loads(arrays["header"].tobytes())
        if header["version"] != _STORED or header["features"] != FEATURES_ID:
            return None
        ends = np.cumsum(arrays["steps"]).tolist()
        return [
            Drive(
                digest=digest,
                scenario=scenario,
                behaviour=behaviour,
                seed=int(seed),
                features=arrays["features"][first:end],
                begins_s=float(begins_s),
                violated_at_s={
                    name: None if np.isnan(at) else float(at)
                    for name, at in zip(header["requirements"], times, strict=True)
                },
                robustness=dict(zip(header["requirements"], robustness.tolist(), strict=True)),
                ended_at_s=float(ended),
            )
            for digest, scenario, behaviour, seed, first, end, begins_s, times, robustness, ended in zip(
                header["digests"],
                header["scenarios"],
                header["behaviours"],
                header["seeds"],
                [0, *ends[:-1]],
                ends,
                arrays["begins_s"],
                arrays["violated_at_s"],
                arrays["robustness"],
                arrays["ended_at_s"],
                strict=True,
            )
        ]
    except (OSError, ValueError, KeyError, TypeError, EOFError, RuntimeError, zipfile.BadZipFile, zlib.error):
        return None
