"""The specification of an emergency-braking episode: scenario, behaviour, options, and their descriptions.

Medium and hard rain are excluded: their friction is too low to stop in time for a pedestrian at this distance,
however good the detector is. This module imports no rendering, physics or neural-network code, so a coordinator can
read specifications.

Source: Ferreira et al. 2022, the experiment's scenario.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from enum import StrEnum
from typing import Final, Self

from brink.sim.aeb.braking import HOLD_S, PERSON_FRAMES, PERSON_WINDOW
from brink.sim.driving.interface import LATENCY_S
from brink.sim.episode import Json, JsonObject, nearest, parse_choice, parse_integer, parse_number
from brink.sim.errors import InvalidEpisode
from brink.sim.perception.user_files import DEFAULT_DETECTOR, weights_digest
from brink.sim.perturbations import CATALOGUE, Mode, Perturbation, PerturbationError, parse_perturbations
from brink.sim.urban.behaviour import DEFAULT_DURATION_S, DetectorBehaviour, InjectedTrajectory
from brink.sim.urban.options import MAX_LATENCY_S
from brink.sim.world.scenario import TimeOfDay, Weather

TIMES = tuple(TimeOfDay)
WEATHERS = (Weather.CLEAR, Weather.CLOUDY, Weather.WET, Weather.WET_CLOUDY, Weather.SOFT_RAIN)


class Occluder(StrEnum):
    """Vehicle parked next to the gap that the pedestrian steps out of."""

    CAR = "car"
    VAN = "van"


class Obstacle(StrEnum):
    """A body on the road of a kind that no detector was trained on."""

    NONE = "none"
    NOVELTY = "novelty"
    """A fallen tree: an unknown class."""
    ANOMALY = "anomaly"
    """An overturned vehicle: a known class in an unknown pose."""


CROSSING_M = (45.0, 65.0)
ARRIVAL_S = (-0.4, 0.0)
"""In soft rain, a person from behind a van who arrives more than 0.05 s later is seen too late to stop; more than
0.1 s later, even if one image triggered the brake."""
ONCOMING_M = (40.0, 90.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class AebScenario:
    """The street, the weather and the pedestrian.

    Attributes:
        time_of_day: Affects the image.
        weather: Affects the image and friction.
        occluder: Hides the pedestrian.
        crossing_m: Distance from the ego's front bumper to the pedestrian's line.
        arrival_s: When the pedestrian reaches the middle of the lane, relative to an ego that does not brake.
        oncoming_m: Initial distance of the first oncoming vehicle.
        obstacle: Obstacle on the road, if any.
    """

    time_of_day: TimeOfDay
    weather: Weather
    occluder: Occluder
    crossing_m: float
    arrival_s: float
    oncoming_m: float
    obstacle: Obstacle = Obstacle.NONE

    def to_json(self) -> JsonObject:
        """Return the scenario as a JSON object."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @classmethod
    def from_json(cls, document: Mapping[str, Json]) -> Self:
        """Read a scenario from a JSON object.

        Raises:
            InvalidEpisode: A field is missing, unknown or out of range.
        """
        known = tuple(field.name for field in fields(cls))
        for name in document:
            if name not in known:
                raise InvalidEpisode(f"scenario: unknown field {name!r}{nearest(name, known)}")
        for name in known:
            if name not in document and name != "obstacle":
                raise InvalidEpisode(f"scenario.{name}: missing")
        return cls(
            time_of_day=parse_choice("scenario.time_of_day", document["time_of_day"], TIMES),
            weather=parse_choice("scenario.weather", document["weather"], WEATHERS),
            occluder=parse_choice("scenario.occluder", document["occluder"], tuple(Occluder)),
            crossing_m=parse_number("scenario.crossing_m", document["crossing_m"], *CROSSING_M),
            arrival_s=parse_number("scenario.arrival_s", document["arrival_s"], *ARRIVAL_S),
            oncoming_m=parse_number("scenario.oncoming_m", document["oncoming_m"], *ONCOMING_M),
            obstacle=parse_choice("scenario.obstacle", document.get("obstacle", "none"), tuple(Obstacle)),
        )


SIZE_PX: Final = (640, 360)
THRESHOLD: Final = 0.5


class SightMode(StrEnum):
    """Source of the boxes that the brake receives."""

    ORACLE = "oracle"
    """The ground truth."""
    INJECTED = "injected"
    """Injected boxes, as in the urban problem; nothing is rendered."""
    BLIND = "blind"
    """No boxes."""
    DETECTOR = "detector"
    """A detector's boxes in the camera's images, which may be perturbed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Behaviour:
    """Source of the boxes that the brake receives, and the perturbations of the images.

    Attributes:
        mode: Source of the boxes.
        detector: Id of the detector.
        threshold: Minimum score of a detection reported to the brake.
        perturbations: Applied to every image, in order.
        fields: Whether random fields are drawn for each frame or once.
        trajectories: Injected boxes.
        weights: Digest of a user's weights file; empty for a registered detector.
    """

    mode: SightMode
    detector: str = DEFAULT_DETECTOR
    threshold: float = THRESHOLD
    perturbations: tuple[Perturbation, ...] = ()
    fields: Mode = Mode.PER_FRAME
    weights: str = ""
    trajectories: tuple[InjectedTrajectory, ...] = ()

    @classmethod
    def from_json(cls, document: Mapping[str, Json], duration_s: float = DEFAULT_DURATION_S) -> Self:
        """Read a behaviour from a JSON object.

        Args:
            document: Its fields; injected trajectories have the urban simulator's format and image.
            duration_s: Length of the episode, which bounds trajectories.

        Raises:
            InvalidEpisode: A field is unknown or invalid.
        """
        mode = parse_choice("behaviour.mode", document.get("mode"), tuple(SightMode))
        if mode is SightMode.INJECTED:
            return cls(mode=mode, trajectories=DetectorBehaviour.from_json(document, duration_s).trajectories)
        known = ("mode", "detector", "threshold", "perturbations", "fields", "weights")
        allowed = known if mode is SightMode.DETECTOR else ("mode",)
        for name in document:
            if name not in allowed:
                raise InvalidEpisode(
                    f"behaviour: unknown field {name!r} for mode {mode}{nearest(name, allowed)}"
                )
        perturbations = document.get("perturbations", [])
        detector = document.get("detector", DEFAULT_DETECTOR)
        if not isinstance(perturbations, list):
            raise InvalidEpisode(f"behaviour.perturbations: expected a list, got {perturbations!r}")
        if not isinstance(detector, str):
            raise InvalidEpisode(
                f"behaviour.detector: expected an id such as {DEFAULT_DETECTOR}, got {detector!r}"
            )
        weights = document.get("weights", "")
        if not isinstance(weights, str):
            raise InvalidEpisode(f"behaviour.weights: expected a digest, got {weights!r}")
        try:
            parsed = parse_perturbations(perturbations)
        except PerturbationError as error:
            raise InvalidEpisode(f"behaviour.perturbations: {error}") from None
        return cls(
            mode=mode,
            detector=detector,
            threshold=parse_number("behaviour.threshold", document.get("threshold", THRESHOLD), 0.0, 1.0),
            perturbations=parsed,
            weights=weights,
            fields=parse_choice(
                "behaviour.fields", document.get("fields", Mode.PER_FRAME.value), tuple(Mode)
            ),
        )


def check_weights(behaviour: Behaviour) -> None:
    """Check that the weights file on this machine is the one the campaign was submitted with.

    Raises:
        InvalidEpisode: The file has changed.
    """
    if behaviour.weights and behaviour.weights != weights_digest(behaviour.detector):
        raise InvalidEpisode(
            f"behaviour.detector: {behaviour.detector} differs from the file that the campaign was submitted with"
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Options:
    """Options of an episode.

    Attributes:
        size_px: Size of the camera's image.
        hold_s: How long braking continues without a trigger.
        braking: Whether the brake works.
        person_frames: Number of the last three frames in which a person must be reported to trigger it, 1 to 3.
        latency_s: Time from an image to the arrival of what was detected in it, in [0, `MAX_LATENCY_S`].
        pitch: Whether the camera pitches with the car's body.
    """

    size_px: tuple[int, int] = SIZE_PX
    hold_s: float = HOLD_S
    braking: bool = True
    person_frames: int = PERSON_FRAMES
    latency_s: float = LATENCY_S
    pitch: bool = True

    @classmethod
    def from_json(cls, document: Mapping[str, Json]) -> Self:
        """Read options from a JSON object.

        Raises:
            InvalidEpisode: A field is unknown or invalid.
        """
        known = ("width_px", "height_px", "hold_s", "braking", "person_frames", "latency_s", "pitch")
        for name in document:
            if name not in known:
                raise InvalidEpisode(f"options: unknown field {name!r}{nearest(name, known)}")
        width_px = parse_number("options.width_px", document.get("width_px", SIZE_PX[0]), 64, 4096)
        height_px = parse_number("options.height_px", document.get("height_px", SIZE_PX[1]), 64, 4096)
        switches = {name: document.get(name, True) for name in ("braking", "pitch")}
        for name, value in switches.items():
            if not isinstance(value, bool):
                raise InvalidEpisode(f"options.{name}: expected true or false, got {value!r:.80}")
        latency_s = parse_number(
            "options.latency_s", document.get("latency_s", LATENCY_S), 0.0, MAX_LATENCY_S
        )
        hold_s = parse_number("options.hold_s", document.get("hold_s", HOLD_S), 0.0, 10.0)
        person_frames = parse_integer(
            "options.person_frames", document.get("person_frames", PERSON_FRAMES), 1, PERSON_WINDOW
        )
        return cls(
            size_px=(round(width_px), round(height_px)),
            hold_s=hold_s,
            braking=switches["braking"] is True,
            person_frames=person_frames,
            latency_s=latency_s,
            pitch=switches["pitch"] is True,
        )


_OBSTACLES: Final = {"novelty": "a fallen tree", "anomaly": "an overturned vehicle"}


def describe_street(scenario: Mapping[str, Json]) -> str:
    """Describe a scenario, such as ``night, wet cloudy, pedestrian from behind a van after 52 m``."""
    crossing_m = scenario.get("crossing_m")
    way = f" after {crossing_m:.0f} m" if isinstance(crossing_m, int | float) else ""
    words = (
        f"{scenario.get('time_of_day')}, {str(scenario.get('weather')).replace('_', ' ')}, "
        f"pedestrian from behind a {scenario.get('occluder')}{way}"
    )
    obstacle = str(scenario.get("obstacle", "none"))
    return f"{words}, {_OBSTACLES[obstacle]} on the road" if obstacle in _OBSTACLES else words


def describe_perturbations(steps: Sequence[Mapping[str, Json]]) -> str:
    """Describe perturbations in order, such as ``snow 3/5, then brightness 10/10``; empty if there are none.

    Args:
        steps: Each ``{"gene": name, "level": index}``; steps at level 0 are left out.
    """
    words = []
    for step in steps:
        gene = str(step.get("gene"))
        if step.get("level"):
            most = f"/{CATALOGUE[gene].levels - 1}" if gene in CATALOGUE else ""
            words.append(f"{gene.replace('_', ' ')} {step['level']}{most}")
    return ", then ".join(words)
