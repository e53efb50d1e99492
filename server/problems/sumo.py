"""The problem `sumo-drivers@1`: traffic in SUMO in which automated vehicles perceive what is ahead with an error.

The scenario is the traffic, the behaviour is one error; without it, automated vehicles perceive the truth. Source:
ours; see docs/how-to/use-other-simulators.md.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Final

import numpy as np

from brink.search.errors import ConfigError
from brink.search.parameters import Parameter, Value
from brink.search.settings import check_settings, setting
from brink.search.space import Categorical, Component, Dormant, Real, SearchSpace
from brink.server.problems.base import BEHAVIOUR, Activity, SeverityScale, SimulatedSolution, Vectors
from brink.server.problems.changes import different
from brink.server.problems.perception_errors import NO_ERROR, HasTrueVariant, severity_scale
from brink.server.problems.requirements import (
    ANY,
    JudgedByRequirements,
    check_requirements,
    chosen_requirements,
    requirement_setting,
)
from brink.sim.adapters.sumo.own_files import OwnFiles, OwnFilesError, check_network, vehicle_ids
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
"""Requirements that say nothing here: SUMO keeps vehicles in lanes, and knows neither goals nor reasons to stop."""
LATEST_ONSET_S: Final = 40.0
LATEST_INCIDENT_S: Final = 40.0
COVERED: Final = (ErrorType.MISS, ErrorType.TOO_FAR)
"""Errors that are milder than perceiving nothing ahead from some time on."""
_NETWORKS: Final = tuple(network.value for network in Network)
_INCIDENT: Final = ("incident", "incident_s", "incident_mps2")
_FIELDS: Final = ("type", "affected", "onset_s", "duration_s", "severity")


@dataclass(frozen=True, slots=True, kw_only=True)
class SumoDriversParams:
    """Parameters of the problem."""

    requirement: str | list[str] = requirement_setting(["front-gap@1", "no-collision@1"], RECORDED)  # noqa: RUF009
    network: str = setting(
        ANY, help="Road network; with any, it is part of the scenario.", choices=(ANY, *_NETWORKS)
    )
    network_file: str = setting(
        "", help="Network of one's own in SUMO's format (.net.xml); it takes the place of network."
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
                    name, "expected a file: a network of one's own needs network_file and demand_file"
                )
        if self.network_file and self.network != ANY:
            raise ConfigError("network", f"expected {ANY} or no value, because network_file is given")
        known = [name for name in plugin_ids(REQUIREMENT_PLUGINS) if name not in NOT_MEASURED]
        check_requirements(self.requirement, known)

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
            Real(name="trucks", low=0.0, high=0.4, unit=""),
            Real(name="imperfection", low=0.0, high=1.0, unit=""),
            Real(name="signals_s", low=0.0, high=LATEST_SIGNALS_S, unit="s"),
        ]
    latest_s = min(LATEST_INCIDENT_S, params.duration_s)
    parameters += [
        Real(name="demand", low=0.2, high=1.0, unit=""),
        Real(name="automated", low=0.0, high=1.0, unit=""),
        Categorical(name="surface", choices=tuple(surface.value for surface in RoadSurface)),
        Categorical(name="incident", choices=tuple(incident.value for incident in Incident)),
        Real(name="incident_s", low=0.0, high=latest_s, unit="s"),
        Real(name="incident_mps2", low=INCIDENT_BRAKING_MPS2[0], high=INCIDENT_BRAKING_MPS2[1], unit="m/s2"),
    ]
    dormant = Dormant(
        label="incident", null_choice=Incident.NONE.value, members=("incident_s", "incident_mps2")
    )
    return Component(name="scenario", parameters=tuple(parameters), constraints=(dormant,))


def error_component(duration_s: float) -> Component:
    """Return the component of the error of perception in episodes of a length."""
    return Component(
        name=BEHAVIOUR,
        parameters=(
            Categorical(name="type", choices=(NO_ERROR, *(kind.value for kind in ErrorType))),
            Categorical(name="affected", choices=tuple(one.value for one in Affected)),
            Real(name="onset_s", low=0.0, high=min(LATEST_ONSET_S, duration_s), unit="s"),
            Real(name="duration_s", low=0.0, high=duration_s, unit="s"),
            Real(name="severity", low=0.0, high=1.0, unit=""),
        ),
        constraints=(
            Dormant(label="type", null_choice=NO_ERROR, members=("onset_s", "duration_s", "severity")),
        ),
    )


class SumoDrivers(HasTrueVariant, JudgedByRequirements):
    """Traffic of hundreds of vehicles, in which automated ones perceive what is ahead with an error."""

    id: ClassVar[str] = "sumo-drivers@1"
    summary: ClassVar[str] = "Traffic in SUMO with errors in how automated vehicles perceive what is ahead."
    params_type: ClassVar[type[Any]] = SumoDriversParams
    about_component: ClassVar[str] = (
        "The perception's errors are injected: results show what would happen if a perception erred like this, not "
        "that yours does."
    )
    extra: ClassVar[str] = "sumo"
    modules: ClassVar[tuple[str, ...]] = ("libsumo",)

    def __init__(self, params: SumoDriversParams) -> None:
        self.params = params
        self.space = SearchSpace((traffic_component(params), error_component(params.duration_s)))
        self.algorithm_defaults: Mapping[str, Any] = {
            "severity": f"{BEHAVIOUR}.severity",
            "fixed": {
                f"{BEHAVIOUR}.affected": Affected.EGO.value,
                f"{BEHAVIOUR}.duration_s": params.duration_s,
            },
            "truth": {f"{BEHAVIOUR}.type": NO_ERROR},
            "grossest": {f"{BEHAVIOUR}.type": ErrorType.SHORT_RANGE.value},
            "covers": {f"{BEHAVIOUR}.type": [kind.value for kind in COVERED]},
        }
        self.requirements = params.requirements
        self.needs = SIMULATOR_ID
        self.timeout_s = params.timeout_s

    def wrong_inputs(self) -> list[tuple[str, str]]:
        """Return the errors of one's own network and demand."""
        params = self.params
        if not params.network_file:
            return []
        wrong = []
        for name, check in (("network_file", check_network), ("demand_file", vehicle_ids)):
            try:
                check(getattr(params, name))
            except OwnFilesError as error:
                wrong.append((name, str(error)))
        if not wrong:
            try:
                OwnFiles.read(params.network_file, params.demand_file, params.ego)
            except OwnFilesError as error:
                wrong.append(("ego", str(error)))
        return wrong

    @cached_property
    def _files(self) -> OwnFiles | None:
        params = self.params
        if not params.network_file:
            return None
        return OwnFiles.read(params.network_file, params.demand_file, params.ego)

    def episode(self, vectors: Vectors, seed: int) -> EpisodeSpec:
        """Return the episode of a traffic and an error of perception."""
        decoded = self.space.decode(tuple(vectors))
        error = None if self.is_true else self._error(decoded[BEHAVIOUR])
        return EpisodeSpec(
            simulator=SIMULATOR_ID,
            scenario=self._traffic(decoded["scenario"], self._files).to_json(),
            behaviour={"mode": MODE, "error": None if error is None else error.to_json()},
            requirements=tuple(dict.fromkeys((*RECORDED, *self.requirements))),
            seed=seed,
            duration_s=self.params.duration_s,
            options={"headway_s": self.params.headway_s},
        )

    def _traffic(self, values: Mapping[str, Value], files: OwnFiles | None = None) -> Traffic:
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

    def _error(self, values: Mapping[str, Value]) -> PerceptionError | None:
        """Return the error of a decoded behaviour; None if it is none."""
        if values["type"] == NO_ERROR:
            return None
        kind = ErrorType(str(values["type"]))
        scale = MAGNITUDES[kind]
        magnitude = scale.at(float(values["severity"]))
        return PerceptionError(
            type=kind,
            affected=Affected(str(values["affected"])),
            magnitude=magnitude,
            onset_s=float(values["onset_s"]),
            duration_s=float(values["duration_s"]) if scale.has_duration else magnitude,
        )

    def words(self, vectors: Vectors) -> str:
        """Describe a candidate."""
        decoded = self.space.decode(tuple(vectors))
        traffic = self._traffic(decoded["scenario"])
        error = None if self.is_true else self._error(decoded[BEHAVIOUR])
        parts = (traffic.words, traffic.incident_words, "no error" if error is None else error.words)
        return "; ".join(filter(None, parts))

    def words_of_change(
        self, safe: SimulatedSolution, unsafe: SimulatedSolution, changed: Collection[str]
    ) -> str:
        """Describe what is different in the unsafe one of two candidates."""
        old, new = (self.space.decode(tuple(one.vectors)) for one in (safe, unsafe))
        parts = _traffic_changes(old["scenario"], new["scenario"], changed)
        names = {name.removeprefix(f"{BEHAVIOUR}.") for name in changed if name.startswith(f"{BEHAVIOUR}.")}
        if names:
            parts.append(_error_change(self._error(old[BEHAVIOUR]), self._error(new[BEHAVIOUR]), names))
        return "; ".join(filter(None, parts))

    def severity_scale(self, choices: Mapping[str, str]) -> SeverityScale | None:
        """Return what severities mean, given the type of the error."""
        kind = choices.get(f"{BEHAVIOUR}.type")
        if kind is None or kind == NO_ERROR:
            return None
        scale = MAGNITUDES[ErrorType(kind)]
        return severity_scale(scale)

    def error_words(self, choices: Mapping[str, str], magnitude: str) -> str:
        """Return an error as an activity, such as ``perceiving things ahead 30% too far away``."""
        return activity_of_error(ErrorType(choices[f"{BEHAVIOUR}.type"]), magnitude)

    def activity(self, vectors: Vectors, features: Mapping[str, Any]) -> Activity | None:
        """Return which parameters had a part in an episode: those of an error that acted, and of what happened."""
        if not _is_number(features.get("ended_at_s")):
            return None
        values = self.space.decode(tuple(vectors))
        traffic, error = self._traffic(values["scenario"]), self._error(values[BEHAVIOUR])
        names = self.space.column_names()
        place = {name: index for index, name in enumerate(names)}
        active = np.ones(len(names), dtype=np.bool_)
        effective = np.concatenate([np.asarray(vector, dtype=np.float64) for vector in vectors])

        def leave_out(*left_out: str) -> None:
            columns = [place[name] for name in left_out if name in place]
            active[columns] = False
            effective[[column for column in columns if names[column].endswith(_NUMBERS)]] = 0.0

        if traffic.network not in SIGNALLED:
            leave_out("scenario.signals_s")
        if not _is_number(features.get("incident_at_s")):
            # As with the error, the choice stays active where nothing was to happen.
            happens = traffic.incident is not Incident.NONE
            leave_out(*(f"scenario.{name}" for name in _INCIDENT if happens or name != "incident"))
            effective[place["scenario.incident"]] = 0.0
        acted = not self.is_true and error is not None and _is_number(features.get("error_acted_at_s"))
        if not acted or error is None:
            # The type stays active where there is no error: another type would have been one.
            fields = _FIELDS if error is not None else _FIELDS[1:]
            leave_out(*(f"{BEHAVIOUR}.{name}" for name in fields))
            effective[place[f"{BEHAVIOUR}.type"]] = 0.0
        elif not MAGNITUDES[error.type].has_duration:
            leave_out(f"{BEHAVIOUR}.duration_s")
        return Activity(active=active, effective=effective, idle=() if acted else (BEHAVIOUR,))


_NUMBERS: Final = ("_s", "_mps2", "severity")
"""How the names of those numbers end that may have no part; the smallest value of each is 0."""


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


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


def _traffic_changes(
    old: Mapping[str, Value], new: Mapping[str, Value], changed: Collection[str]
) -> list[str]:
    """Describe what is different in the unsafe one of two scenarios, one part for each parameter."""
    names = {name.removeprefix("scenario.") for name in changed if name.startswith("scenario.")}
    parts = []
    if "network" in names:
        words = [_with_article(NETWORK_WORDS[str(one["network"])]) for one in (new, old)]
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


def _error_change(old: PerceptionError | None, new: PerceptionError | None, changed: Collection[str]) -> str:
    """Describe how an error differs, such as ``the ego perceives nothing ahead for 2.4 s instead of 2.2 s``."""
    if new is None:
        return f"there is no error (in the safe drive, {old.words})" if old is not None else ""
    if old is None:
        return new.words
    if old.type is not new.type or old.affected is not new.affected:
        return f"{new.words} (in the safe drive, {old.words})"
    scale, parts = MAGNITUDES[new.type], []
    much = scale.words(new.magnitude)
    if "severity" in changed and old.magnitude != new.magnitude:
        much = _instead(scale.number(old.magnitude), scale.number(new.magnitude), scale.shown_unit)
    if "onset_s" in changed and old.onset_s != new.onset_s:
        parts.append(f"from {_instead(old.onset_s, new.onset_s, 's')}")
    if scale.has_duration and "duration_s" in changed and old.duration_s != new.duration_s:
        parts.append(f"for {_instead(old.duration_s, new.duration_s, 's')}")
    if not parts and old.magnitude == new.magnitude:
        return ""
    return ", ".join([new.words_with(much), *parts])


def _instead(old: float, new: float, unit: str) -> str:
    before, after = different(old, new)
    suffix = unit if unit == "%" else f" {unit}"
    return f"{after}{suffix} instead of {before}{suffix}"
