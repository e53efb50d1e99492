"""`no-collision`: the ego hits no vehicle, no pedestrian and no object."""

from collections.abc import Mapping

from brink.sim.episode import Json
from brink.sim.requirements.margin import Margin
from brink.sim.requirements.requirement import Collision, WorldSample

_CONTACT_M = 0.01
"""A collision violates by at least this, or a touch at walking pace would count as satisfied."""


class NoCollision(Margin):
    """Robustness: the clearance to the nearest body in metres; on a collision, how far the bodies would have gone on.

    After a collision at closing speed v the robustness is -(0.01 + v * 0.1 s) m, so that a harder impact is a
    deeper violation.
    """

    unit = "m"
    horizon = 20.0

    def __init__(self) -> None:
        super().__init__()
        self._collision: Collision | None = None

    def robustness_at(self, sample: WorldSample) -> float:
        """Return the clearance to the nearest body, or the depth of the collision."""
        collision = sample.collision
        if collision is not None:
            if self._collision is None:
                self._collision = collision
            return -(_CONTACT_M + 0.1 * collision.impact_speed_mps)
        gap_m = sample.nearest_gap_m
        return self.horizon if gap_m is None else max(gap_m, 0.0)

    def features(self) -> Mapping[str, Json]:
        """Return what was hit first, and at which closing speed; None where nothing was."""
        collision = self._collision
        if collision is None:
            return {"collision_with": None, "collision_kind": None, "impact_speed_mps": None}
        return {
            "collision_with": collision.counterpart,
            "collision_kind": collision.kind.value,
            "impact_speed_mps": collision.impact_speed_mps,
        }
