"""The problem `sumo-drivers@1`: traffic in SUMO in which automated vehicles perceive what is ahead with an error.

The scenario is the traffic, the behaviour is one error; without it, automated vehicles perceive the truth. Source:
ours; see docs/how-to/use-other-simulators.md.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Final

from brink.search.algorithm import Measure
from brink.search.errors import ConfigError
from brink.search.parameters import Parameter
from brink.search.settings import check_settings, setting
from brink.search.space import Categorical, Component, Dormant, Real, SearchSpace
from brink.server.problems.base import BEHAVIOUR, Vectors, is_number
from brink.server.problems.changes import different
from brink.server.problems.error_slots import (
    NO_ERROR,
    SCENARIO,
    Parts,
    PerceptionErrors,
    Slot,
    Values,
    slots_component,
)
from brink.server.problems.requirements import (
    ANY,
    Stated,
    check_requirements,
    chosen_requirements,
    formulas_in,
    requirement_setting,
)
from brink.server.problems.resolutions import (
    RESOLUTION_MPS2,
    RESOLUTION_S,
    RESOLUTION_SHARE,
    severity_resolution,
)
from brink.sim.adapters.sumo.own_files import OwnFiles, OwnFilesError, check_edges, edge_ids, vehicle_ids
from brink.sim.adapters.sumo.specification import (
    INCIDENT_BRAKING_MPS2,
    LATEST_SIGNALS_S,
    MAGNITUDES,
    MAX_DURATION_S,
    NETWORK_WORDS,
    OWN_FILES,
    SIGNALLED,
    SIMULATOR_ID,
    Affected,
    ErrorType,
    Incident,
    Network,
    PerceptionError,
    RoadSurface,
    Traffic,
    activity_of_error,
)
from brink.sim.catalogue import REQUIREMENTS as REQUIREMENT_PLUGINS
from brink.sim.catalogue import plugin_ids
from brink.sim.episode import EpisodeSpec
from brink.sim.perception_errors import MODE

RECORDED: Final = ("front-gap@1", "no-collision@1", "red-light@1")
"""Requirements that every episode evaluates."""
NOT_MEASURED: Final = ("lane-keeping@1", "progress@1", "no-dangerous-stop@1")
"""Requirements without meaning here: SUMO keeps vehicles in lanes, and knows neither goals nor reasons to stop."""
NOT_RECORDED: Final = (
    "pedestrian_gap_m",
    "heading_error_rad",
    "in_conflict_area",
    "goal_reached",
    "brakes_for_nothing",
)
"""Signals of formulas that SUMO does not measure."""
LATEST_ONSET_S: Final = 40.0
LATEST_INCIDENT_S: Final = 40.0
COVERED: Final = (ErrorType.MISS, ErrorType.TOO_FAR)
"""Errors that are milder than perceiving nothing ahead from some time on."""
_NETWORKS: Final = tuple(network.value for network in Network)
_INCIDENT: Final = ("incident", "incident_s", "incident_mps2")


@dataclass(frozen=True, slots=True, kw_only=True)
class SumoDriversParams:
    """Parameters of the problem."""

    requirement: Stated = requirement_setting(["front-gap@1", "no-collision@1"], RECORDED)  # noqa: RUF009
    network: str = setting(
        ANY, help="Road network; with any, it is part of the scenario.", choices=(ANY, *_NETWORKS)
    )
    network_file: str = setting(
        "", help="The user's own network in SUMO's format (.net.xml), instead of network."
    )
    demand_file: str = setting("", help="Demand for network_file, with vehicles and their routes (.rou.xml).")
    ego: str = setting("ego", help="Id of the vehicle under test in demand_file.")
    headway_s: float = setting(
        1.0, ge=0.5, le=3.0, unit="s", help="Time gap that automated vehicles keep (tau)."
    )
    duration_s: float = setting(60.0, ge=5.0, le=MAX_DURATION_S, unit="s", help="Length of an episode.")
    timeout_s: float = setting(120.0, gt=0.0, le=3600.0, unit="s", help="Wall-clock limit of an episode.")

    def __post_init__(self) -> None:
        check_settings(self)
        for name, other in (("demand_file", self.network_file), ("network_file", self.demand_file)):
            if other and not getattr(self, name):
                raise ConfigError(
                    name, "expected a file: your own network needs network_file and demand_file"
                )
        if self.network_file and self.network != ANY:
            raise ConfigError("network", f"expected {ANY} or no value, because network_file is given")
        known = [name for name in plugin_ids(REQUIREMENT_PLUGINS) if name not in NOT_MEASURED]
        check_requirements(self.requirement, known, duration_s=self.duration_s, not_recorded=NOT_RECORDED)

    @property
    def requirements(self) -> tuple[str, ...]:
        """The requirements that give the verdict."""
        return chosen_requirements(self.requirement, RECORDED)


def traffic_component(params: SumoDriversParams) -> Component:
    """Return the component of the traffic."""
    parameters: list[Parameter] = []
    if not params.network_file:
        if params.network == ANY:
            parameters.append(Categorical(name="network", choices=_NETWORKS))
        parameters += [
            Real(name="trucks", low=0.0, high=0.4, unit="", resolution=RESOLUTION_SHARE),
            Real(name="imperfection", low=0.0, high=1.0, unit="", resolution=RESOLUTION_SHARE),
            Real(name="signals_s", low=0.0, high=LATEST_SIGNALS_S, unit="s", resolution=RESOLUTION_S),
        ]
    latest_s = min(LATEST_INCIDENT_S, params.duration_s)
    parameters += [
        Real(name="demand", low=0.2, high=1.0, unit="", resolution=RESOLUTION_SHARE),
        Real(name="automated", low=0.0, high=1.0, unit="", resolution=RESOLUTION_SHARE),
        Categorical(name="surface", choices=tuple(surface.value for surface in RoadSurface)),
        Categorical(name="incident", choices=tuple(incident.value for incident in Incident)),
        Real(name="incident_s", low=0.0, high=latest_s, unit="s", resolution=RESOLUTION_S),
        Real(
            name="incident_mps2",
            low=INCIDENT_BRAKING_MPS2[0],
            high=INCIDENT_BRAKING_MPS2[1],
            unit="m/s2",
            resolution=RESOLUTION_MPS2,
        ),
    ]
    dormant = Dormant(
        label="incident", null_choice=Incident.NONE.value, members=("incident_s", "incident_mps2")
    )
    return Component(name="scenario", parameters=tuple(parameters), constraints=(dormant,))


def error_component(duration_s: float) -> Component:
    """Return the component of the error of perception in episodes of a length."""
    return slots_component(
        [
            (
                Categorical(name="type", choices=(NO_ERROR, *(kind.value for kind in ErrorType))),
                Categorical(name="affected", choices=tuple(affected.value for affected in Affected)),
                Real(
                    name="onset_s",
                    low=0.0,
                    high=min(LATEST_ONSET_S, duration_s),
                    unit="s",
                    resolution=RESOLUTION_S,
                ),
                Real(name="duration_s", low=0.0, high=duration_s, unit="s", resolution=RESOLUTION_S),
                Real(
                    name="severity",
                    low=0.0,
                    high=1.0,
                    unit="",
                    resolution=severity_resolution("type", MAGNITUDES),
                ),
            )
        ]
    )


class SumoDrivers(PerceptionErrors[PerceptionError]):
    """Traffic of hundreds of vehicles, in which automated ones perceive what is ahead with an error."""

    id: ClassVar[str] = "sumo-drivers@1"
    summary: ClassVar[str] = "Traffic in SUMO with errors in how automated vehicles perceive what is ahead."
    params_type: ClassVar[type[Any]] = SumoDriversParams
    about_component = (
        "The perception's errors are injected: results show what would happen if a perception erred like this, not "
        "that yours does."
    )
    extra = "sumo"
    modules = ("libsumo",)
    recorded = RECORDED
    measures = (
        Measure(name="least_front_gap_m", low=0.0, high=50.0, unit="m"),
        Measure(name="hardest_braking_mps2", low=0.0, high=9.0, unit="m/s²"),
    )
    magnitudes = MAGNITUDES
    identity = ("type", "affected")
    lacking = "there is no error (in the safe drive, {})"

    def __init__(self, params: SumoDriversParams) -> None:
        self.params = params
        self.space = SearchSpace((traffic_component(params), error_component(params.duration_s)))
        whole = {"affected": Affected.EGO.value, "duration_s": params.duration_s}
        self.algorithm_defaults = self.study_of_severity(whole) | {
            "grossest": {self.first("type"): ErrorType.SHORT_RANGE.value},
            "covers": {self.first("type"): [kind.value for kind in COVERED]},
        }
        self.requirements = params.requirements
        self.formulas = formulas_in(params.requirement)
        self.needs = SIMULATOR_ID
        self.timeout_s = params.timeout_s

    def wrong_inputs(self) -> list[tuple[str, str]]:
        """Return errors in the user's own network and demand."""
        params = self.params
        if not params.network_file:
            return []
        network, demand = params.network_file, params.demand_file
        wrong = [*_refusal("network_file", edge_ids, network), *_refusal("demand_file", vehicle_ids, demand)]
        wrong = wrong or _refusal("demand_file", check_edges, demand, network)
        return wrong or _refusal("ego", OwnFiles.read, network, demand, params.ego)

    @cached_property
    def _files(self) -> OwnFiles | None:
        params = self.params
        if not params.network_file:
            return None
        return OwnFiles.read(params.network_file, params.demand_file, params.ego)

    def episode(self, vectors: Vectors, seed: int) -> EpisodeSpec:
        """Return the episode of a traffic and an error of perception."""
        decoded = self.space.decode(tuple(vectors))
        errors = self.errors(decoded[BEHAVIOUR])
        return EpisodeSpec(
            simulator=SIMULATOR_ID,
            scenario=self._traffic(decoded[SCENARIO], self._files).to_json(),
            behaviour={"mode": MODE, "error": errors[0].to_json() if errors else None},
            requirements=self.evaluated,
            formulas=self.formulas,
            seed=seed,
            duration_s=self.params.duration_s,
            options={"headway_s": self.params.headway_s},
        )

    def _traffic(self, values: Values, files: OwnFiles | None = None) -> Traffic:
        params = self.params
        network = str(values.get("network", params.network))
        return Traffic(
            network=OWN_FILES if params.network_file else network,
            files=files,
            demand=float(values["demand"]),
            trucks=float(values.get("trucks", 0.0)),
            automated=float(values["automated"]),
            imperfection=float(values.get("imperfection", 0.0)),
            surface=RoadSurface(str(values["surface"])),
            signals_s=float(values.get("signals_s", 0.0)),
            incident=Incident(str(values["incident"])),
            incident_s=float(values["incident_s"]),
            incident_mps2=float(values["incident_mps2"]),
        )

    def error(self, behaviour: Values, slot: Slot) -> PerceptionError:
        """Return the error of a decoded behaviour that has one."""
        kind = ErrorType(str(behaviour["type"]))
        scale = MAGNITUDES[kind]
        magnitude = scale.at(float(behaviour["severity"]))
        return PerceptionError(
            type=kind,
            affected=Affected(str(behaviour["affected"])),
            magnitude=magnitude,
            onset_s=float(behaviour["onset_s"]),
            duration_s=float(behaviour["duration_s"]) if scale.has_duration else magnitude,
        )

    def words(self, vectors: Vectors) -> str:
        """Describe a candidate."""
        decoded = self.space.decode(tuple(vectors))
        traffic = self._traffic(decoded[SCENARIO])
        error = self.words_of_errors(decoded[BEHAVIOUR]) or "no error"
        return "; ".join(filter(None, (traffic.words, traffic.incident_words, error)))

    def scenario_changes(self, old: Values, new: Values, changed: Collection[str]) -> list[str]:
        """Describe the differences of the unsafe scenario from the safe one, one part for each parameter."""
        return _traffic_changes(old, new, changed)

    def error_words(self, choices: Mapping[str, str], magnitude: str) -> str:
        """Describe an error as an activity, such as ``perceiving things ahead 30% too far away``."""
        return activity_of_error(ErrorType(choices[self.first("type")]), magnitude)

    def acted(self, features: Mapping[str, Any], present: Sequence[Slot]) -> Collection[Slot] | None:
        """Return the error if it took effect; None if the episode does not show it."""
        if not is_number(features.get("ended_at_s")):
            return None
        return present if not self.is_true and is_number(features.get("error_acted_at_s")) else ()

    def narrow_scenario(self, parts: Parts, scenario: Values, features: Mapping[str, Any]) -> None:
        """Record that networks without lights have no cycle, and whether the incident happened."""
        traffic = self._traffic(scenario)
        if traffic.network not in SIGNALLED and "signals_s" in scenario:
            parts.leave_out(SCENARIO, ["signals_s"])
            parts.zero(SCENARIO, ["signals_s"])
        if not is_number(features.get("incident_at_s")):
            # As with the error, the choice stays active where nothing was to happen.
            happens = traffic.incident is not Incident.NONE
            parts.leave_out(SCENARIO, _INCIDENT if happens else _INCIDENT[1:])
            parts.silence(SCENARIO, _INCIDENT[0], Incident.NONE.value, _INCIDENT[1:])


def _refusal(name: str, check: Callable[..., object], *arguments: str) -> list[tuple[str, str]]:
    """Return the parameter and the message if a check of the user's own files fails."""
    try:
        check(*arguments)
    except OwnFilesError as error:
        return [(name, str(error))]
    return []


_PERCENT: Final = {
    "demand": "traffic is at {0}% of capacity instead of {1}%",
    "trucks": "{0}% of the vehicles are trucks instead of {1}%",
    "automated": "{0}% of the cars are automated instead of {1}%",
    "imperfection": "people drive with an irregularity of {0}% instead of {1}%",
}
_SECONDS: Final = {
    "signals_s": "the traffic begins {0} s into the cycle of the lights instead of {1} s",
    "incident_s": "the vehicle ahead brakes from {0} s on instead of {1} s",
    "incident_mps2": "the vehicle ahead brakes at {0} m/s² instead of {1} m/s²",
}


def _traffic_changes(old: Values, new: Values, changed: Collection[str]) -> list[str]:
    """Describe the differences of the unsafe scenario from the safe one, one part for each parameter."""
    names = {name.removeprefix("scenario.") for name in changed if name.startswith("scenario.")}
    parts = []
    if "network" in names:
        words = [_with_article(NETWORK_WORDS[str(side["network"])]) for side in (new, old)]
        parts.append(f"the network is {words[0]} instead of {words[1]}")
    if "surface" in names:
        parts.append(f"the road is {new['surface']} instead of {old['surface']}")
    for name, template in _PERCENT.items():
        if name in names:
            before, after = different(100.0 * float(old[name]), 100.0 * float(new[name]))
            parts.append(template.format(after, before))
    if "incident" in names:
        happens = new["incident"] != Incident.NONE.value
        parts.append("the vehicle ahead brakes" if happens else "the vehicle ahead does not brake")
        names -= {"incident_s", "incident_mps2"}
    for name, template in _SECONDS.items():
        if name in names:
            before, after = different(float(old[name]), float(new[name]))
            parts.append(template.format(after, before))
    return parts


def _with_article(words: str) -> str:
    return f"{'an' if words[0] in 'aeiou' else 'a'} {words}"
