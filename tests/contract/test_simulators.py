"""Simulators pass the contract suite, and the suite rejects broken simulators."""

import hashlib
import inspect
import itertools
import json
import math
import os
import random
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from brink.server.problems.base import SimulatedProblem
from brink.server.problems.catalogue import make_problem
from brink.sim.adapters.function import FUNCTION, FunctionSimulator, simulator_of, write_function
from brink.sim.catalogue import SIMULATORS, Simulator, load_plugin, make_simulator
from brink.sim.episode import EpisodeResult, EpisodeSpec, Json, Verdict
from brink.sim.errors import InvalidEpisode, SimulationCrashed
from brink.sim.perturbations import CATALOGUE
from brink.sim.testing import ContractBroken, check_simulator

PROBLEMS: dict[str, dict[str, object]] = {
    "urban-injected@1": {"duration_s": 6.0},
    "urban-errors@1": {"duration_s": 6.0},
    "urban-fitted@1": {"duration_s": 6.0},
    "commonroad@1": {"duration_s": 3.0},
    "highway-perception@1": {"duration_s": 5.0, "roads": ["highway", "roundabout"]},
    "gymnasium@1": {"perturbations": 2, "reset": {"high": [0.0, 0.1]}},
}


def episodes(problem: SimulatedProblem, count: int) -> list[EpisodeSpec]:
    """Return episodes of random candidates."""
    rng = np.random.default_rng(5)
    return [problem.episode(problem.space.sample(rng), seed) for seed in range(count)]


@pytest.mark.parametrize("problem_id", PROBLEMS)
def test_passes_the_contract_suite(problem_id: str) -> None:
    problem = make_problem(problem_id, PROBLEMS[problem_id])
    assert isinstance(problem, SimulatedProblem)
    specs = episodes(problem, 3)
    check_simulator(
        cast(Callable[[], Simulator], load_plugin(SIMULATORS, problem.needs)),
        specs,
        invalid=[
            replace(specs[0], scenario={**specs[0].scenario, "no_such_field": 1}),
            replace(specs[0], behaviour={"no_such_field": 1}),
            replace(specs[0], requirements=("no-such-requirement@1",)),
            replace(specs[0], duration_s=1e9),
        ],
    )


def digest(document: Any) -> str:
    """Return a digest of everything that an episode results in but its provenance."""
    spec = EpisodeSpec.from_json(document)
    result = make_simulator(spec.simulator).run(spec, record=True)
    verdicts = {name: [one.robustness, one.violated_at_s] for name, one in result.verdicts.items()}
    text = json.dumps([verdicts, dict(result.objectives), dict(result.features)], sort_keys=True)
    return hashlib.sha256(text.encode() + (result.trace or b"")).hexdigest()


ELSEWHERE = f"""
import hashlib, json, sys
from typing import Any
from brink.sim.catalogue import make_simulator
from brink.sim.episode import EpisodeSpec
{inspect.getsource(digest)}
print(json.dumps([digest(document) for document in json.load(sys.stdin)]))
"""


BRIEF: dict[str, dict[str, object]] = {
    **PROBLEMS,
    "urban-camera@1": {"duration_s": 5.0},
    "aeb-crossing@1": {},
    "npc-actions@1": {"duration_s": 5.0},
    "sumo-drivers@1": {"duration_s": 10.0},
}
"""Parameters of problems with short episodes, one problem for each simulator."""


def brief(problem_id: str) -> EpisodeSpec:
    """Return a short episode of a problem; images are perturbed with every gene."""
    problem = make_problem(problem_id, BRIEF[problem_id])
    assert isinstance(problem, SimulatedProblem)
    (spec,) = episodes(problem, 1)
    if problem_id != "aeb-crossing@1":
        return spec
    genes: list[Json] = [{"gene": name, "level": 1} for name in CATALOGUE]
    return replace(spec, duration_s=0.15, behaviour={**spec.behaviour, "perturbations": genes})


def longer() -> list[EpisodeSpec]:
    """Return drives whose cars brake, one on wheels, and an encounter that is seen with a camera."""
    brake = brief("aeb-crossing@1")
    camera = make_problem("npc-actions@1", {"duration_s": 5.0, "sight": "detector"})
    assert isinstance(camera, SimulatedProblem)
    urban = brief("urban-injected@1")
    return [
        replace(brake, duration_s=8.0, behaviour={"mode": "oracle"}),
        replace(urban, options={**urban.options, "fidelity": "wheels"}),
        *episodes(camera, 1),
    ]


@pytest.mark.parametrize(
    "problems",
    [
        (*PROBLEMS, "urban-camera@1", "aeb-crossing@1", "npc-actions@1"),
        pytest.param(("sumo-drivers@1",), marks=pytest.mark.long("needs SUMO")),
    ],
)
def test_another_process_gives_the_same_bytes(problems: tuple[str, ...]) -> None:
    specs = [brief(problem) for problem in problems]
    if "aeb-crossing@1" in problems:
        specs += longer()
    documents = [spec.to_json() for spec in specs]
    there = subprocess.run(
        [sys.executable, "-c", ELSEWHERE],
        input=json.dumps(documents),
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "PYTHONHASHSEED": "77"},
    )
    found = json.loads(there.stdout.splitlines()[-1])
    # In the opposite order, so that no episode follows the same ones as there.
    assert found[::-1] == [digest(document) for document in reversed(documents)]


def test_functions_pass_the_contract_suite(tmp_path: Path) -> None:
    def margin(x: float, road: str, seed: int) -> dict[str, float]:
        gap_m = x - 0.5 + np.random.default_rng(seed).normal(0.0, 0.1) - (road == "wet")
        return {"robustness": gap_m, "gap_m": gap_m}

    file, digest = write_function(margin, tmp_path)
    specs = [
        EpisodeSpec(
            simulator=simulator_of(digest),
            scenario={"all": {"x": seed / 4, "road": "wet"}},
            behaviour={},
            requirements=(FUNCTION,),
            seed=seed,
            duration_s=60.0,
        )
        for seed in range(4)
    ]
    check_simulator(
        lambda: FunctionSimulator(file),
        specs,
        invalid=[
            replace(specs[0], scenario={"all": {"x": 1.0, "no_such_argument": 1}}),
            replace(specs[0], requirements=("no-such-requirement@1",)),
        ],
    )


def test_a_bool_is_no_robustness(tmp_path: Path) -> None:
    file, digest = write_function(lambda x: x > 0.5, tmp_path)
    spec = EpisodeSpec(
        simulator=simulator_of(digest),
        scenario={"all": {"x": 1.0}},
        behaviour={},
        requirements=(FUNCTION,),
        seed=0,
        duration_s=1.0,
    )
    with pytest.raises(InvalidEpisode, match="expected a finite number, negative if"):
        FunctionSimulator(file).run(spec)


class Sound:
    """A simulator that keeps the contract."""

    def __init__(self) -> None:
        self.runs = 0

    def run(self, spec: EpisodeSpec, *, record: bool = False) -> EpisodeResult:
        if spec.simulator != "sound@1":
            raise InvalidEpisode(f"simulator: expected sound@1, got {spec.simulator!r}")
        self.runs += 1
        robustness = self.robustness(spec)
        return EpisodeResult(
            verdicts={name: self.verdict(robustness) for name in spec.requirements},
            objectives={"robustness": robustness},
            features={},
            provenance={},
            trace=self.trace() if record else None,
        )

    def robustness(self, spec: EpisodeSpec) -> float:
        return float(np.random.default_rng(spec.seed).normal())

    def verdict(self, robustness: float) -> Verdict:
        return Verdict(robustness=robustness, unit="m", violated_at_s=1.0 if robustness < 0 else None)

    def trace(self) -> bytes | None:
        return None


class StateLeaks(Sound):
    def robustness(self, spec: EpisodeSpec) -> float:
        return super().robustness(spec) + (1e-9 if self.runs > 4 else 0.0)


class GlobalRandomness(Sound):
    def robustness(self, spec: EpisodeSpec) -> float:
        return random.random()


class NotFinite(Sound):
    def robustness(self, spec: EpisodeSpec) -> float:
        return math.inf


class NoMoment(Sound):
    def verdict(self, robustness: float) -> Verdict:
        return Verdict(robustness=-1.0, unit="m", violated_at_s=None)

    def trace(self) -> bytes:
        return b"a simulator that records time knows when"


class ComputesAtOnce(Sound):
    def verdict(self, robustness: float) -> Verdict:
        return Verdict(robustness=robustness, unit="m", violated_at_s=None)


class FalseMoment(Sound):
    def verdict(self, robustness: float) -> Verdict:
        return Verdict(robustness=1.0, unit="m", violated_at_s=1.0)


class BadTrace(Sound):
    def trace(self) -> bytes:
        return b"no trace"


class ChangingTrace(Sound):
    numbers: Iterator[int] = itertools.count()

    def trace(self) -> bytes:
        return str(next(self.numbers)).encode()


class RunsAnything(Sound):
    def run(self, spec: EpisodeSpec, *, record: bool = False) -> EpisodeResult:
        return super().run(replace(spec, simulator="sound@1"), record=record)


class CrashesOnInvalid(Sound):
    def run(self, spec: EpisodeSpec, *, record: bool = False) -> EpisodeResult:
        if spec.simulator != "sound@1":
            raise SimulationCrashed("what is that?")
        return super().run(spec, record=record)


class ForgetsARequirement(Sound):
    def run(self, spec: EpisodeSpec, *, record: bool = False) -> EpisodeResult:
        return replace(super().run(spec, record=record), verdicts={})


SPECS = [
    EpisodeSpec(
        simulator="sound@1", scenario={}, behaviour={}, requirements=("gap@1",), seed=seed, duration_s=1.0
    )
    for seed in range(3)
]


@pytest.mark.parametrize("sound", [Sound, ComputesAtOnce])
def test_a_sound_simulator_passes(sound: Callable[[], Simulator]) -> None:
    check_simulator(sound, SPECS)


@pytest.mark.parametrize(
    ("broken", "clause"),
    [
        (StateLeaks, "equal results of equal specifications"),
        (GlobalRandomness, "equal results of equal specifications"),
        (NotFinite, "a finite robustness"),
        (NoMoment, "violated if and only if it says when"),
        (FalseMoment, "no time of a violation without one"),
        (BadTrace, "a trace that can be read"),
        (ChangingTrace, "trace"),
        (RunsAnything, "InvalidEpisode for"),
        (CrashesOnInvalid, "InvalidEpisode for"),
        (ForgetsARequirement, "a verdict for each of gap@1"),
    ],
)
def test_a_broken_simulator_is_rejected(broken: Callable[[], Simulator], clause: str) -> None:
    with pytest.raises(ContractBroken, match=clause):
        check_simulator(broken, SPECS)


def test_a_specification_that_runs_is_not_invalid() -> None:
    with pytest.raises(ContractBroken, match="InvalidEpisode for"):
        check_simulator(Sound, SPECS, invalid=SPECS[:1])


@pytest.mark.parametrize("specs", [SPECS[:1], [SPECS[0], SPECS[0]]])
def test_the_suite_needs_episodes_that_differ(specs: list[EpisodeSpec]) -> None:
    with pytest.raises(ValueError, match="at least two different episodes"):
        check_simulator(Sound, specs)
