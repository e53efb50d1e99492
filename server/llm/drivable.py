"""Whether the road has room for a solution: it passes the search's own repair, which may hardly change it.

Small clips are fine: somebody half a metre off the lane's middle is put on it. A start that must move farther, a
heading or an action that must change, somebody for whom there is no room: the solution is physically impossible, and
is refused rather than turned into another one.
"""

import math
from typing import Final

import numpy as np

from brink.search.traffic.constraint import ALONG_M, Participants, participants_component
from brink.search.traffic.participants import SIZES_M, Kind, Participant, RoadLimits, Solution
from brink.server.errors import FieldError
from brink.server.llm.form import Heading, heading_of

TOLERANCE_M: Final = 3.0
"""A start may be moved so far."""


def apart_m(kind: Kind) -> float:
    """Return how far apart two of a kind start on the same lane, from middle to middle."""
    return SIZES_M[kind][0] + ALONG_M


def kept_clear_m(kind: Kind, road: RoadLimits) -> tuple[float, float]:
    """Return the stations between which the middle of nobody of a kind starts on the ego's lane."""
    return -road.clear_behind_m - 0.5 * apart_m(kind), road.clear_ahead_m + 0.5 * apart_m(kind)


class Drivable:
    """Places solutions on a road.

    Args:
        road: Where participants are.
        most: How many there may be.
    """

    def __init__(self, road: RoadLimits, most: int) -> None:
        self.road = road
        self.most = most
        self._rule = Participants(most, road)
        self._component = participants_component("participants", most, road)

    def problems(self, solution: Solution) -> list[str]:
        """Return what the rule has against a solution; nothing if it complies."""
        return list(self._component.problems(self._rule.encode(solution)))

    def placed(self, solution: Solution, pointer: str) -> Solution | list[FieldError]:
        """Return the solution as the road has it, or why the road has no room for it.

        Args:
            solution: At most ``most`` participants, with actions that fit them.
            pointer: JSON pointer to it.
        """
        mended = self._mended(solution)
        if len(mended) < len(solution):
            return [self._no_room(solution, pointer)]
        errors = [
            error
            for place, (wanted, got) in enumerate(zip(solution, mended, strict=True))
            if (error := self._moved(wanted, got, f"{pointer}/participants/{place}"))
        ]
        return errors or mended

    def _mended(self, solution: Solution) -> Solution:
        # Nothing is left open that repair would have to draw; the generator only completes the call.
        rng = np.random.default_rng(0)
        return self._rule.decode(self._component.repair(self._rule.encode(solution), rng))

    def _no_room(self, solution: Solution, pointer: str) -> FieldError:
        """Return the error for the first participant for whom there is no room."""
        place = next(
            count - 1 for count in range(1, len(solution) + 1) if len(self._mended(solution[:count])) < count
        )
        message = "physically impossible: expected a place that nobody else has, found none near"
        return FieldError(pointer=f"{pointer}/participants/{place}", message=message)

    def _moved(self, wanted: Participant, got: Participant, pointer: str) -> FieldError | None:
        heading = heading_of(got.dyaw_rad)
        along_m, aside_m = got.ds_m - wanted.ds_m, got.dd_m - wanted.dd_m
        nearest = (
            f"the nearest start for this {wanted.kind} is ds_m {got.ds_m:.1f}, dd_m {got.dd_m:.1f}, {heading}"
        )
        if heading is not heading_of(wanted.dyaw_rad):
            message = f"physically impossible: {self._why_heading(wanted)}; {nearest}"
            return FieldError(pointer=f"{pointer}/heading", message=message)
        if math.hypot(along_m, aside_m) > TOLERANCE_M:
            name = "ds_m" if abs(along_m) >= abs(aside_m) else "dd_m"
            message = f"physically impossible: {self._why_start(wanted)}; {nearest}"
            return FieldError(pointer=f"{pointer}/{name}", message=message)
        if [gene.action for gene in got.genes] != [gene.action for gene in wanted.genes]:
            message = f"physically impossible: expected actions that a {wanted.kind} can do"
            return FieldError(pointer=f"{pointer}/actions", message=message)
        return None

    def _why_heading(self, wanted: Participant) -> str:
        on_road = self.road.on_carriageway(wanted.dd_m)
        if heading_of(wanted.dyaw_rad) is Heading.ACROSS:
            return "expected across only in a crossing street, off the carriageway"
        if on_road:
            return "expected nobody to start against the traffic on the ego's own lane"
        return "expected across off the carriageway, where vehicles wait in a crossing street"

    def _why_start(self, wanted: Participant) -> str:
        road = self.road
        if wanted.kind is Kind.PEDESTRIAN:
            return "expected a start on a pavement"
        if heading_of(wanted.dyaw_rad) is Heading.ACROSS:
            return "expected a start in a crossing street, on the lane that leads to the road"
        if not road.on_carriageway(wanted.dd_m):
            return "expected a start on a lane"
        low_m, high_m = kept_clear_m(wanted.kind, road)
        return (
            f"expected a lane's middle, {apart_m(wanted.kind):g} m to others on that lane, and no {wanted.kind} on "
            f"the ego's own lane from ds_m {low_m:g} to {high_m:g}"
        )
