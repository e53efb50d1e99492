"""Suites on drives that a search found: what a run says beside many plain repeats, of other planners, and its cost.

The suite has the ends of the thresholds, and the pairs, that searches found with Brink's own driving system and
errors of the detector. They are simulated again unchanged, with half the required gap, with another vehicle model,
and with the driving systems in `examples/driving`. For the first two, plain repeats with other episode seeds are the
truth. A second suite compares the service with a bare loop over the same episodes.
"""

import asyncio
import os
import shutil
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

import numpy as np

import brink
from benchmarks.driving import EXAMPLES, build_cpp
from benchmarks.errors import is_unsafe
from benchmarks.measurement import Progress, Row, at_least, at_most, untargeted
from benchmarks.processes import BRINK
from benchmarks.trials import mapped
from brink.api.suites import Chosen, NewEntries, find_entries
from brink.python.client import settings_of
from brink.python.connection import Connection
from brink.search.analysis.suite import SuiteVerdict
from brink.search.sequential import exact_interval
from brink.search.space import FloatArray
from brink.search.streams import episode_seed
from brink.search.wald import Decision
from brink.server.api.schemas import Progress as CampaignProgress
from brink.server.campaigns.plan import make_plan
from brink.server.problems.base import SimulatedProblem
from brink.server.suites.campaigns import SEED, prepare_runs
from brink.server.suites.file import write_suite
from brink.server.suites.results import CaseResult
from brink.sim.catalogue import PLUGINS_VARIABLE
from brink.sim.episode import EpisodeSpec

UNCHANGED: Final = "nothing changed"
HALVED: Final = "required gap halved"
VERSIONS: Final[Mapping[str, Mapping[str, Any]]] = {
    UNCHANGED: {},
    HALVED: {"requirement": {"stl": "always (front_gap_m > 0.75)", "unit": "m"}},
    "fidelity wheels": {"fidelity": "wheels"},
    "IDM": {"driving": "idm:Idm"},
    "IDM in C++": {"driving": "command:{folder}/cpp/idm.yaml"},
    "FISS+": {"driving": "fiss:FissPlus"},
}
BESIDE_REPEATS: Final = (UNCHANGED, HALVED)
TRUTH_SEED: Final = 7
RARELY: Final = 0.2
"""Share of the repeats that may contradict that a drive is safe, or unsafe."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SuiteBench:
    """The measurement.

    Attributes:
        folder: Keeps the database and the suites.
        campaigns: Searches, with seeds from 1.
        simulations: Budget of each.
        drives: Drives of the suite that are repeated.
        repeats: Plain repeats of each.
        service: Drives of the suite that is compared with a bare loop; 0 to leave that out.
        processes: Workers, and processes of the bare loop.
        progress: Progress callback.
    """

    folder: Path
    campaigns: int
    simulations: int
    drives: int
    repeats: int
    service: int
    processes: int
    progress: Progress

    def measure(self) -> list[Row]:
        """Return the figures; nothing that an earlier measurement in the folder simulated is simulated again.

        Raises:
            OSError: There is no cmake.
            subprocess.CalledProcessError: There is no compiler, or the searches found nothing.
        """
        path = [str(EXAMPLES), *filter(None, [os.environ.get("PYTHONPATH")])]
        plugins = "idm,fiss" if find_spec("fiss_planner") else "idm"
        os.environ |= {PLUGINS_VARIABLE: plugins, "PYTHONPATH": os.pathsep.join(path)}
        sys.path.insert(0, str(EXAMPLES))
        self.folder.mkdir(parents=True, exist_ok=True)
        if not (self.folder / "cpp").exists():
            build_cpp(Path(shutil.copytree(EXAMPLES / "cpp", self.folder / "cpp")))
        found = [
            brink.run(
                _campaign(seed, self.simulations),
                database=self._database,
                workers=self.processes,
                progress=False,
            )
            for seed in range(1, self.campaigns + 1)
        ]
        return list(self._rows([campaign.id for campaign in found]))

    def _rows(self, campaigns: Sequence[str]) -> Iterator[Row]:
        suite = self._found(campaigns)
        cases = {version: self._run(suite, version) for version in VERSIONS}
        own = cases[UNCHANGED]
        for version, again in cases.items():
            yield _simulations(version, again)
            if version in BESIDE_REPEATS:
                yield from self._beside_repeats(suite, version, again)
            if version != UNCHANGED:
                yield from hazard_rows(version, own, again)
        if self.service:
            yield self._beside_a_loop(self._solutions(campaigns[0]))

    @property
    def _database(self) -> str:
        return f"sqlite:///{(self.folder / 'brink.db').resolve()}"

    def _changes(self, version: str) -> dict[str, Any]:
        folder = self.folder.resolve()
        return {
            name: value.format(folder=folder) if isinstance(value, str) else value
            for name, value in VERSIONS[version].items()
        }

    def _run(self, suite: brink.Suite, version: str) -> list[CaseResult]:
        return suite.run(
            self._changes(version),
            label=version,
            workers=self.processes,
            database=self._database,
            progress=False,
        ).cases

    def _found(self, campaigns: Sequence[str]) -> brink.Suite:
        """Return the suite of the ends of all thresholds and of all pairs."""
        file = self.folder / "suite.yaml"
        chosen = [
            "--thresholds",
            "--pairs",
            "all",
            "--force",
            "--database",
            self._database,
            "--out",
            str(file),
        ]
        command = [*BRINK, "suite", "create", *campaigns, *chosen]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        return brink.Suite(file)

    def _solutions(self, campaign: str) -> brink.Suite:
        """Return a suite of the first drives of a campaign."""

        async def find() -> NewEntries:
            async with Connection.local(settings_of(self._database)).open() as api:
                return await find_entries(api, campaign, Chosen(solutions=range(self.service)))

        found, file = asyncio.run(find()), self.folder / "service.yaml"
        write_suite(file, {"own": found.system}, found.named("own", "", []))
        return brink.Suite(file)

    def _beside_repeats(self, suite: brink.Suite, version: str, cases: Sequence[CaseResult]) -> Iterator[Row]:
        """Yield the figures of some drives, spread over the suite."""
        some = np.unique(np.linspace(0, len(cases) - 1, min(self.drives, len(cases))).astype(int)).tolist()
        seeds: list[list[int]] = [[] for _ in cases]
        for place in some:
            seeds[place] = [
                episode_seed(TRUTH_SEED, place * self.repeats + nth) for nth in range(self.repeats)
            ]
        specs, requirements = self._episodes(suite, version, seeds)
        unsafe = self._looped(specs, requirements, f"repeats, {version}")
        shares = np.reshape(unsafe, (len(some), self.repeats)).mean(axis=1)
        yield from _beside_repeats(version, [cases[place] for place in some], shares)

    def _looped(self, specs: Sequence[EpisodeSpec], requirements: Sequence[str], part: str) -> list[bool]:
        tasks = [(spec, requirements) for spec in specs]
        return mapped(is_unsafe, tasks, processes=self.processes, part=part, progress=self.progress)

    def _beside_a_loop(self, suite: brink.Suite) -> Row:
        cases = self._run(suite, UNCHANGED)

        async def elapsed_s() -> float:
            async with Connection.local(settings_of(self._database)).open() as api:
                path = f"/campaigns/{cases[0].campaign}/progress"
                return (await api.read(CampaignProgress, path)).elapsed_s

        service_s = asyncio.run(elapsed_s())
        seeds = [
            [episode_seed(SEED, entry.seed + nth) for nth in range(case.evaluated + case.failed)]
            for case, entry in zip(cases, suite.file.entries, strict=True)
        ]
        specs, requirements = self._episodes(suite, UNCHANGED, seeds)
        start = time.perf_counter()
        unsafe = self._looped(specs, requirements, "bare loop")
        loop_s = time.perf_counter() - start
        if sum(unsafe) != sum(case.unsafe for case in cases):
            raise AssertionError("the bare loop and the service simulate the same episodes")
        note = f"{len(specs)} simulations in {service_s:.0f} s, in a bare loop in {loop_s:.0f} s"
        return at_least(
            f"speed of a suite of {len(cases)} drives, per cent", 100 * loop_s / service_s, 93, note
        )

    def _episodes(
        self, suite: brink.Suite, version: str, seeds: Sequence[Sequence[int]]
    ) -> tuple[list[EpisodeSpec], Sequence[str]]:
        """Return the episodes of every drive with some seeds, and the requirements that give the verdict."""
        (run,) = prepare_runs(suite.file, self._changes(version), name=suite.path.stem)
        if run.body is None or run.refused:
            raise AssertionError("every drive of the suite can be simulated")
        problem = make_plan(run.body).problem
        assert isinstance(problem, SimulatedProblem)
        specs = [
            problem.episode(problem.space.split(np.asarray(row)), seed)
            for row, own in zip(run.body.algorithm.params["solutions"], seeds, strict=True)
            for seed in own
        ]
        return specs, problem.requirements


def _campaign(seed: int, simulations: int) -> dict[str, Any]:
    return {
        "name": f"own{seed}",
        "problem": {"id": "urban-errors@1", "params": {"requirement": "front-gap@1"}},
        "algorithm": {"id": "edge@2"},
        "budget": {"simulations": simulations},
        "execution": {"keep_traces": 0},
        "seed": seed,
    }


def _simulations(version: str, cases: Sequence[CaseResult]) -> Row:
    simulated = [case.evaluated + case.failed for case in cases]
    said = Counter(case.verdict.value for case in cases)
    note = f"{len(cases)} drives: {', '.join(f'{count} {verdict}' for verdict, count in said.most_common())}"
    return at_most(f"{version}: simulations a drive, mean", float(np.mean(simulated)), 6, note)


def hazard_rows(version: str, own: Sequence[CaseResult], again: Sequence[CaseResult]) -> Iterator[Row]:
    """Yield how many unsafe drives of the own driving system are unsafe with another version, and of its safe ones.

    Args:
        version: Its name.
        own: The verdicts with the own driving system.
        again: Those of the version, of the same drives.
    """
    pairs = list(zip(own, again, strict=True))
    for was, what in ((Decision.UNSAFE, "unsafe too"), (Decision.SAFE, "safe, now unsafe")):
        said = Counter(case.decision for before, case in pairs if before.decision is was)
        of, unsafe = said.total(), said[Decision.UNSAFE]
        low, high = exact_interval(unsafe, of)
        rest = ", ".join(
            f"{count} {one.value}" for one, count in said.most_common() if one is not Decision.UNSAFE
        )
        yield untargeted(
            f"{version}: {what}, per cent",
            100 * unsafe / max(1, of),
            f"{unsafe} of {of}, 90% interval {100 * low:.0f} to {100 * high:.0f}%; {rest or 'no other'}",
        )


def _beside_repeats(version: str, cases: Sequence[CaseResult], share: FloatArray) -> list[Row]:
    """Return how well verdicts agree with plain repeats.

    Args:
        version: Its name.
        cases: The verdicts of the suite.
        share: How often each drive is unsafe in plain repeats, shape ``(n,)``.
    """
    truth = [
        Decision.SAFE if one <= RARELY else Decision.UNSAFE if one >= 1 - RARELY else Decision.UNCLEAR
        for one in share.tolist()
    ]
    pairs = list(zip(cases, truth, strict=True))
    clear = [(case, true) for case, true in pairs if true is not Decision.UNCLEAR]
    said = [(case, true) for case, true in pairs if case.decision is not Decision.UNCLEAR]
    wrong = sum(case.decision is not true for case, true in said)
    rows = [
        at_least(
            f"{version}: clear drives with the right verdict, per cent",
            100 * sum(case.decision is true for case, true in clear) / max(1, len(clear)),
            95,
            f"{len(clear)} of {len(cases)} drives are clear in the repeats",
        ),
        at_most(
            f"{version}: safe or unsafe, but not so in the repeats, per cent",
            100 * wrong / max(1, len(said)),
            2,
            f"{wrong} of {len(said)}; opposite: "
            f"{sum(true is not Decision.UNCLEAR and case.decision is not true for case, true in said)}",
        ),
    ]
    if not VERSIONS[version]:
        never = [case.verdict is SuiteVerdict.NOT_REPRODUCED for case in cases]
        sure = (share == 0.0) & (np.array([case.found == "safe" for case in cases]))
        sure |= (share == 1.0) & (np.array([case.found == "unsafe" for case in cases]))
        rows += [
            at_most(
                "not reproduced, of those that all repeats confirm",
                float(np.sum(np.array(never)[sure])),
                0,
                f"of {int(sure.sum())}",
            ),
            untargeted(
                "not reproduced, of the others",
                float(np.sum(np.array(never)[~sure])),
                f"of {int((~sure).sum())}",
            ),
        ]
    else:
        broken = [case.verdict for case, true in pairs if true is Decision.UNSAFE and case.expect == "safe"]
        rows.append(
            untargeted(
                f"{version}: broken drives found",
                float(sum(one is SuiteVerdict.BROKEN for one in broken)),
                f"of {len(broken)}",
            )
        )
    return rows
