"""Steps an FMU through an episode, in this process, and judges its variables over time."""

import contextlib
import math
import shutil
import time
import weakref
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Self

import numpy as np

from brink.sim.adapters.command.attempt import Judged
from brink.sim.adapters.command.recording import trace_of
from brink.sim.adapters.command.requirement import Requirement, RequirementError, requirement_of
from brink.sim.adapters.command.signals import FloatArray, SignalError, Signals, evaluated, needed_columns
from brink.sim.adapters.command.simulator import SEEDS
from brink.sim.episode import EpisodeResult, EpisodeSpec, Json
from brink.sim.errors import InvalidEpisode, SimulationCrashed
from brink.sim.fmi import FmuError, FmuFailed, Instance, Model, read_model
from brink.sim.programs.working_folder import working_folder
from brink.sim.provenance import provenance, versions_with

TIME: Final = "time"
"""Name of the time in s among the signals."""
MAX_STEPS: Final = 1_000_000
MAX_NUMBERS: Final = 50_000_000
"""Maximum number of recorded values of an episode."""
_FIELDS: Final = ("variables", "start_values", "seed_variable", "step_s", "signals", "requirements")
_ROUNDING: Final = 1e-6


def step_count(stop_s: float, step_s: float) -> int:
    """Return the number of steps of an episode.

    Raises:
        FmuError: It is not a whole number from 1 to `MAX_STEPS`.
    """
    steps = round(stop_s / step_s)
    if not 1 <= steps <= MAX_STEPS or abs(steps * step_s - stop_s) > _ROUNDING * step_s:
        raise FmuError(
            f"expected a stop time that is a multiple of the step, with at most {MAX_STEPS:,} steps; got {stop_s!r} "
            f"and {step_s!r} s"
        )
    return steps


@dataclass(frozen=True, slots=True, kw_only=True)
class Stated:
    """What an episode states besides its values.

    Attributes:
        variables: The variables of those parameters that have another name.
        start_values: Values that are the same in every episode, by variable.
        seed_variable: Variable that gets the seed; empty for none.
        step_s: Communication step.
        source: Its signals.
        requirements: Its requirements, by name.
    """

    variables: Mapping[str, str]
    start_values: Mapping[str, Json]
    seed_variable: str
    step_s: float
    source: Signals
    requirements: Mapping[str, Requirement]

    @classmethod
    def of(cls, spec: EpisodeSpec) -> Self:
        """Return what an episode states.

        Raises:
            InvalidEpisode: It is malformed.
        """
        options = spec.options
        if set(options) - set(_FIELDS):
            raise InvalidEpisode(f"options: expected {', '.join(_FIELDS)}; got {', '.join(options)}")
        variables, start_values, stated = (
            options.get(name, {}) for name in ("variables", "start_values", "requirements")
        )
        step_s, seed_variable = options.get("step_s"), options.get("seed_variable", "")
        if not (isinstance(variables, dict) and isinstance(start_values, dict) and isinstance(stated, dict)):
            raise InvalidEpisode("options: expected objects as variables, start_values and requirements")
        if isinstance(step_s, bool) or not isinstance(step_s, int | float) or not 0 < step_s < math.inf:
            raise InvalidEpisode(f"options: step_s: expected seconds above 0, got {step_s!r:.80}")
        if not isinstance(seed_variable, str) or not all(isinstance(one, str) for one in variables.values()):
            raise InvalidEpisode("options: expected names as seed_variable and variables")
        try:
            return cls(
                variables={name: str(one) for name, one in variables.items()},
                start_values=start_values,
                seed_variable=seed_variable,
                step_s=float(step_s),
                source=Signals.of(options.get("signals", {})),
                requirements={name: requirement_of(stated.get(name)) for name in spec.requirements},
            )
        except (SignalError, RequirementError) as error:
            raise InvalidEpisode(f"options: {error}") from None

    def values(self, spec: EpisodeSpec, model: Model) -> dict[str, float]:
        """Return what the FMU is given before it begins, by variable.

        Raises:
            FmuError: A variable is missing, takes no value, or not this one.
        """
        given: dict[str, Any] = dict(self.start_values)
        for part in spec.scenario.values():
            for name, value in part.items() if isinstance(part, dict) else ():
                given[self.variables.get(name, name)] = value
        if self.seed_variable:
            given[self.seed_variable] = spec.seed % SEEDS
        return {name: model.settable(name).number(value) for name, value in given.items()}


class FmuSimulator:
    """Runs the episodes of one FMU.

    Args:
        path: The FMU.
        simulator_id: Its id.
        is_same: Returns whether a copy of the file still has the digest in the id.

    Raises:
        InvalidEpisode: It is no FMU that can run here, or the file has changed.
    """

    def __init__(self, path: Path, simulator_id: str, is_same: Callable[[Path], bool]) -> None:
        self.id = simulator_id
        folders = contextlib.ExitStack()
        self._finalizer = weakref.finalize(self, folders.close)
        folder, _ = folders.enter_context(working_folder())
        copy = folder / path.name
        try:
            shutil.copyfile(path, copy)
            if not is_same(copy):
                raise SimulationCrashed(f"{path.name} has changed since this worker started: start it again")
            self._model = read_model(copy)
            self._instance = Instance(self._model, folder / "unpacked")
        except (FmuError, OSError) as error:
            raise InvalidEpisode(str(error)) from None

    def run(self, spec: EpisodeSpec, *, record: bool = False) -> EpisodeResult:
        """Run one episode.

        Args:
            spec: The episode.
            record: Whether the result includes a trace, with all signals that the campaign names.

        Raises:
            InvalidEpisode: A variable is missing or takes no value, or the signals or a requirement are malformed.
            SimulationCrashed: The FMU reported an error, or a value that is no finite number.
        """
        began_s = time.process_time()
        spec.check_for(self.id, math.inf)
        stated = Stated.of(spec)
        try:
            steps = step_count(spec.duration_s, stated.step_s)
            done = self._judged(stated, stated.values(spec, self._model), steps, everything=record)
        except (FmuFailed, SignalError) as error:
            raise SimulationCrashed(str(error)) from None
        except FmuError as error:
            raise InvalidEpisode(str(error)) from None
        return EpisodeResult(
            verdicts=done.verdicts,
            objectives={f"{name}:robustness": verdict.robustness for name, verdict in done.verdicts.items()},
            features={},
            provenance=provenance(
                self.id, began_s, versions_with("fmpy"), simulated_s=float(done.time_s[-1])
            ),
            trace=trace_of(spec, done, "fmpy").to_bytes() if record else None,
        )

    def _judged(self, stated: Stated, values: Mapping[str, float], steps: int, *, everything: bool) -> Judged:
        """Step through an episode and return its signals and verdicts."""
        source, requirements = stated.source, stated.requirements
        names = dict.fromkeys(name for one in requirements.values() for name in one.signals)
        formulas = source.formulas(dict.fromkeys([*names, *(source.named if everything else ())]))
        variables = [name for name in needed_columns(formulas) if name != TIME]
        for name in variables:
            self._model.variable(name)
        if len(variables) * steps > MAX_NUMBERS:
            raise FmuError(
                f"expected at most {MAX_NUMBERS:,} values, got {len(variables)} at {steps:,} steps each"
            )
        time_s, recorded = self._recorded(variables, values, stated.step_s, steps)
        columns = {TIME: time_s, **{name: recorded[:, place] for place, name in enumerate(variables)}}
        signals = evaluated(formulas, time_s, columns, self._model.path.name)
        try:
            verdicts = {name: one.verdict(time_s, signals) for name, one in requirements.items()}
        except ValueError as error:
            raise SignalError(f"{self._model.path.name}: {error}") from None
        return Judged(
            source=source, time_s=time_s, signals=signals, requirements=requirements, verdicts=verdicts
        )

    def _recorded(
        self, variables: list[str], values: Mapping[str, float], step_s: float, steps: int
    ) -> tuple[FloatArray, FloatArray]:
        """Return times, shape ``(n,)``, and variables, shape ``(n, k)``, at each communication point."""
        instance = self._instance
        instance.start(values, steps * step_s)
        reader = instance.reader(variables)
        rows = np.zeros((steps + 1, len(variables)))
        rows[0] = reader.read()
        last = 0
        time_s: FloatArray = np.arange(steps + 1, dtype=np.float64) * step_s
        for step in range(steps):
            ended_s = instance.step(time_s[step], step_s)
            if ended_s is None or ended_s > time_s[step]:
                last = step + 1
            rows[last] = reader.read()
            if ended_s is not None:
                time_s[last] = ended_s
                break
        instance.end()
        return time_s[: last + 1], rows[: last + 1]
