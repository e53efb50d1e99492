"""What the detector of an emergency-braking episode is and does, and the options of the episode."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Final, Self, TypeVar

from brink.sim.aeb.braking import HOLD_S
from brink.sim.episode import Json, nearest
from brink.sim.errors import InvalidEpisode
from brink.sim.perception.weights_file import weights_digest
from brink.sim.perturbations import Mode, Perturbation, PerturbationError, parse_perturbations
from brink.sim.urban.behaviour import DEFAULT_DURATION_S, DetectorBehaviour, InjectedTrajectory

SIZE_PX: Final = (640, 360)
THRESHOLD: Final = 0.5
DETECTOR: Final = "brink-det@1"

_Word = TypeVar("_Word", bound=StrEnum)


class SightMode(StrEnum):
    """What the brake is told."""

    ORACLE = "oracle"
    """Ground truth."""
    INJECTED = "injected"
    """Boxes that are made up, as in the urban problem; nothing is rendered."""
    BLIND = "blind"
    """Nothing."""
    DETECTOR = "detector"
    """What a detector finds in the camera's pictures, perturbed or not."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Behaviour:
    """What the brake is told, and through which perturbations.

    Attributes:
        mode: What the brake is told.
        detector: Id of the detector.
        threshold: Least score of a detection that the brake is told.
        perturbations: Of every picture, applied left to right.
        fields: Whether their random fields are drawn for each frame, or once.
        trajectories: Injected boxes.
        weights: Digest of a user's weights file, where the detector is one: nothing else may answer for it.
    """

    mode: SightMode
    detector: str = DETECTOR
    threshold: float = THRESHOLD
    perturbations: tuple[Perturbation, ...] = ()
    fields: Mode = Mode.PER_FRAME
    weights: str = ""
    trajectories: tuple[InjectedTrajectory, ...] = ()

    @classmethod
    def from_json(cls, document: Mapping[str, Json], duration_s: float = DEFAULT_DURATION_S) -> Self:
        """Read a behaviour from a JSON object.

        Args:
            document: Its fields; injected trajectories as the urban simulator takes them, in its image.
            duration_s: Length of the episode, which bounds trajectories.

        Raises:
            InvalidEpisode: A field is unknown or wrong.
        """
        mode = _word("behaviour.mode", document.get("mode"), tuple(SightMode))
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
        detector = document.get("detector", DETECTOR)
        if not isinstance(perturbations, list):
            raise InvalidEpisode(f"behaviour.perturbations: expected a list, got {perturbations!r}")
        if not isinstance(detector, str):
            raise InvalidEpisode(f"behaviour.detector: expected an id such as {DETECTOR}, got {detector!r}")
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
            threshold=_number("behaviour.threshold", document.get("threshold", THRESHOLD), 0.0, 1.0),
            perturbations=parsed,
            weights=weights,
            fields=_word("behaviour.fields", document.get("fields", Mode.PER_FRAME.value), tuple(Mode)),
        )


def check_weights(behaviour: Behaviour) -> None:
    """Raise InvalidEpisode if the weights file here is not the one that was asked for."""
    if behaviour.weights and behaviour.weights != weights_digest(behaviour.detector):
        raise InvalidEpisode(
            f"behaviour.detector: {behaviour.detector} here is not the file that the campaign was submitted with"
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Options:
    """How an episode is run.

    Attributes:
        size_px: Of the camera's picture.
        hold_s: How long the brake holds without a trigger.
        braking: Whether the brake works.
    """

    size_px: tuple[int, int] = SIZE_PX
    hold_s: float = HOLD_S
    braking: bool = True

    @classmethod
    def from_json(cls, document: Mapping[str, Json]) -> Self:
        """Read options from a JSON object.

        Raises:
            InvalidEpisode: A field is unknown or wrong.
        """
        known = ("width_px", "height_px", "hold_s", "braking")
        for name in document:
            if name not in known:
                raise InvalidEpisode(f"options: unknown field {name!r}{nearest(name, known)}")
        width_px = _number("options.width_px", document.get("width_px", SIZE_PX[0]), 64, 4096)
        height_px = _number("options.height_px", document.get("height_px", SIZE_PX[1]), 64, 4096)
        braking = document.get("braking", True)
        if not isinstance(braking, bool):
            raise InvalidEpisode(f"options.braking: expected true or false, got {braking!r}")
        hold_s = _number("options.hold_s", document.get("hold_s", HOLD_S), 0.0, 10.0)
        return cls(size_px=(round(width_px), round(height_px)), hold_s=hold_s, braking=braking)


def _number(where: str, value: Json, low: float, high: float) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
        raise InvalidEpisode(f"{where}: expected a number in [{low:g}, {high:g}], got {value!r}")
    return float(value)


def _word(where: str, value: Json, known: tuple[_Word, ...]) -> _Word:
    for word in known:
        if word.value == value:
            return word
    raise InvalidEpisode(
        f"{where}: expected one of {', '.join(known)}{nearest(value, tuple(known))}; got {value!r}"
    )
