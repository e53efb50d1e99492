"""The problem `highway-perception@1`: highway-env's roads and a car with errors in its perception of other vehicles.

The behaviour is a number of errors relative to the truth; without any, the car perceives all vehicles around it as
they are. Source: ours, after `urban-errors@1`.
"""

from collections.abc import Collection, Mapping, Set
from dataclasses import dataclass, field
from typing import Any, ClassVar, Final

from brink.search.algorithm import Measure
from brink.search.errors import ConfigError
from brink.search.settings import check_settings, setting
from brink.search.space import Categorical, Component, Integer, Real, SearchSpace
from brink.server.errors import nearest
from brink.server.problems.base import BEHAVIOUR, Vectors
from brink.server.problems.changes import instead
from brink.server.problems.error_slots import (
    NO_ERROR,
    SCENARIO,
    Parts,
    PerceptionErrors,
    Slot,
    Values,
    prefixes,
    slots_component,
)
from brink.server.problems.requirements import (
    Stated,
    check_requirements,
    chosen_requirements,
    formulas_in,
    requirement_setting,
)
from brink.server.problems.resolutions import (
    RESOLUTION_M,
    RESOLUTION_S,
    RESOLUTION_SHARE,
    severity_resolution,
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
    fields_of,
)
from brink.sim.catalogue import REQUIREMENTS as REQUIREMENT_PLUGINS
from brink.sim.catalogue import plugin_ids
from brink.sim.episode import EpisodeSpec, Json
from brink.sim.perception_errors import MODE

REQUIREMENTS: Final = ("no-collision@1", "front-gap@1")
"""Requirements that every episode records."""
NOT_RECORDED: Final = (
    "pedestrian_gap_m",
    "stop_line_gap_m",
    "light_red",
    "light_amber",
    "in_conflict_area",
    "brakes_for_nothing",
)
"""Signals of formulas that highway-env does not have."""
ROADS: Final = tuple(road.value for road in RoadKind)
_ONSET_SHARE: Final = 0.75
"""Latest onset, as a share of the episode's length."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HighwayPerceptionParams:
    """Parameters of the problem."""

    roads: list[str] = field(
        default_factory=lambda: list(ROADS),
        metadata={"help": "Roads of the scenarios: highway, merge, roundabout, intersection."},
    )
    requirement: Stated = requirement_setting(REQUIREMENTS, REQUIREMENTS)  # noqa: RUF009
    errors: int = setting(2, ge=1, le=MAX_ERRORS, help="Maximum number of errors in an episode.")
    duration_s: float = setting(20.0, ge=5.0, le=MAX_DURATION_S, unit="s", help="Length of an episode.")
    timeout_s: float = setting(60.0, gt=0.0, le=3600.0, unit="s", help="Wall-clock limit of an episode.")

    def __post_init__(self) -> None:
        check_settings(self)
        _check_choices("roads", self.roads, ROADS)
        check_requirements(
            self.requirement,
            plugin_ids(REQUIREMENT_PLUGINS),
            duration_s=self.duration_s,
            not_recorded=NOT_RECORDED,
        )

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
        name=SCENARIO,
        parameters=(
            Categorical(name="road", choices=tuple(roads), tells_kinds=True),
            Categorical(name="goal", choices=tuple(goal.value for goal in Goal)),
            Integer(name="lanes", low=FEWEST_LANES, high=MOST_LANES, unit="", resolution=1),
            *(
                Real(name=name, low=low, high=high, unit="", resolution=RESOLUTION_SHARE)
                for name, (low, high) in SHARES.items()
            ),
        ),
    )


def errors_component(count: int, duration_s: float) -> Component:
    """Return the parameters of up to `count` errors in episodes of a length."""
    return slots_component(
        [
            (
                Categorical(name=prefix + "type", choices=(NO_ERROR, *(item.value for item in ErrorType))),
                Categorical(name=prefix + "target", choices=tuple(item.value for item in Target)),
                Real(
                    name=prefix + "onset_s",
                    low=0.0,
                    high=_ONSET_SHARE * duration_s,
                    unit="s",
                    resolution=RESOLUTION_S,
                ),
                Real(name=prefix + "duration_s", low=0.0, high=duration_s, unit="s", resolution=RESOLUTION_S),
                Real(
                    name=prefix + "severity",
                    low=0.0,
                    high=1.0,
                    unit="",
                    resolution=severity_resolution(prefix + "type", MAGNITUDES),
                ),
                # From 0 on, because a dormant number is 0; episodes bound it by `GHOST_DISTANCE_M`.
                Real(
                    name=prefix + "distance_m",
                    low=0.0,
                    high=GHOST_DISTANCE_M[1],
                    unit="m",
                    resolution=RESOLUTION_M,
                ),
            )
            for prefix in prefixes("error", count)
        ]
    )


class HighwayPerception(PerceptionErrors[PerceptionError]):
    """Driving in highway-env with errors in the perception of other vehicles."""

    id: ClassVar[str] = "highway-perception@1"
    summary: ClassVar[str] = (
        "highway-env: highway, merge, roundabout, intersection; errors of the perception."
    )
    params_type: ClassVar[type[Any]] = HighwayPerceptionParams
    terms_of_changes = "perceived: what the driver believes about other vehicles, true or not"
    about_component = (
        "The perception's errors are injected: results show what would happen if a perception erred like this, not "
        "that yours does."
    )
    extra = "highway"
    modules = ("highway_env", "gymnasium")
    recorded = REQUIREMENTS
    measures = (
        Measure(name="way_m", low=0.0, high=600.0, unit="m"),
        Measure(name="ended_at_s", low=0.0, high=20.0, unit="s"),
    )
    magnitudes = MAGNITUDES

    def __init__(self, params: HighwayPerceptionParams) -> None:
        self.params = params
        self.space = SearchSpace(
            (scenario_component(params.roads), errors_component(params.errors, params.duration_s))
        )
        self.algorithm_defaults = self.study_of_severity({"duration_s": params.duration_s})
        self.requirements = params.requirements
        self.formulas = formulas_in(params.requirement)
        self.needs = SIMULATOR_ID
        self.timeout_s = params.timeout_s

    def episode(self, vectors: Vectors, seed: int) -> EpisodeSpec:
        """Return the episode of a scenario and the errors in it."""
        decoded = self.space.decode(tuple(vectors))
        errors: list[Json] = [error.to_json() for error in self.errors(decoded[BEHAVIOUR])]
        return EpisodeSpec(
            simulator=SIMULATOR_ID,
            scenario=dict(decoded[SCENARIO]),
            behaviour={"mode": MODE, "errors": errors},
            requirements=self.evaluated,
            formulas=self.formulas,
            seed=seed,
            duration_s=self.params.duration_s,
        )

    def error(self, behaviour: Values, slot: Slot) -> PerceptionError:
        """Return the error of a decoded behaviour in a slot that has one."""
        kind = ErrorType(str(behaviour[slot.type]))
        scale = MAGNITUDES[kind]
        magnitude = scale.at(float(behaviour[slot.prefix + "severity"]))
        fields = [name for name in fields_of(kind) if slot.prefix + name in slot.numbers]
        numbers = {name: float(behaviour[slot.prefix + name]) for name in fields}
        if scale.has_window and not scale.has_duration:
            numbers["duration_s"] = magnitude
        if kind is ErrorType.GHOST:
            numbers["distance_m"] = max(numbers["distance_m"], GHOST_DISTANCE_M[0])
        target = Target(str(behaviour[slot.prefix + "target"]))
        return PerceptionError(type=kind, target=target, magnitude=magnitude, **numbers)

    def unused(self, error: PerceptionError) -> Collection[str]:
        """Return the parameters that an error of this type does not have."""
        return (*super().unused(error), *(() if error.type is ErrorType.GHOST else ("distance_m",)))

    def window_changes(self, old: PerceptionError, new: PerceptionError, changed: Set[str]) -> list[str]:
        """Describe when and where an error differs."""
        parts = super().window_changes(old, new, changed)
        if new.type is ErrorType.GHOST and old.distance_m != new.distance_m:
            parts.append(f"{instead(old.distance_m, new.distance_m, 'm')} ahead")
        return parts

    def words(self, vectors: Vectors) -> str:
        """Describe a candidate."""
        decoded = self.space.decode(tuple(vectors))
        scenario = HighwayScenario.from_json(decoded[SCENARIO])
        return f"{scenario.words}; {self.words_of_errors(decoded[BEHAVIOUR]) or 'no error'}"

    def scenario_changes(self, old: Values, new: Values, changed: Collection[str]) -> list[str]:
        """Describe the differences of the unsafe scenario from the safe one, one part for each parameter."""
        return _scenario_changes(old, new, changed)

    def narrow_scenario(self, parts: Parts, scenario: Values, features: Mapping[str, Any]) -> None:
        """Record that only straight roads have lanes."""
        if scenario["road"] not in STRAIGHT_ROADS:
            parts.leave_out(SCENARIO, ["lanes"])

    def error_words(self, choices: Mapping[str, str], magnitude: str) -> str:
        """Describe an error, such as ``the vehicle ahead is not perceived for 1.3 s``."""
        error = PerceptionError(
            type=ErrorType(choices[self.first("type")]),
            target=Target(choices.get(self.first("target"), Target.ALL.value)),
            magnitude=0.0,
        )
        return error.words_with(magnitude)


def _scenario_changes(old: Values, new: Values, changed: Collection[str]) -> list[str]:
    names = {name.removeprefix(f"{SCENARIO}.") for name in changed if name.startswith(f"{SCENARIO}.")}
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
            parts.append(f"{words} {instead(*speeds, 'm/s')}")
    for name, words in (("density", "traffic density"), ("traffic_speed", "traffic speed")):
        if name in names:
            parts.append(
                f"{words} {instead(100 * float(old[name]), 100 * float(new[name]), '%')} of the usual"
            )
    return parts
