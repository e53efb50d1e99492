"""The specification of an episode of `sumo@1`: the traffic, the error of perception, and how the ego drives.

Everything here can be read without SUMO installed.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Final, Self

from brink.sim.adapters.sumo.own_files import OwnFiles
from brink.sim.episode import EpisodeSpec, Json, JsonObject, check_fields, parse_choice, parse_number
from brink.sim.errors import InvalidEpisode
from brink.sim.perception_errors import MODE, Magnitude

SIMULATOR_ID: Final = "sumo@1"
OWN_FILES: Final = "own files"
"""Value of `Traffic.network` for the user's own network."""
MAX_DURATION_S: Final = 600.0
LATEST_SIGNALS_S: Final = 90.0
"""Length of the cycle of the traffic lights in all networks that have any."""
RANGE_M: Final = 150.0
"""Distance up to which an automated vehicle perceives what is ahead when it perceives without error."""


class Network(StrEnum):
    """A road network that ships with Brink."""

    MOTORWAY = "motorway"
    ARTERIAL = "arterial"
    GRID = "grid"
    RING = "ring"


NETWORK_WORDS: Final[Mapping[str, str]] = {
    Network.MOTORWAY: "motorway with a slip road",
    Network.ARTERIAL: "arterial road with traffic lights",
    Network.GRID: "grid of streets with traffic lights",
    Network.RING: "ring road",
    OWN_FILES: "network of one's own",
}
SIGNALLED: Final = (Network.ARTERIAL.value, Network.GRID.value)
"""Networks with traffic lights."""


class RoadSurface(StrEnum):
    """What the road is like, which limits how hard vehicles can brake."""

    DRY = "dry"
    WET = "wet"
    ICY = "icy"


HARDEST_BRAKING_MPS2: Final[Mapping[RoadSurface, float]] = {
    RoadSurface.DRY: 8.0,
    RoadSurface.WET: 5.5,
    RoadSurface.ICY: 3.0,
}


class Incident(StrEnum):
    """Something that happens in front of the ego."""

    NONE = "none"
    LEAD_BRAKES = "lead_brakes"


INCIDENT_BRAKING_MPS2: Final = (0.0, 8.0)
"""The gentlest and the hardest braking of the lead; at 0 it does not brake."""


class ErrorType(StrEnum):
    """How perception of things ahead is wrong."""

    MISS = "miss"
    SHORT_RANGE = "short_range"
    TOO_FAR = "too_far"
    TOO_NEAR = "too_near"
    TOO_FAST = "too_fast"
    NOISE = "noise"
    LATE = "late"


MAGNITUDES: Final[Mapping[ErrorType, Magnitude]] = {
    ErrorType.MISS: Magnitude(unit="s", none=0.0, most=10.0, meaning="how long nothing ahead is perceived"),
    ErrorType.SHORT_RANGE: Magnitude(
        unit="m",
        none=RANGE_M,
        most=0.0,
        has_duration=True,
        meaning="distance beyond which nothing ahead is perceived",
    ),
    ErrorType.TOO_FAR: Magnitude(
        unit="share",
        none=0.0,
        most=9.0,
        has_duration=True,
        meaning="how much farther away things ahead seem, as a share of their distance",
    ),
    ErrorType.TOO_NEAR: Magnitude(
        unit="share",
        none=0.0,
        most=0.9,
        has_duration=True,
        meaning="how much nearer things ahead seem, as a share of their distance",
    ),
    ErrorType.TOO_FAST: Magnitude(
        unit="m/s",
        none=0.0,
        most=10.0,
        has_duration=True,
        meaning="how much faster the vehicle ahead seems, for each 10 m of its distance",
    ),
    ErrorType.NOISE: Magnitude(
        unit="share",
        none=0.0,
        most=3.0,
        has_duration=True,
        meaning="standard deviation of the perceived distance, as a share of the distance",
    ),
    ErrorType.LATE: Magnitude(
        unit="s",
        none=0.0,
        most=5.0,
        has_duration=True,
        meaning="how much time passes from one look at what is ahead to the next",
    ),
}


class Affected(StrEnum):
    """Which vehicles perceive with the error."""

    EGO = "ego"
    FLEET = "fleet"


@dataclass(frozen=True, slots=True, kw_only=True)
class PerceptionError:
    """An error in how automated vehicles perceive what is ahead of them: vehicles, and places to stop.

    Attributes:
        type: What is wrong.
        affected: Whose perception.
        magnitude: How wrong, in the unit of the type.
        onset_s: When it begins.
        duration_s: How long it lasts.
    """

    type: ErrorType
    affected: Affected
    magnitude: float
    onset_s: float
    duration_s: float

    def to_json(self) -> JsonObject:
        """Return the error as a JSON object, with the fields of its type."""
        document: JsonObject = {
            "type": self.type.value,
            "affected": self.affected.value,
            "magnitude": self.magnitude,
            "onset_s": self.onset_s,
        }
        return document | ({"duration_s": self.duration_s} if MAGNITUDES[self.type].has_duration else {})

    @classmethod
    def from_json(cls, where: str, document: Json, longest_s: float) -> Self:
        """Parse an error.

        Args:
            where: Where it stands, for messages.
            document: The object.
            longest_s: Length of the episode, which bounds times.

        Raises:
            InvalidEpisode: A field is missing, unknown, or outside its unit.
        """
        if not isinstance(document, Mapping):
            raise InvalidEpisode(f"{where}: expected an object, got {document!r:.80}")
        kind = parse_choice(f"{where}.type", document.get("type"), ErrorType)
        scale = MAGNITUDES[kind]
        fields = ("type", "affected", "magnitude", "onset_s")
        check_fields(where, document, fields + (("duration_s",) if scale.has_duration else ()))
        lowest, highest = sorted((scale.none, scale.most))
        magnitude = parse_number(f"{where}.magnitude", document["magnitude"], lowest, highest)
        lasts_s = magnitude
        if scale.has_duration:
            lasts_s = parse_number(f"{where}.duration_s", document["duration_s"], 0.0, longest_s)
        return cls(
            type=kind,
            affected=parse_choice(f"{where}.affected", document["affected"], Affected),
            magnitude=magnitude,
            onset_s=parse_number(f"{where}.onset_s", document["onset_s"], 0.0, longest_s),
            duration_s=lasts_s,
        )

    @property
    def words(self) -> str:
        """The error in words, such as ``from 4.2 s on, the ego perceives nothing ahead for 1.3 s``."""
        lasts = f" for {self.duration_s:.1f} s" if MAGNITUDES[self.type].has_duration else ""
        much = MAGNITUDES[self.type].words(self.magnitude)
        return f"from {self.onset_s:.1f} s on, {self.words_with(much)}{lasts}"

    def words_with(self, magnitude: str) -> str:
        """Describe the error with the given magnitude and without the times."""
        return words_of_error(self.type, self.affected, magnitude)


_WHO: Final = {Affected.EGO: "the ego", Affected.FLEET: "every automated car"}
_WRONG: Final = {
    ErrorType.MISS: "nothing ahead for {much}",
    ErrorType.SHORT_RANGE: "things ahead only within {much}",
    ErrorType.TOO_FAR: "things ahead {much} too far away",
    ErrorType.TOO_NEAR: "things ahead {much} too near",
    ErrorType.TOO_FAST: "the vehicle ahead {much} too fast per 10 m of distance",
    ErrorType.NOISE: "distances with noise of {much}",
    ErrorType.LATE: "things ahead only every {much}",
}


def words_of_error(kind: ErrorType, affected: Affected, magnitude: str) -> str:
    """Return an error in words, such as ``the ego perceives things ahead 30% too far away``."""
    return f"{_WHO[affected]} perceives {_WRONG[kind].format(much=magnitude)}"


def activity_of_error(kind: ErrorType, magnitude: str) -> str:
    """Return an error as an activity, such as ``perceiving things ahead 30% too far away``."""
    return f"perceiving {_WRONG[kind].format(much=magnitude)}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Traffic:
    """The scenario: who drives where, and what happens in front of the ego.

    Attributes:
        network: A `Network`, or `OWN_FILES`.
        files: The user's own network and demand; None with a network that ships with Brink.
        demand: How full the roads are: a share of what they can carry or, with `files`, of their demand.
        trucks: Share of trucks among the vehicles; no part with `files`.
        automated: Share of automated vehicles among the cars (with `files`: among all); with the ego, the fleet.
        imperfection: How irregularly people drive, in [0, 1]: ``sigma`` of SUMO's model; no part with `files`.
        surface: What the road is like.
        signals_s: Time within the cycle of the traffic lights at which the traffic begins; no part with
            `files`.
        incident: What happens in front of the ego.
        incident_s: When.
        incident_mps2: How hard the lead brakes.
    """

    network: str
    files: OwnFiles | None
    demand: float
    trucks: float
    automated: float
    imperfection: float
    surface: RoadSurface
    signals_s: float
    incident: Incident
    incident_s: float
    incident_mps2: float

    def to_json(self) -> JsonObject:
        """Return the traffic as a JSON object."""
        return {
            **({"network": self.network} if self.files is None else {"files": self.files.to_json()}),
            "demand": self.demand,
            **({} if self.files is not None else self._built_in()),
            "automated": self.automated,
            "surface": self.surface.value,
            "incident": self.incident.value,
            **(
                {}
                if self.incident is Incident.NONE
                else {"incident_s": self.incident_s, "incident_mps2": self.incident_mps2}
            ),
        }

    def _built_in(self) -> JsonObject:
        return {"trucks": self.trucks, "imperfection": self.imperfection, "signals_s": self.signals_s}

    @classmethod
    def from_json(cls, document: Mapping[str, Json], longest_s: float) -> Self:
        """Parse the traffic of an episode.

        Args:
            document: The scenario.
            longest_s: Length of the episode, which bounds times.

        Raises:
            InvalidEpisode: A field is missing, unknown, or outside its range.
        """
        own = "files" in document
        incident = parse_choice("scenario.incident", document.get("incident"), Incident)
        fields: tuple[str, ...] = ("files",) if own else ("network", "trucks", "imperfection", "signals_s")
        fields += ("demand", "automated", "surface", "incident")
        happens = incident is not Incident.NONE
        check_fields("scenario", document, fields + (("incident_s", "incident_mps2") if happens else ()))

        def number(name: str, low: float, high: float) -> float:
            return parse_number(f"scenario.{name}", document[name], low, high)

        return cls(
            network=OWN_FILES
            if own
            else parse_choice("scenario.network", document["network"], Network).value,
            files=OwnFiles.from_json("scenario.files", document["files"]) if own else None,
            demand=number("demand", 0.0, 1.0),
            trucks=0.0 if own else number("trucks", 0.0, 1.0),
            automated=number("automated", 0.0, 1.0),
            imperfection=0.0 if own else number("imperfection", 0.0, 1.0),
            surface=parse_choice("scenario.surface", document["surface"], RoadSurface),
            signals_s=0.0 if own else number("signals_s", 0.0, LATEST_SIGNALS_S),
            incident=incident,
            incident_s=number("incident_s", 0.0, longest_s) if happens else 0.0,
            incident_mps2=number("incident_mps2", *INCIDENT_BRAKING_MPS2) if happens else 0.0,
        )

    @property
    def begin_s(self) -> float:
        """SUMO's time at which the traffic begins, in full steps; it matters to traffic lights alone."""
        return round(self.signals_s, 1) if self.network in SIGNALLED else 0.0

    @property
    def words(self) -> str:
        """The traffic in words, without what happens in front of the ego."""
        many = f"{100 * self.demand:.0f}% of capacity"
        if self.files is not None:
            many = f"{100 * self.demand:.0f}% of the demand"
        parts = [NETWORK_WORDS[self.network], f"traffic at {many}"]
        if self.files is None:
            parts.append(f"{100 * self.trucks:.0f}% trucks")
        parts += [f"{100 * self.automated:.0f}% automated cars", f"{self.surface.value} road"]
        return ", ".join(parts)

    @property
    def incident_words(self) -> str:
        """What happens in front of the ego in words; empty if nothing does."""
        if self.incident is Incident.NONE:
            return ""
        return f"the vehicle ahead brakes at {self.incident_mps2:.1f} m/s² from {self.incident_s:.1f} s on"


@dataclass(frozen=True, slots=True, kw_only=True)
class Drive:
    """A parsed specification.

    Attributes:
        traffic: The scenario.
        error: The error of perception; None for the truth.
        headway_s: Time gap that automated vehicles keep: ``tau`` of SUMO's model.
    """

    traffic: Traffic
    error: PerceptionError | None
    headway_s: float

    @classmethod
    def of(cls, spec: EpisodeSpec) -> Self:
        """Parse a specification.

        Raises:
            InvalidEpisode: It can never run.
        """
        spec.check_for(SIMULATOR_ID, MAX_DURATION_S)
        check_fields("options", spec.options, ("headway_s",))
        check_fields("behaviour", spec.behaviour, ("mode", "error"))
        if spec.behaviour["mode"] != MODE:
            raise InvalidEpisode(f"behaviour.mode: expected {MODE}, got {spec.behaviour['mode']!r}")
        error = spec.behaviour["error"]
        return cls(
            traffic=Traffic.from_json(spec.scenario, spec.duration_s),
            error=None
            if error is None
            else PerceptionError.from_json("behaviour.error", error, spec.duration_s),
            headway_s=parse_number("options.headway_s", spec.options["headway_s"], 0.5, 3.0),
        )

    @property
    def words(self) -> str:
        """Traffic, incident and error in words."""
        incident = self.traffic.incident_words
        error = "no error" if self.error is None else self.error.words
        return f"{self.traffic.words}; " + "; ".join(filter(None, (incident, error)))
