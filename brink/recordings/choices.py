"""What users choose about a recording: cheap to import."""

import pkgutil
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from brink.recordings import formats

if TYPE_CHECKING:
    from brink.recordings.recording import RoadUser
    from brink.sim.driving.camera import Camera
    from brink.sim.driving.interface import Box

TYPES: Final = ("misses", "delays", "places", "labels", "ghosts")
"""Types of errors that can be left out of a fit."""


def format_names() -> list[str]:
    """Return the names of all formats: those of the modules of `brink.recordings.formats`."""
    return sorted(one.name.removesuffix("_format") for one in pkgutil.iter_modules(formats.__path__))


@dataclass(frozen=True, slots=True, kw_only=True)
class Visibility:
    """From when a true road user is visible enough for a detector to be expected to report it.

    Its box must also be as large as the driving system's camera needs, which is 3 by 6 px in an image of 800 by 600
    px with a field of view of 90 degrees.

    Attributes:
        most_occlusion: Largest occlusion flag that counts as visible.
        least_share: Smallest visible share, of what hides it and of the image's edge alike.
    """

    most_occlusion: int = 1
    least_share: float = 0.25

    def holds(self, user: "RoadUser", box: "Box", camera: "Camera") -> bool:
        """Return whether a road user with a box in the driving system's image is visible."""
        return (
            (user.occlusion is None or user.occlusion <= self.most_occlusion)
            and (user.visible_share is None or user.visible_share >= self.least_share)
            and (user.truncation is None or 1.0 - user.truncation >= self.least_share)
            and box.x_max_px - box.x_min_px >= camera.min_width_px
            and box.y_max_px - box.y_min_px >= camera.min_height_px
        )

    @property
    def words(self) -> str:
        """The visibility rule in words."""
        return (
            f"at least {self.least_share:.0%} of it in sight, occlusion flag at most {self.most_occlusion}, large "
            "enough for the driving system's camera"
        )
