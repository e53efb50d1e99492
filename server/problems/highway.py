"""The problem `highway-perception@1`: highway-env's roads with a car whose perception of other vehicles has errors.

The behaviour is a number of errors relative to the truth; without any, the car perceives all vehicles around it as
they are. Source: ours, after `urban-errors@1`.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Final

import numpy as np

from brink.search.errors import ConfigError
from brink.search.parameters import Parameter, Value
from brink.search.settings import check_settings, setting
from brink.search.space import Categorical, Component, Dormant, Integer, Real, SearchSpace
from brink.server.errors import nearest
from brink.server.problems.base import BEHAVIOUR, Activity, SeverityScale, SimulatedSolution, Vectors
from brink.server.problems.changes import different
from brink.server.problems.perception_errors import NO_ERROR, HasTrueVariant, severity_scale
from brink.server.problems.requirements import (
    JudgedByRequirements,
    check_requirements,
    chosen_requirements,
    requirement_setting,
)
from brink.sim.adapters.highway.specification import (
    FEWEST_LANES,
    GHOST_DISTANCE_M,
    MAGNITUDES,
    MAX_DURATION_S,
    MAX_ERRORS,
    MOST_LANES,
    SHARES,
    SIMULATOR_ID,
    STRAIGHT_ROADS,
    USUAL_MPS,
    ErrorType,
    Goal,
    HighwayScenario,
    PerceptionError,
    RoadKind,
    Target,
    words_of_errors,
)
from brink.sim.catalogue import REQUIREMENTS as REQUIREMENT_PLUGINS
from brink.sim.catalogue import plugin_ids
from brink.sim.episode import EpisodeSpec, Json
from brink.sim.perception_errors import MODE
from brink.sim.urban.behaviour import steps_from_json
from brink.sim.urban.detection_errors import ERROR_STEPS

REQUIREMENTS: Final = ("no-collision@1", "front-gap@1")
"""Requirements that every episode records."""
ROADS: Final = tuple(road.value for road in RoadKind)
_ONSET_SHARE: Final = 0.75
"""Latest onset, as a share of the episode's length."""
_SCENARIO: Final = "scenario"
_FIRST: Final = f"{BEHAVIOUR}.error_1"
_NUMBERS: Final = ("onset_s", "duration_s", "severity", "distance_m")
_FIELDS: Final = ("type", "target", *_NUMBERS)


@dataclass(frozen=True, slots=True, kw_only=True)
class HighwayPerceptionParams:
    """Parameters of the problem."""

    roads: list[str] = field(
        default_factory=lambda: list(ROADS),
        metadata={"help": "Roads of the scenarios: highway, merge, roundabout, intersection."},
    )
    requirement: str | list[str] = requirement_setting(REQUIREMENTS, REQUIREMENTS)  # noqa: RUF009
    errors: int = setting(2, ge=1, le=MAX_ERRORS, help="Most errors in an episode.")
    duration_s: float = setting(20.0, ge=5.0, le=MAX_DURATION_S, unit="s", help="Length of an episode.")
    timeout_s: float = setting(60.0, gt=0.0, le=3600.0, unit="s", help="Wall-clock limit of an episode.")

    def __post_init__(self) -> None:
        check_settings(self)
        _check_choices("roads", self.roads, ROADS)
        check_requirements(self.requirement, plugin_ids(REQUIREMENT_PLUGINS))

    @property
    def requirements(self) -> tuple[str, ...]:
        """Ids of the requirements that give the verdict."""
        return chosen_requirements(self.requirement, REQUIREMENTS)


def _check_choices(name: str, chosen: Collection[str], known: tuple[str, ...]) -> None:
    """Check that a list names at least one of the known choices, and each of them once.

    Raises:
        ConfigError: It does not.
    """
    expected = f"expected some of {', '.join(known)}, each once"
    for one in chosen:
        if one not in known:
            raise ConfigError(name, f"{expected}; got {one!r}", nearest=nearest(one, known))
    if not chosen or len(set(chosen)) < len(chosen):
        raise ConfigError(name, f"{expected}; got {list(chosen)!r}")


def scenario_component(roads: Collection[str]) -> Component:
    """Return the parameters of a scenario on some of the roads."""
    return Component(
        name=_SCENARIO,
        parameters=(
            Categorical(name="road", choices=tuple(roads)),
            Categorical(name="goal", choices=tuple(goal.value for goal in Goal)),
            Integer(name="lanes", low=FEWEST_LANES, high=MOST_LANES, unit=""),
            *(Real(name=name, low=low, high=high, unit="") for name, (low, high) in SHARES.items()),
        ),
    )


def errors_component(count: int, duration_s: float) -> Component:
    """Return the parameters of up to `count` errors in episodes of a length."""
    parameters: list[Parameter] = []
    constraints = []
    for prefix in _prefixes(count):
        parameters += [
            Categorical(name=prefix + "type", choices=(NO_ERROR, *(item.value for item in ErrorType))),
            Categorical(name=prefix + "target", choices=tuple(item.value for item in Target)),
            Real(name=prefix + "onset_s", low=0.0, high=_ONSET_SHARE * duration_s, unit="s"),
            Real(name=prefix + "duration_s", low=0.0, high=duration_s, unit="s"),
            Real(name=prefix + "severity", low=0.0, high=1.0, unit=""),
            # From 0 on, because a dormant number is 0; episodes bound it by `GHOST_DISTANCE_M`.
            Real(name=prefix + "distance_m", low=0.0, high=GHOST_DISTANCE_M[1], unit="m"),
        ]
        constraints.append(
            Dormant(
                label=prefix + "type", null_choice=NO_ERROR, members=tuple(prefix + name for name in _NUMBERS)
            )
        )
    parts = tuple(tuple(prefix + name for name in _FIELDS) for prefix in _prefixes(count))
    return Component(
        name=BEHAVIOUR,
        parameters=tuple(parameters),
        constraints=tuple(constraints),
        interchangeable=parts if count > 1 else (),
    )


def _prefixes(count: int) -> list[str]:
    return [f"error_{index}." for index in range(1, count + 1)]


class HighwayPerception(HasTrueVariant, JudgedByRequirements):
    """Driving in highway-env on a perception that reports the truth with errors."""

    id: ClassVar[str] = "highway-perception@1"
    summary: ClassVar[str] = (
        "highway-env: highway, merge, roundabout, intersection; errors of the perception."
    )
    params_type: ClassVar[type[Any]] = HighwayPerceptionParams
    terms_of_changes: ClassVar[str] = "perceived: what the driver knows of other vehicles, true or not"
    about_component: ClassVar[str] = (
        "The perception's errors are injected: results show what would happen if a perception erred like this, not "
        "that yours does."
    )
    extra: ClassVar[str] = "highway"
    modules: ClassVar[tuple[str, ...]] = ("highway_env", "gymnasium")

    def __init__(self, params: HighwayPerceptionParams) -> None:
        self.params = params
        self.space = SearchSpace(
            (scenario_component(params.roads), errors_component(params.errors, params.duration_s))
        )
        others = {f"{BEHAVIOUR}.{prefix}type": NO_ERROR for prefix in _prefixes(params.errors)[1:]}
        self.algorithm_defaults: Mapping[str, Any] = {
            "severity": f"{_FIRST}.severity",
            "fixed": {**others, f"{_FIRST}.duration_s": params.duration_s},
            "truth": {f"{_FIRST}.type": NO_ERROR},
        }
        self.requirements = params.requirements
        self.needs = SIMULATOR_ID
        self.timeout_s = params.timeout_s
        self._prefixes = _prefixes(params.errors)

    def episode(self, vectors: Vectors, seed: int) -> EpisodeSpec:
        """Return the episode of a scenario and the errors in it."""
        decoded = self.space.decode(tuple(vectors))
        errors: list[Json] = [error.to_json() for error in self._errors(decoded[BEHAVIOUR])]
        return EpisodeSpec(
            simulator=SIMULATOR_ID,
            scenario=dict(decoded[_SCENARIO]),
            behaviour={"mode": MODE, "errors": errors},
            requirements=tuple(dict.fromkeys((*REQUIREMENTS, *self.requirements))),
            seed=seed,
            duration_s=self.params.duration_s,
        )

    def _errors(self, values: Mapping[str, Value]) -> tuple[PerceptionError, ...]:
        if self.is_true:
            return ()
        found = (_error(values, prefix) for prefix in self._prefixes)
        return tuple(error for error in found if error is not None)

    def words(self, vectors: Vectors) -> str:
        """Describe a candidate."""
        decoded = self.space.decode(tuple(vectors))
        scenario = HighwayScenario.from_json(decoded[_SCENARIO])
        return f"{scenario.words}; {words_of_errors(self._errors(decoded[BEHAVIOUR]))}"

    def words_of_change(
        self, safe: SimulatedSolution, unsafe: SimulatedSolution, changed: Collection[str]
    ) -> str:
        """Describe what is different in the unsafe one of two candidates."""
        old, new = (self.space.decode(tuple(one.vectors)) for one in (safe, unsafe))
        parts = _scenario_changes(old[_SCENARIO], new[_SCENARIO], changed)
        for prefix in self._prefixes:
            whole = f"{BEHAVIOUR}.{prefix}"
            names = {name.removeprefix(whole) for name in changed if name.startswith(whole)}
            if names:
                parts.append(_change(_error(old[BEHAVIOUR], prefix), _error(new[BEHAVIOUR], prefix), names))
        return "; ".join(filter(None, parts))

    def severity_scale(self, choices: Mapping[str, str]) -> SeverityScale | None:
        """Return what severities mean, given the type of the first error."""
        kind = choices.get(f"{_FIRST}.type")
        if kind is None or kind == NO_ERROR:
            return None
        scale = MAGNITUDES[ErrorType(kind)]
        return severity_scale(scale)

    def error_words(self, choices: Mapping[str, str], magnitude: str) -> str:
        """Describe an error, such as ``the vehicle ahead is not perceived for 1.3 s``."""
        error = PerceptionError(
            type=ErrorType(choices[f"{_FIRST}.type"]),
            target=Target(choices.get(f"{_FIRST}.target", Target.ALL.value)),
            magnitude=0.0,
        )
        return error.words_with(magnitude)

    def activity(self, vectors: Vectors, features: Mapping[str, Any]) -> Activity | None:
        """Return which parameters had a part in an episode: those that the road and the types of errors have."""
        steps = steps_from_json(features.get(ERROR_STEPS))
        scenario, behaviour = self.space.components
        values = behaviour.decode(vectors[1])
        present = [prefix for prefix in self._prefixes if _error(values, prefix) is not None]
        if self.is_true or steps is None or len(steps) != len(present):
            return None
        on_road = np.ones(len(vectors[0]), dtype=np.bool_)
        if scenario.decode(vectors[0])["road"] not in STRAIGHT_ROADS:
            on_road[[parameter.name == "lanes" for parameter in scenario.parameters]] = False
        place = {parameter.name: column for column, parameter in enumerate(behaviour.parameters)}
        acted = {prefix for prefix, at in zip(present, steps, strict=True) if at is not None}
        active = np.ones(len(vectors[1]), dtype=np.bool_)
        effective = np.array(vectors[1], dtype=np.float64)
        for prefix in self._prefixes:
            columns = [place[prefix + name] for name in _FIELDS]
            if prefix not in acted:
                # The type stays active where there is no error: another type would have been one.
                active[columns if prefix in present else columns[1:]] = False
                effective[columns[0]] = 0.0
                effective[columns[2:]] = 0.0
                continue
            unused = set(_NUMBERS) - set(_used(ErrorType(str(values[prefix + "type"]))))
            active[[place[prefix + name] for name in unused]] = False
        return Activity(
            active=np.concatenate([on_road, active]),
            effective=np.concatenate([vectors[0], effective]),
            idle=() if acted else (BEHAVIOUR,),
        )


def _used(kind: ErrorType) -> tuple[str, ...]:
    """Return the numbers that an error of a type has."""
    scale = MAGNITUDES[kind]
    return (
        "severity",
        *(("onset_s",) if scale.has_window else ()),
        *(("duration_s",) if scale.has_duration else ()),
        *(("distance_m",) if kind is ErrorType.GHOST else ()),
    )


def _error(values: Mapping[str, Value], prefix: str) -> PerceptionError | None:
    """Return an error of a decoded behaviour; None if it is none."""
    if values[prefix + "type"] == NO_ERROR:
        return None
    kind = ErrorType(str(values[prefix + "type"]))
    scale = MAGNITUDES[kind]
    magnitude = scale.at(float(values[prefix + "severity"]))
    numbers = {name: float(values[prefix + name]) for name in _used(kind) if name != "severity"}
    if scale.has_window and not scale.has_duration:
        numbers["duration_s"] = magnitude
    if kind is ErrorType.GHOST:
        numbers["distance_m"] = max(numbers["distance_m"], GHOST_DISTANCE_M[0])
    return PerceptionError(
        type=kind, target=Target(str(values[prefix + "target"])), magnitude=magnitude, **numbers
    )


def _scenario_changes(
    old: Mapping[str, Value], new: Mapping[str, Value], changed: Collection[str]
) -> list[str]:
    names = {name.removeprefix(f"{_SCENARIO}.") for name in changed if name.startswith(f"{_SCENARIO}.")}
    if "road" in names:
        return [f"on a road of the kind {new['road']} instead of {old['road']}"]
    usual_mps = USUAL_MPS[RoadKind(str(new["road"]))]
    parts = []
    if "goal" in names:
        parts.append(f"the ego goes {new['goal']} instead of {old['goal']}")
    if "lanes" in names:
        parts.append(f"{new['lanes']} lanes instead of {old['lanes']}")
    for name, words in (("ego_speed", "the ego starts at"), ("target_speed", "the ego aims at")):
        if name in names:
            speeds = (usual_mps * float(old[name]), usual_mps * float(new[name]))
            parts.append(f"{words} {_instead(*speeds, 'm/s')}")
    for name, words in (("density", "traffic density"), ("traffic_speed", "traffic speed")):
        if name in names:
            parts.append(
                f"{words} {_instead(100 * float(old[name]), 100 * float(new[name]), '%')} of the usual"
            )
    return parts


def _change(old: PerceptionError | None, new: PerceptionError | None, changed: Collection[str]) -> str:
    """Describe how an error differs, such as ``the vehicle ahead is not perceived for 1.5 s instead of 1.3 s``."""
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
    if scale.has_window and old.onset_s != new.onset_s:
        parts.append(f"from {_instead(old.onset_s, new.onset_s, 's')}")
    if scale.has_duration and old.duration_s != new.duration_s:
        parts.append(f"for {_instead(old.duration_s, new.duration_s, 's')}")
    if new.type is ErrorType.GHOST and old.distance_m != new.distance_m:
        parts.append(f"{_instead(old.distance_m, new.distance_m, 'm')} ahead")
    if not parts and old.magnitude == new.magnitude:
        return ""
    return ", ".join([new.words_with(much), *parts])


def _instead(old: float, new: float, unit: str) -> str:
    before, after = different(old, new)
    suffix = unit if unit == "%" else f" {unit}"
    return f"{after}{suffix} instead of {before}{suffix}"
