"""The options of a drive: how faithfully the car and its perception are simulated."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Self

from brink.sim.driving.camera import LEAST_VISIBLE
from brink.sim.driving.interface import LATENCY_S
from brink.sim.driving_systems.command import OPTION as DRIVING
from brink.sim.episode import Json, nearest, parse_number
from brink.sim.errors import InvalidEpisode
from brink.sim.guard.option import OPTION as GUARD

BICYCLE, WHEELS = "bicycle", "wheels"
FIDELITIES: Final = (BICYCLE, WHEELS)
"""Motion model of the ego: kinematic bicycle with friction limits, or four wheels in the physics engine."""
MAX_LATENCY_S: Final = 1.0
CAMERA_OPTIONS: Final = ("latency_s", "pitch", "least_visible")
"""Options of every drive with a camera, also of encounters."""
_NAMES: Final = ("fidelity", *CAMERA_OPTIONS, GUARD, DRIVING)


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveOptions:
    """The options of a drive, apart from those that other modules read.

    Attributes:
        fidelity: Motion model of the ego, one of `FIDELITIES`.
        latency_s: Time from an image to the arrival of what was detected in it, in [0, `MAX_LATENCY_S`].
        pitch: Whether the camera pitches with the car's body.
        least_visible: Road users of which a smaller share is visible are hidden from the camera, in [0, 1].
    """

    fidelity: str = BICYCLE
    latency_s: float = LATENCY_S
    pitch: bool = True
    least_visible: float = LEAST_VISIBLE

    @classmethod
    def from_json(cls, document: Mapping[str, Json], names: tuple[str, ...] = _NAMES) -> Self:
        """Parse the options of an episode.

        Args:
            document: The options.
            names: All options that the episode may have, those that other modules read included.

        Raises:
            InvalidEpisode: There is an unknown option or a wrong value.
        """
        for name in document:
            if name not in names:
                raise InvalidEpisode(
                    f"options: unknown field {name!r}{nearest(name, names)}; expected {', '.join(names)}"
                )
        fidelity = document.get("fidelity", BICYCLE)
        if not isinstance(fidelity, str) or fidelity not in FIDELITIES:
            raise InvalidEpisode(
                f"options.fidelity: expected one of {', '.join(FIDELITIES)}; got {fidelity!r}"
            )
        pitch = document.get("pitch", True)
        if not isinstance(pitch, bool):
            raise InvalidEpisode(f"options.pitch: expected true or false, got {pitch!r:.80}")
        return cls(
            fidelity=fidelity,
            latency_s=parse_number(
                "options.latency_s", document.get("latency_s", LATENCY_S), 0.0, MAX_LATENCY_S
            ),
            pitch=pitch,
            least_visible=parse_number(
                "options.least_visible", document.get("least_visible", LEAST_VISIBLE), 0.0, 1.0
            ),
        )

    def to_json(self) -> dict[str, Json]:
        """Return the options as they stand in a specification."""
        return {
            "fidelity": self.fidelity,
            "latency_s": self.latency_s,
            "pitch": self.pitch,
            "least_visible": self.least_visible,
        }
