"""The problem `urban-errors@1`: an urban scenario with an obstacle detector that is wrong in a few ways.

The scenario is that of `urban-injected@1`. The behaviour is a number of errors relative to the truth;
without any, the detector reports the truth. Source: ours; see docs/explanation/tolerance.md.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Final

import numpy as np

from brink.search.parameters import Parameter, Value
from brink.search.settings import setting
from brink.search.space import Categorical, Component, Dormant, Real, SearchSpace
from brink.server.problems.base import (
    BEHAVIOUR,
    Activity,
    MeasuredSeverity,
    SeverityScale,
    SimulatedSolution,
    Vectors,
)
from brink.server.problems.changes import different
from brink.server.problems.perception_errors import NO_ERROR, HasTrueVariant, severity_scale
from brink.server.problems.requirements import JudgedByRequirements, requirement_setting
from brink.server.problems.urban_changes import scenario_changes
from brink.server.problems.urban_injected import REQUIREMENTS, UrbanParams, scenario_component, scenario_of
from brink.sim.episode import EpisodeSpec, Json
from brink.sim.perception_errors import MODE
from brink.sim.urban.behaviour import steps_from_json
from brink.sim.urban.detection_errors import (
    ERROR_STEPS,
    MAGNITUDES,
    MAX_ERRORS,
    DetectionError,
    ErrorType,
    Onset,
    Target,
    activity_of_error,
)
from brink.sim.urban.error_meter import MEASURED
from brink.sim.world.scenario import words_of_scenario

SIMULATOR = "brink-drive-errors@1"
LATEST_ONSET_S: Final = 12.0
COVERED: Final = (
    ErrorType.MISS,
    ErrorType.LATE,
    ErrorType.FLICKER,
    ErrorType.TOO_FAR,
    ErrorType.LEFT,
    ErrorType.RIGHT,
    ErrorType.TOO_SMALL,
    ErrorType.SHORT_RANGE,
)
"""Errors that are milder than never reporting the target: they hide it, or put it where it is in nobody's way."""
_FIRST: Final = f"{BEHAVIOUR}.error_1"
_FIELDS: Final = ("type", "target", "onset", "onset_s", "duration_s", "severity")


@dataclass(frozen=True, slots=True, kw_only=True)
class UrbanErrorsParams(UrbanParams):
    """Parameters of the problem."""

    requirement: str | list[str] = requirement_setting(["front-gap@1", "no-collision@1"], REQUIREMENTS)  # noqa: RUF009
    errors: int = setting(2, ge=1, le=MAX_ERRORS, help="Most errors in an episode.")


def errors_component(count: int, duration_s: float) -> Component:
    """Return the component of up to `count` errors of the detector in episodes of a length."""
    parameters: list[Parameter] = []
    constraints = []
    for index in range(1, count + 1):
        prefix = f"error_{index}."
        parameters += [
            Categorical(name=prefix + "type", choices=(NO_ERROR, *(item.value for item in ErrorType))),
            Categorical(name=prefix + "target", choices=tuple(item.value for item in Target)),
            Categorical(name=prefix + "onset", choices=tuple(item.value for item in Onset)),
            Real(name=prefix + "onset_s", low=0.0, high=min(LATEST_ONSET_S, duration_s), unit="s"),
            Real(name=prefix + "duration_s", low=0.0, high=duration_s, unit="s"),
            Real(name=prefix + "severity", low=0.0, high=1.0, unit=""),
        ]
        constraints.append(
            Dormant(
                label=prefix + "type",
                null_choice=NO_ERROR,
                members=(prefix + "onset_s", prefix + "duration_s", prefix + "severity"),
            )
        )
    return Component(
        name=BEHAVIOUR,
        parameters=tuple(parameters),
        constraints=tuple(constraints),
        interchangeable=()
        if count == 1
        else tuple(tuple(f"error_{index}.{name}" for name in _FIELDS) for index in range(1, count + 1)),
    )


class UrbanErrors(HasTrueVariant, JudgedByRequirements):
    """Urban driving with an obstacle detector that reports the truth with errors."""

    id: ClassVar[str] = "urban-errors@1"
    summary: ClassVar[str] = "Urban driving with errors of the obstacle detector relative to the truth."
    params_type: ClassVar[type[Any]] = UrbanErrorsParams
    errors_problem: ClassVar[str] = "urban-errors@1"
    usual_cells: ClassVar[Mapping[str, list[str]]] = {
        "type": [
            kind.value
            for kind in (
                ErrorType.MISS,
                ErrorType.LATE,
                ErrorType.FLICKER,
                ErrorType.TOO_FAR,
                ErrorType.LEFT,
                ErrorType.SHORT_RANGE,
            )
        ],
        "target": [Target.LEAD.value, Target.PEDESTRIAN.value],
    }

    about_component: ClassVar[str] = (
        "The detector's errors are injected: results show what would happen if a detector erred like this, not that "
        "yours does. Whether it does is checked with that detector, on urban-camera@1: see “Set a requirement for a "
        "detector” in Brink's documentation."
    )

    def __init__(self, params: UrbanErrorsParams) -> None:
        self.params = params
        self.space = SearchSpace((scenario_component(), errors_component(params.errors, params.duration_s)))
        others = {f"{BEHAVIOUR}.error_{index}.type": NO_ERROR for index in range(2, params.errors + 1)}
        self.algorithm_defaults: Mapping[str, Any] = {
            "severity": f"{_FIRST}.severity",
            "fixed": {
                **others,
                f"{_FIRST}.onset": Onset.TIME.value,
                f"{_FIRST}.duration_s": params.duration_s,
            },
            "truth": {f"{_FIRST}.type": NO_ERROR},
            "grossest": {f"{_FIRST}.type": ErrorType.SHORT_RANGE.value},
            "covers": {f"{_FIRST}.type": [kind.value for kind in COVERED]},
            "needs": {f"{_FIRST}.target={Target.PEDESTRIAN.value}": {"scenario.pedestrians": ["18"]}},
        }
        self.requirements = params.requirements
        self.needs = SIMULATOR
        self.timeout_s = params.timeout_s

    def episode(self, vectors: Vectors, seed: int) -> EpisodeSpec:
        """Return the episode of a scenario and the errors in it."""
        decoded = self.space.decode(tuple(vectors))
        errors: list[Json] = (
            [] if self.is_true else [error.to_json() for error in self._errors(decoded[BEHAVIOUR])]
        )
        return EpisodeSpec(
            simulator=SIMULATOR,
            scenario=scenario_of(decoded["scenario"]),
            behaviour={"mode": MODE, "errors": list(errors)},
            requirements=tuple(dict.fromkeys((*REQUIREMENTS, *self.requirements))),
            seed=seed,
            duration_s=self.params.duration_s,
            options={"fidelity": self.params.fidelity},
        )

    def _errors(self, values: Mapping[str, Value]) -> list[DetectionError]:
        found = (self._error(values, index) for index in range(1, self.params.errors + 1))
        return [error for error in found if error is not None]

    def _error(self, values: Mapping[str, Value], index: int) -> DetectionError | None:
        """Return an error of a decoded behaviour; None if it is none."""
        prefix = f"error_{index}."
        if values[prefix + "type"] == NO_ERROR:
            return None
        kind = ErrorType(str(values[prefix + "type"]))
        scale = MAGNITUDES[kind]
        magnitude = scale.at(float(values[prefix + "severity"]))
        if not scale.has_window:
            return DetectionError(
                type=kind, target=Target(str(values[prefix + "target"])), magnitude=magnitude
            )
        return DetectionError(
            type=kind,
            target=Target(str(values[prefix + "target"])),
            magnitude=magnitude,
            onset=Onset(str(values[prefix + "onset"])),
            onset_s=float(values[prefix + "onset_s"]),
            duration_s=float(values[prefix + "duration_s"]) if scale.has_duration else magnitude,
        )

    def words(self, vectors: Vectors) -> str:
        """Describe a candidate."""
        decoded = self.space.decode(tuple(vectors))
        errors = [] if self.is_true else self._errors(decoded[BEHAVIOUR])
        words = " and ".join(error.words for error in errors) or "no error"
        return f"{words_of_scenario(scenario_of(decoded['scenario']))}; {words}"

    def words_of_change(
        self, safe: SimulatedSolution, unsafe: SimulatedSolution, changed: Collection[str]
    ) -> str:
        """Describe what is different in the unsafe one of two candidates."""
        old, new = (self.space.decode(tuple(one.vectors)) for one in (safe, unsafe))
        parts = scenario_changes(old["scenario"], new["scenario"], changed)
        for index in range(1, self.params.errors + 1):
            prefix = f"{BEHAVIOUR}.error_{index}."
            names = {name.removeprefix(prefix) for name in changed if name.startswith(prefix)}
            if names:
                before, after = self._error(old[BEHAVIOUR], index), self._error(new[BEHAVIOUR], index)
                parts.append(_change(before, after, names))
        return "; ".join(filter(None, parts))

    def severity_scale(self, choices: Mapping[str, str]) -> SeverityScale | None:
        """Return what severities mean, given the type of the first error."""
        kind = choices.get(f"{_FIRST}.type")
        if kind is None or kind == NO_ERROR:
            return None
        scale = MAGNITUDES[ErrorType(kind)]
        return severity_scale(scale)

    def error_words(self, choices: Mapping[str, str], magnitude: str) -> str:
        """Describe an error as an activity, such as ``not reporting the lead for 1.3 s``."""
        kind, target = ErrorType(choices[f"{_FIRST}.type"]), choices.get(f"{_FIRST}.target")
        return activity_of_error(kind, None if target is None else Target(target), magnitude)

    def measures_errors(self, choices: Mapping[str, str]) -> bool:
        """Return whether errors of a type are measured."""
        return f"{_FIRST}.target" in choices and ErrorType(choices[f"{_FIRST}.type"]) in MEASURED

    def measured_severity(
        self,
        choices: Mapping[str, str],
        measures: Mapping[str, Mapping[str, float]],
        at_least: Mapping[str, Collection[str]],
    ) -> MeasuredSeverity | None:
        """Return how severe an error was in a drive; None if the drive does not tell."""
        if not self.measures_errors(choices):
            return None
        kind, target = ErrorType(choices[f"{_FIRST}.type"]), choices[f"{_FIRST}.target"]
        magnitude = measures.get(target, {}).get(kind.value)
        if magnitude is None:
            return None
        severity = MAGNITUDES[kind].severity(magnitude)
        is_bound = kind.value in at_least.get(target, ())
        return None if is_bound and severity == 0.0 else MeasuredSeverity(severity, is_bound)

    def activity(self, vectors: Vectors, features: Mapping[str, Any]) -> Activity | None:
        """Return which parameters had a part in an episode: those that the type of an error has, if it ever acted."""
        steps = steps_from_json(features.get(ERROR_STEPS))
        behaviour = self.space.components[1]
        values = behaviour.decode(vectors[1])
        present = [i for i in range(1, self.params.errors + 1) if self._error(values, i) is not None]
        if self.is_true or steps is None or len(steps) != len(present):
            return None
        place = {parameter.name: column for column, parameter in enumerate(behaviour.parameters)}
        acted = {index for index, at in zip(present, steps, strict=True) if at is not None}
        active = np.ones(len(vectors[1]), dtype=np.bool_)
        effective = np.array(vectors[1], dtype=np.float64)
        for index in range(1, self.params.errors + 1):
            prefix = f"error_{index}."
            columns = [place[prefix + name] for name in _FIELDS]
            if index not in acted:
                # The type stays active where there is no error: another type would have been one.
                active[columns if index in present else columns[1:]] = False
                effective[columns[0]] = 0.0
                effective[columns[3:]] = 0.0
                continue
            scale = MAGNITUDES[ErrorType(str(values[prefix + "type"]))]
            if not scale.has_window:
                active[[place[prefix + "onset"], place[prefix + "onset_s"]]] = False
            if not scale.has_duration:
                active[place[prefix + "duration_s"]] = False
        return Activity(
            active=np.concatenate([np.ones(len(vectors[0]), dtype=np.bool_), active]),
            effective=np.concatenate([vectors[0], effective]),
            idle=() if acted else (BEHAVIOUR,),
        )


def _change(old: DetectionError | None, new: DetectionError | None, changed: Collection[str]) -> str:
    """Describe how an error differs, such as ``the lead is not reported for 1.5 s instead of 1.3 s``."""
    if new is None:
        return f"without the error that {old.words}" if old is not None else ""
    if old is None:
        return new.words
    scale = MAGNITUDES[new.type]
    if old.type is not new.type or old.target is not new.target:
        return f"{new.words} (in the safe drive, {old.words})"
    much, parts = scale.words(new.magnitude), []
    if "severity" in changed and old.magnitude != new.magnitude:
        much = _instead(scale.number(old.magnitude), scale.number(new.magnitude), scale.shown_unit)
    if scale.has_window and (old.onset is not new.onset or old.onset_s != new.onset_s):
        same_event = old.onset is new.onset
        parts.append(
            f"from {_instead(old.onset_s, new.onset_s, 's')}"
            if same_event and new.onset is Onset.TIME
            else f"{new.onset_words} instead of {old.onset_words}"
        )
    if scale.has_duration and "duration_s" in changed and old.duration_s != new.duration_s:
        parts.append(f"for {_instead(old.duration_s, new.duration_s, 's')}")
    if not parts and old.magnitude == new.magnitude:
        return ""
    return ", ".join([new.words_with(much), *parts])


def _instead(old: float, new: float, unit: str) -> str:
    before, after = different(old, new)
    suffix = unit if unit == "%" else f" {unit}"
    return f"{after}{suffix} instead of {before}{suffix}"
