"""The problem `urban-errors@1`: an urban scenario with an obstacle detector that is wrong in a few ways.

The scenario is that of `urban-injected@1`. The behaviour is a number of errors relative to the truth;
without any, the detector reports the truth. Source: ours; see docs/explanation/tolerance.md.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Final

from brink.search.settings import setting
from brink.search.space import Categorical, Component, Real, SearchSpace
from brink.server.problems.base import BEHAVIOUR, MeasuredSeverity, Vectors
from brink.server.problems.changes import instead
from brink.server.problems.driving_systems import Driven, about_driving
from brink.server.problems.error_slots import (
    NO_ERROR,
    SCENARIO,
    PerceptionErrors,
    Slot,
    Values,
    prefixes,
    slots_component,
)
from brink.server.problems.requirements import Stated, formulas_in, requirement_setting
from brink.server.problems.resolutions import RESOLUTION_S, severity_resolution
from brink.server.problems.urban_changes import scenario_changes
from brink.server.problems.urban_injected import (
    REQUIREMENTS,
    URBAN_MEASURES,
    UrbanParams,
    scenario_component,
    scenario_of,
)
from brink.sim.episode import EpisodeSpec, Json
from brink.sim.perception_errors import MODE
from brink.sim.urban.detection_errors import (
    BOX_TYPES,
    MAGNITUDES,
    MAX_ERRORS,
    ON_OBJECTS,
    WINDOW_FIELDS,
    DetectionError,
    ErrorType,
    Onset,
    Target,
    activity_of_error,
)
from brink.sim.urban.error_meter import MEASURED
from brink.sim.world.scenario import words_of_scenario

SIMULATOR = "brink-drive-errors@2"
LATEST_ONSET_S: Final = 12.0
BOXES: Final = "boxes"
_ABOUT_OBJECTS: Final = (
    " Errors act on the list of objects. A driving system that gets boxes, and a guard, got the boxes of these "
    "objects."
)
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


@dataclass(frozen=True, slots=True, kw_only=True)
class UrbanErrorsParams(UrbanParams):
    """Parameters of the problem."""

    requirement: Stated = requirement_setting(["front-gap@1", "no-collision@1"], REQUIREMENTS)  # noqa: RUF009
    errors: int = setting(2, ge=1, le=MAX_ERRORS, help="Maximum number of errors in an episode.")
    errors_on: str = setting(
        BOXES, choices=(BOXES, ON_OBJECTS), help="What is wrong: boxes in the image, or a list of objects."
    )


def errors_component(
    count: int,
    duration_s: float,
    types: Iterable[ErrorType] = BOX_TYPES,
    *,
    targets: Sequence[Target] = tuple(Target),
    onsets: Sequence[Onset] = tuple(Onset),
) -> Component:
    """Return the component of up to `count` errors of some types in episodes of a length."""
    kinds = tuple(types)
    return slots_component(
        [
            (
                Categorical(name=prefix + "type", choices=(NO_ERROR, *(kind.value for kind in kinds))),
                Categorical(name=prefix + "target", choices=tuple(item.value for item in targets)),
                Categorical(name=prefix + "onset", choices=tuple(item.value for item in onsets)),
                Real(
                    name=prefix + "onset_s",
                    low=0.0,
                    high=min(LATEST_ONSET_S, duration_s),
                    unit="s",
                    resolution=RESOLUTION_S,
                ),
                Real(name=prefix + "duration_s", low=0.0, high=duration_s, unit="s", resolution=RESOLUTION_S),
                Real(
                    name=prefix + "severity",
                    low=0.0,
                    high=1.0,
                    unit="",
                    resolution=severity_resolution(
                        prefix + "type", {kind: MAGNITUDES[kind] for kind in kinds}
                    ),
                ),
            )
            for prefix in prefixes("error", count)
        ]
    )


class UrbanErrors(Driven, PerceptionErrors[DetectionError]):
    """Urban driving with an obstacle detector that reports the truth with errors."""

    id: ClassVar[str] = "urban-errors@1"
    summary: ClassVar[str] = "Urban driving with errors of the obstacle detector relative to the truth."
    params_type: ClassVar[type[Any]] = UrbanErrorsParams
    errors_problem = "urban-errors@1"
    recorded: ClassVar[tuple[str, ...]] = REQUIREMENTS
    measures = URBAN_MEASURES
    magnitudes = MAGNITUDES
    onset_fields = WINDOW_FIELDS
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
    about_component = (
        "The detector's errors are injected: results show what would happen if a detector erred like this, not that "
        "yours does. Whether it does is checked with that detector, on urban-camera@1: see “Set a requirement for a "
        "detector” in Brink's documentation."
    )

    def __init__(self, params: UrbanErrorsParams) -> None:
        self.params = params
        types = ErrorType if params.errors_on == ON_OBJECTS else BOX_TYPES
        self.space = SearchSpace(
            (scenario_component(), errors_component(params.errors, params.duration_s, types))
        )
        whole = {"onset": Onset.TIME.value, "duration_s": params.duration_s}
        pedestrian = f"{self.first('target')}={Target.PEDESTRIAN.value}"
        self.algorithm_defaults = self.study_of_severity(whole) | {
            "grossest": {self.first("type"): ErrorType.SHORT_RANGE.value},
            "covers": {self.first("type"): [kind.value for kind in COVERED]},
            "needs": {pedestrian: {"scenario.pedestrians": ["18"]}},
        }
        self.requirements = params.requirements
        self.formulas = formulas_in(params.requirement)
        self.needs = SIMULATOR
        self.timeout_s = params.timeout_s
        about = _ABOUT_OBJECTS if params.errors_on == ON_OBJECTS else about_driving(params.driving)
        self.about_component = (type(self).about_component + about).strip()

    def episode(self, vectors: Vectors, seed: int) -> EpisodeSpec:
        """Return the episode of a scenario and the errors in it."""
        decoded = self.space.decode(tuple(vectors))
        on: dict[str, Json] = {} if self.params.errors_on == BOXES else {"on": self.params.errors_on}
        errors: list[Json] = [error.to_json() for error in self.errors(decoded[BEHAVIOUR])]
        return EpisodeSpec(
            simulator=SIMULATOR,
            scenario=scenario_of(decoded[SCENARIO]),
            behaviour={"mode": MODE, **on, "errors": errors},
            requirements=self.evaluated,
            formulas=self.formulas,
            seed=seed,
            duration_s=self.params.duration_s,
            options=self.params.options,
        )

    def error(self, behaviour: Values, slot: Slot) -> DetectionError:
        """Return the error of a decoded behaviour in a slot that has one."""
        values = {name.removeprefix(slot.prefix): behaviour[name] for name in slot.names}
        kind, target = ErrorType(str(values["type"])), Target(str(values["target"]))
        scale = MAGNITUDES[kind]
        magnitude = scale.at(float(values["severity"]))
        if not scale.has_window:
            return DetectionError(type=kind, target=target, magnitude=magnitude)
        return DetectionError(
            type=kind,
            target=target,
            magnitude=magnitude,
            onset=Onset(str(values["onset"])),
            onset_s=float(values["onset_s"]),
            duration_s=float(values["duration_s"]) if scale.has_duration else magnitude,
        )

    def words(self, vectors: Vectors) -> str:
        """Describe a candidate."""
        decoded = self.space.decode(tuple(vectors))
        errors = self.words_of_errors(decoded[BEHAVIOUR]) or "no error"
        return f"{words_of_scenario(scenario_of(decoded[SCENARIO]))}; {errors}"

    def scenario_changes(self, old: Values, new: Values, changed: Collection[str]) -> list[str]:
        """Describe the differences of the unsafe scenario from the safe one, one part for each parameter."""
        return scenario_changes(old, new, changed)

    def onset_change(self, old: DetectionError, new: DetectionError) -> str:
        """Describe how the onset of an error differs."""
        if old.onset is new.onset is Onset.TIME:
            return super().onset_change(old, new)
        if old.onset is new.onset:
            seconds = instead(old.onset_s, new.onset_s, "s")
            return new.onset_words.replace(f"{new.onset_s:.1f} s", seconds)
        return f"{new.onset_words} instead of {old.onset_words}"

    def error_words(self, choices: Mapping[str, str], magnitude: str) -> str:
        """Describe an error as an activity, such as ``not reporting the lead for 1.3 s``."""
        kind, target = ErrorType(choices[self.first("type")]), choices.get(self.first("target"))
        return activity_of_error(kind, None if target is None else Target(target), magnitude)

    def measures_errors(self, choices: Mapping[str, str]) -> bool:
        """Return whether errors of a type are measured."""
        if self.params.errors_on != BOXES:
            return False
        return self.first("target") in choices and ErrorType(choices[self.first("type")]) in MEASURED

    def measured_severity(
        self,
        choices: Mapping[str, str],
        measures: Mapping[str, Mapping[str, float]],
        at_least: Mapping[str, Collection[str]],
    ) -> MeasuredSeverity | None:
        """Return the severity of an error in a drive; None if the drive does not show it."""
        if not self.measures_errors(choices):
            return None
        kind, target = ErrorType(choices[self.first("type")]), choices[self.first("target")]
        magnitude = measures.get(target, {}).get(kind.value)
        if magnitude is None:
            return None
        severity = MAGNITUDES[kind].severity(magnitude)
        is_bound = kind.value in at_least.get(target, ())
        return None if is_bound and severity == 0.0 else MeasuredSeverity(severity, is_bound)
