"""The change between two candidates of `urban-injected@1` in words: what the detector reports, when, and where.

Only what comes before the violation can have caused it, so only that is described. The driving system infers from a
box how far away something is, how far to the side, how wide and how tall (`brink.sim.driving.obstacles`). Changes of
a box's edges are given in these metres.
Boxes are compared at a time at which both drives run and report them, the one at which they differ most.
"""

from collections.abc import Collection, Mapping, Sequence
from typing import Any, Final, NamedTuple

from brink.sim.driving.camera import Camera
from brink.sim.driving.interface import PERCEPTION_STEP_S, Box, ObstacleLabel
from brink.sim.driving.obstacles import depth_m
from brink.sim.driving.settings import LocalisationSettings
from brink.sim.urban import behaviour as b

_CAMERA: Final = Camera()
_LOCALISATION: Final = LocalisationSettings()
_LEAST_PX: Final = 0.05
"""Smaller changes of an edge are left out."""
_MOMENTS: Final = 30
"""Parts of the time in which both drives report something, at whose ends distances are compared."""
_MUCH_FARTHER: Final = 1.2
"""A change of distance by this factor is worth describing."""
_LEAST_M: Final = 0.005
"""Smaller changes of a distance would be shown as no change."""
_MINOR: Final = 0.2
"""A change of an edge or of the size is left out if it is smaller than this share of the other one."""
_SCENARIO: Final = {
    "time_of_day": "the time of day is {0} instead of {1}",
    "weather": "the weather is {0} instead of {1}",
    "pedestrians": "there are {0} pedestrians instead of {1}",
    "road_curve": "the road is {0} instead of {1}",
    "road_id": "it is road {0} instead of road {1}",
    "road_length": "the road has length {0} instead of {1}",
    "driving_task": "the task is {0} instead of {1}",
}
_MOST_LETTERS: Final = 90
"""In a longer description, only what differs most is described, and the rest is counted."""
_ABSENT_PX: Final = float(b.IMAGE_WIDTH_PX)
"""A report that only one drive has at a time counts as a difference of the whole image."""
_PX_PER_STEP: Final = 8.0
"""How much a step in which one drive alone reports something counts: ten seconds as much as the whole image."""
_ORDINALS = ("first", "second", "third", "fourth", "fifth", "sixth")
AFTERWARDS: Final = "all that differs came after the violation"


class _Clause(NamedTuple):
    """A part of a description.

    Attributes:
        text: The words.
        px: How much differs.
        more: Differences that the words leave out.
    """

    text: str
    px: float = _ABSENT_PX
    more: int = 0


def words_of_changes(
    safe: Mapping[str, Mapping[str, Any]],
    unsafe: Mapping[str, Mapping[str, Any]],
    changed: Collection[str],
    violated_at_s: float | None,
    *,
    ended_at_step: float = float("inf"),
    unsafe_ended_at_step: float | None = None,
) -> str:
    """Describe the differences of the unsafe candidate from the safe one; empty if no value differs visibly.

    Args:
        safe: Decoded parameters of the safe candidate, by component and name.
        unsafe: The same of the unsafe one.
        changed: The parameters in which they differ, as component.parameter.
        violated_at_s: Time of the violation in the unsafe candidate's drive; None if it is unknown.
        ended_at_step: Perception step at which the shorter drive ended, if it is known.
        unsafe_ended_at_step: Perception step at which the unsafe drive ended; None if it is unknown.
    """
    parts = [_Clause(words) for words in scenario_changes(safe["scenario"], unsafe["scenario"], changed)]
    late = False
    for number in b.trajectory_numbers(unsafe["behaviour"]):
        prefix = f"behaviour.trajectory_{number}."
        names = frozenset(one.removeprefix(prefix) for one in changed if one.startswith(prefix))
        if names:
            both = _Reports(
                number,
                safe["behaviour"],
                unsafe["behaviour"],
                names,
                violated_at_s,
                ended_at_step,
                unsafe_ended_at_step,
            )
            parts += both.clauses()
            late = late or both.come_after
    return _description(parts) or (AFTERWARDS if late else "")


def scenario_changes(
    safe: Mapping[str, Any], unsafe: Mapping[str, Any], changed: Collection[str]
) -> list[str]:
    """Describe the differences of the unsafe scenario from the safe one, one part for each parameter.

    Args:
        safe: Decoded parameters of the safe scenario, by name.
        unsafe: The same of the unsafe one.
        changed: The parameters in which the candidates differ, as component.parameter.
    """
    return [
        template.format(_plain(unsafe[name]), _plain(safe[name]))
        for name, template in _SCENARIO.items()
        if f"scenario.{name}" in changed
    ]


def _description(parts: Sequence[_Clause]) -> str:
    """Join all parts into a sentence or, if that would be long, the largest differences and a count of the others."""
    if not parts:
        return ""
    whole = "; ".join(part.text for part in parts)
    if len(parts) > 1 and (len(whole) > _MOST_LETTERS or any(part.more for part in parts)):
        most = max(parts, key=lambda part: part.px)
        return _and_more(most.text, len(parts) - 1 + sum(part.more for part in parts))
    return _and_more(whole, parts[0].more)


def _and_more(words: str, more: int) -> str:
    if not more:
        return words
    return f"{words}, and {more} more {'difference' if more == 1 else 'differences'}"


class _Reports:
    """One injected trajectory in both drives of a pair.

    Args:
        number: Its number.
        safe: All values of the behaviour of the safe candidate.
        unsafe: The same of the unsafe one.
        changed: The names, without its number, of the values in which they differ.
        violated_at_s: Time of the violation in the unsafe drive; None if it is unknown.
        ended_at_step: Perception step at which the shorter drive ended; infinity if it is unknown.
        unsafe_ended_at_step: Perception step at which the unsafe drive ended; None if it is unknown.
    """

    def __init__(
        self,
        number: int,
        safe: Mapping[str, Any],
        unsafe: Mapping[str, Any],
        changed: frozenset[str],
        violated_at_s: float | None,
        ended_at_step: float,
        unsafe_ended_at_step: float | None,
    ) -> None:
        prefix = f"trajectory_{number}."
        self._old, self._new = (
            {name: values[prefix + name] for name in b.TRAJECTORY_FIELDS} for values in (safe, unsafe)
        )
        self._changed = changed
        self._others = tuple(_others(number, values) for values in (safe, unsafe))
        end_s = float("inf") if violated_at_s is None else violated_at_s
        self._end_step = end_s / PERCEPTION_STEP_S
        self._last_step = min(self._end_step, ended_at_step)
        self._unsafe_ended_at_step = unsafe_ended_at_step
        self._who = self._name(number, safe)

    @property
    def come_after(self) -> bool:
        """Whether the trajectory begins after the violation in both drives."""
        return not self._is_seen(self._old) and not self._is_seen(self._new)

    def clauses(self) -> list[_Clause]:
        """Return the changes that come before the violation."""
        old, new = self._old, self._new
        if self.come_after:
            return []
        if not self._is_seen(new):
            return [_Clause(self._vanished())]
        if not self._is_seen(old):
            return [_Clause(self._appeared())]
        parts = []
        if "label" in self._changed:
            parts.append(
                _Clause(f"a {new['label']} is reported instead of a {old['label']} from {_seconds(new)}")
            )
        return [*parts, *self._times(), *self._boxes()]

    def _name(self, number: int, safe: Mapping[str, Any]) -> str:
        """Return what the trajectory reports, such as ``the reported person``, distinguished from similar ones."""
        label = self._new["label"]
        if label == b.NULL_LABEL:
            label = safe[f"trajectory_{number}.label"]
        same = [other for other in self._others[1] if other["label"] == label and self._is_seen(other)]
        if not same or not self._is_seen(self._new):
            return f"the reported {label}"
        earlier = sum(
            (trajectory["t0_step"], trajectory["number"]) < (self._new["t0_step"], number)
            for trajectory in same
        )
        return f"the {_ORDINALS[earlier]} reported {label}"

    def _vanished(self) -> str:
        """Describe a report of the safe drive that the unsafe one lacks, or has only after its violation."""
        label, seconds = self._old["label"], _seconds(self._old)
        second = self._among(self._others[1], label, self._end_step)
        ended = self._unsafe_ended_at_step
        if self._new["label"] == label and ended is not None and self._new["t0_step"] <= ended:
            times = f"{_s(self._new['t0_step'])} s instead of {_s(self._old['t0_step'])} s"
            return f"a {second}{label} is reported only after the violation, from {times}"
        known = ended is not None or self._end_step == float("inf")
        until_step = float("inf") if ended is None else ended + 1
        later = not second and bool(self._among(self._others[1], label, until_step))
        never = known and not later
        when = "" if never else " up to the violation"
        return f"no {second}{label} is reported{when}; in the safe drive, one is from {seconds}"

    def _appeared(self) -> str:
        """Describe a report before the violation that the safe drive lacks, or has only later."""
        label, seconds = self._new["label"], _seconds(self._new)
        later = self._old["label"] == label
        until_step = self._old["t0_step"] if later else float("inf")
        second = self._among(self._others[0], label, until_step)
        when = f"only from {_s(self._old['t0_step'])} s" if later else f"no {second}{label} is"
        return f"a {second}{label} is reported from {seconds}; in the safe drive, {when}"

    @staticmethod
    def _among(others: Sequence[Mapping[str, Any]], label: str, until_step: float) -> str:
        """Return the ordinal of a trajectory among those of its label, such as ``second`` followed by a space.

        Empty if no other trajectory of the drive has the label and begins before the step.
        """
        before = sum(other["label"] == label and other["t0_step"] < until_step for other in others)
        return f"{_ORDINALS[before]} " if before else ""

    def _is_seen(self, values: Mapping[str, Any]) -> bool:
        return bool(values["label"] != b.NULL_LABEL and values["t0_step"] < self._end_step)

    @property
    def _lasts(self) -> bool:
        """Whether it lasts beyond the violation in both drives."""
        return bool(min(self._old["t1_step"], self._new["t1_step"]) >= self._end_step)

    def _times(self) -> list[_Clause]:
        old, new = self._old, self._new
        times, steps = [], 0.0
        if "t0_step" in self._changed:
            times.append(f"from {_s(new['t0_step'])} s instead of {_s(old['t0_step'])} s")
            steps += abs(new["t0_step"] - old["t0_step"])
        if "t1_step" in self._changed and not self._lasts:
            times.append(f"until {_s(new['t1_step'])} s instead of {_s(old['t1_step'])} s")
            steps += abs(new["t1_step"] - old["t1_step"])
        if times:
            whom = self._who.replace("the reported", "a").replace("reported ", "")
            return [_Clause(f"{whom} is reported {' and '.join(times)}", steps * _PX_PER_STEP)]
        if "t1_step" in self._changed:
            pace = "more slowly" if new["t1_step"] > old["t1_step"] else "faster"
            return [_Clause(f"{self._who} moves {pace} through the image", 0.0)]
        return []

    def _boxes(self) -> list[_Clause]:
        """Describe how the boxes differ at the time of their largest difference."""
        if not any(name.endswith("_px") for name in self._changed):
            return []
        first = max(self._old["t0_step"], self._new["t0_step"])
        last = min(self._old["t1_step"], self._new["t1_step"], self._last_step)
        if last < first:
            return []
        step = self._moment(first, last)
        moves = self._moves(step)
        if not moves:
            return []
        when = f"(at {_s(step)} s)"
        text = f"{self._who} {' and '.join(move.text for move in moves)} {when}"
        if len(moves) == 1 or len(text) <= _MOST_LETTERS:
            return [_Clause(text, _largest(moves))]
        most = max(moves, key=lambda move: move.px)
        return [_Clause(f"{self._who} {most.text} {when}", most.px, len(moves) - 1)]

    def _moment(self, first: float, last: float) -> float:
        """Return the step at which the boxes differ most.

        That is the first or the last one. But a box above the horizon, whose distance its height tells, may be as far
        away as one whose lower edge tells it, and not when it has moved.
        """
        step = max((first, last), key=self._difference)
        edges = {"y_min_0_px", "y_min_1_px", "y_max_0_px", "y_max_1_px"}
        if not self._changed & edges or self._times_as_far(step) >= _MUCH_FARTHER:
            return step
        between = (float(round(first + (last - first) * part / _MOMENTS)) for part in range(1, _MOMENTS))
        other = max((step, *between), key=self._times_as_far)
        return other if self._times_as_far(other) >= _MUCH_FARTHER else step

    def _difference(self, step: float) -> float:
        return _largest(self._moves(step))

    def _times_as_far(self, step: float) -> float:
        """Return the ratio of the larger to the smaller distance of both boxes at a step."""
        was, now = self._places(step)
        if was is None or now is None:
            return 1.0
        return max(now.ahead_m, was.ahead_m) / min(now.ahead_m, was.ahead_m)

    def _moves(self, step: float) -> list[_Clause]:
        """Describe how the box of the unsafe drive differs from that of the safe one at a step."""
        old, new = self._both(step)
        places = self._places(step)
        return [*_across(old, new, *places), *_upright(old, new, *places)]

    def _places(self, step: float) -> "tuple[_Place | None, _Place | None]":
        old, new = self._both(step)
        return _place(self._old["label"], old), _place(self._new["label"], new)

    def _both(self, step: float) -> tuple[dict[str, float], dict[str, float]]:
        """Return the boxes of both drives at a step."""
        old, new = (_box_at(values, step) for values in (self._old, self._new))
        for side in b.BOX_SIDES:
            if not self._changed & {f"{side}_0_px", f"{side}_1_px"}:
                new[side] = old[side]  # the two differ in their times alone
        return old, new


def _largest(moves: Sequence[_Clause]) -> float:
    return max((move.px for move in moves), default=0.0)


def _box_at(values: Mapping[str, Any], step: float) -> dict[str, float]:
    """Return the box of a trajectory at a step, by side."""
    start, end = values["t0_step"], values["t1_step"]
    share = 0.0 if end <= start else min(1.0, max(0.0, (step - start) / (end - start)))
    return {
        side: float(values[f"{side}_0_px"] + share * (values[f"{side}_1_px"] - values[f"{side}_0_px"]))
        for side in b.BOX_SIDES
    }


def _across(
    old: Mapping[str, float], new: Mapping[str, float], was: "_Place | None", now: "_Place | None"
) -> list[_Clause]:
    """Describe how the left and right edges differ."""
    left, right = (new[f"x_{side}"] - old[f"x_{side}"] for side in ("min", "max"))
    shift, growth = 0.5 * (left + right), right - left
    moved = abs(shift) >= max(_LEAST_PX, _MINOR * abs(growth))
    grown = abs(growth) >= max(_LEAST_PX, _MINOR * abs(shift))
    if not moved and not grown:
        return []
    px = max(abs(shift) if moved else 0.0, abs(growth) if grown else 0.0)
    if was is None or now is None:
        return [_Clause("is elsewhere in the image", px)]
    if moved and grown:
        return [_Clause(_span(was, now), px)]
    if moved:
        return [_Clause(f"is {_aside(was, now)}", px)]
    old_m, new_m = _different(*(one.left_m - one.right_m for one in (was, now)))
    return [_Clause(f"is {new_m} m wide instead of {old_m} m", px)]


def _upright(
    old: Mapping[str, float], new: Mapping[str, float], was: "_Place | None", now: "_Place | None"
) -> list[_Clause]:
    """Describe how the upper and lower edges differ, which determine distance and height."""
    upper, lower = (new[f"y_{side}"] - old[f"y_{side}"] for side in ("min", "max"))
    lowered = abs(lower) >= max(_LEAST_PX, _MINOR * abs(upper))
    raised = abs(upper) >= max(_LEAST_PX, _MINOR * abs(lower))
    if not lowered and not raised:
        return []
    if was is None or now is None:
        return [_Clause("is elsewhere in the image", max(abs(lower), abs(upper)))]
    clauses = []
    if abs(now.ahead_m - was.ahead_m) >= _LEAST_M:
        old_m, new_m = _different(was.ahead_m, now.ahead_m)
        clauses.append(
            _Clause(f"is {new_m} m ahead instead of {old_m} m", abs(lower) if lowered else abs(upper))
        )
    elif lowered:
        clauses.append(_Clause(f"is {'lower' if lower > 0 else 'higher'} in the image", abs(lower)))
    if raised and was.by_lower_edge and now.by_lower_edge:
        old_m, new_m = _different(was.tall_m, now.tall_m)
        # The height tells the driving system nothing where the lower edge tells the distance.
        clauses.append(_Clause(f"is {new_m} m tall instead of {old_m} m", 0.0))
    return clauses


def _others(number: int, behaviour: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the numbers and values of the other trajectories of a drive, without the prefixes of their names."""
    return [
        {"number": one, **{name: behaviour[f"trajectory_{one}.{name}"] for name in b.TRAJECTORY_FIELDS}}
        for one in b.trajectory_numbers(behaviour)
        if one != number
    ]


class _Place(NamedTuple):
    """Where the driving system locates a box.

    Attributes:
        ahead_m: Distance ahead of the camera.
        left_m: How far left of straight ahead its left end is.
        right_m: The same of its right end.
        middle_m: The same of its middle.
        tall_m: Its height.
        by_lower_edge: Whether the lower edge tells the distance; otherwise the height does.
    """

    ahead_m: float
    left_m: float
    right_m: float
    middle_m: float
    tall_m: float
    by_lower_edge: bool

    def reach(self, digits: int) -> str:
        """Return the range that it covers."""
        if self.right_m >= 0:
            return f"{self.right_m:.{digits}f} to {self.left_m:.{digits}f} m left"
        if self.left_m <= 0:
            return f"{-self.left_m:.{digits}f} to {-self.right_m:.{digits}f} m right"
        return f"{self.left_m:.{digits}f} m left to {-self.right_m:.{digits}f} m right"


def _place(label: str, box: Mapping[str, float]) -> _Place | None:
    """Return where the driving system locates a box; None if it ignores the box."""
    found = Box(ObstacleLabel(label), box["x_min"], box["x_max"], box["y_min"], box["y_max"])
    ahead_m = depth_m(found, _CAMERA, _LOCALISATION)
    if ahead_m is None:
        return None
    ground_m = _CAMERA.ground_depth_m(found.y_max_px)
    return _Place(
        ahead_m=ahead_m,
        left_m=_CAMERA.left_m(found.x_min_px, ahead_m),
        right_m=_CAMERA.left_m(found.x_max_px, ahead_m),
        middle_m=_CAMERA.left_m(0.5 * (found.x_min_px + found.x_max_px), ahead_m),
        tall_m=(found.y_max_px - found.y_min_px) * ahead_m / _CAMERA.focal_px,
        by_lower_edge=ground_m is not None and ground_m <= _LOCALISATION.max_ground_range_m,
    )


def _aside(old: _Place, new: _Place) -> str:
    """Describe how far to the side the middle of each box is."""
    lefts = old.middle_m, new.middle_m
    sides = ["left" if left > 0 else "right" for left in lefts]
    same_side = sides[0] == sides[1]
    old_m, new_m = _different(*map(abs, lefts), alike=same_side)
    was = f"{old_m} m" if same_side else f"{old_m} m {sides[0]}"
    return f"{new_m} m {sides[1]} of straight ahead instead of {was}"


def _span(old: _Place, new: _Place) -> str:
    """Describe the range that each box covers."""
    digits = 2 if old.reach(1) == new.reach(1) else 1
    return f"spans {new.reach(digits)} of straight ahead instead of {old.reach(digits)}"


def _different(first: float, second: float, *, alike: bool = True) -> tuple[str, str]:
    """Return two lengths with one decimal, or with two if they are `alike` otherwise and equal with one."""
    digits = 2 if alike and f"{first:.1f}" == f"{second:.1f}" else 1
    return f"{first:.{digits}f}", f"{second:.{digits}f}"


def _seconds(values: Mapping[str, Any]) -> str:
    return f"{_s(values['t0_step'])} to {_s(values['t1_step'])} s"


def _s(step: float) -> str:
    return f"{step * PERCEPTION_STEP_S:.1f}"


def _plain(word: Any) -> str:
    return str(word).replace("_", " ")
