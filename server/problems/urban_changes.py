"""The change between two candidates of `urban-injected@1` in words: what the detector reports, when, and where.

Only what comes before the violation can have caused it, so only that is described. A box tells the driving system how
far away something is by its lower edge, and where in the road by its left and right edges
(`brink.sim.driving.obstacles`). A change of the lower edge is therefore given in metres where these are trusted.
"""

from collections.abc import Collection, Mapping, Sequence
from typing import Any, Final

from brink.sim.driving.camera import Camera
from brink.sim.driving.settings import LocalisationSettings
from brink.sim.urban import behaviour as b

_CAMERA: Final = Camera()
_TRUSTED_M: Final = LocalisationSettings().max_ground_range_m
_LEAST_PX: Final = 0.05
"""Smaller changes would be shown as 0.0 px."""
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
AFTERWARDS: Final = "what differs came after the violation"


def words_of_changes(
    safe: Mapping[str, Mapping[str, Any]],
    unsafe: Mapping[str, Mapping[str, Any]],
    changed: Collection[str],
    violated_at_s: float | None,
) -> str:
    """Describe what is different in the unsafe one of two candidates; empty if no value differs visibly.

    Args:
        safe: Decoded parameters of the safe candidate, by component and name.
        unsafe: The same of the unsafe one.
        changed: The parameters in which they differ, as component.parameter.
        violated_at_s: Time of the violation in the unsafe candidate's drive; None if it is unknown.
    """
    parts = [
        template.format(_plain(unsafe["scenario"][name]), _plain(safe["scenario"][name]))
        for name, template in _SCENARIO.items()
        if f"scenario.{name}" in changed
    ]
    late = False
    for number in range(1, b.TRAJECTORY_COUNT + 1):
        prefix = f"behaviour.trajectory_{number}."
        names = frozenset(one.removeprefix(prefix) for one in changed if one.startswith(prefix))
        if names:
            both = _Reports(number, safe["behaviour"], unsafe["behaviour"], names, violated_at_s)
            parts += both.words()
            late = late or both.come_after
    return "; ".join(parts) or (AFTERWARDS if late else "")


class _Reports:
    """One injected trajectory in both drives of a pair.

    Args:
        number: Its number.
        safe: All values of the behaviour of the safe candidate.
        unsafe: The same of the unsafe one.
        changed: The names, without its number, of the values in which they differ.
        violated_at_s: Time of the violation in the unsafe drive; None if it is unknown.
    """

    def __init__(
        self,
        number: int,
        safe: Mapping[str, Any],
        unsafe: Mapping[str, Any],
        changed: Collection[str],
        violated_at_s: float | None,
    ) -> None:
        prefix = f"trajectory_{number}."
        self._old, self._new = (
            {name: values[prefix + name] for name in b.TRAJECTORY_FIELDS} for values in (safe, unsafe)
        )
        self._changed = changed
        self._others = tuple(_others(number, values) for values in (safe, unsafe))
        end_s = float("inf") if violated_at_s is None else violated_at_s
        self._end_step = end_s / b.PERCEPTION_STEP_S
        self._at = "before the violation" if violated_at_s is None else f"before {violated_at_s:.1f} s"
        self._who = _who(number, safe, unsafe)

    @property
    def come_after(self) -> bool:
        """Whether the trajectory begins after the violation in both drives."""
        return not self._is_seen(self._old) and not self._is_seen(self._new)

    def words(self) -> list[str]:
        """Return the changes that come before the violation, each as a clause."""
        old, new = self._old, self._new
        if self.come_after:
            return []
        if not self._is_seen(new):
            return [self._vanished()]
        if not self._is_seen(old):
            return [self._appeared()]
        clauses = []
        if "label" in self._changed:
            clauses.append(f"a {new['label']} is reported instead of a {old['label']} from {_seconds(new)}")
        return [*clauses, *self._times(), *self._boxes()]

    def _vanished(self) -> str:
        """Say that what the safe drive reports is not reported before the violation."""
        label, seconds = self._old["label"], _seconds(self._old)
        if self._reports_other(self._others[1], label, self._end_step):
            return f"no second {label} is reported {self._at}; in the safe drive one is, from {seconds}"
        return f"no {label} is reported {self._at}; in the safe drive one is, from {seconds}"

    def _appeared(self) -> str:
        """Say that what is reported before the violation is not reported in the safe drive, or only later."""
        label, seconds = self._new["label"], _seconds(self._new)
        later = self._old["label"] == label
        before = f"before {_s(self._old['t0_step'])} s" if later else ""
        until_step = self._old["t0_step"] if later else float("inf")
        if self._reports_other(self._others[0], label, until_step):
            when = f"not {before}" if later else "not at all"
            return f"a second {label} is reported from {seconds}; in the safe drive {when}"
        return f"a {label} is reported from {seconds}; in the safe drive none {before}".rstrip()

    @staticmethod
    def _reports_other(others: Sequence[Mapping[str, Any]], label: str, until_step: float) -> bool:
        """Return whether another trajectory of a drive has a label and begins before a step."""
        return any(one["label"] == label and one["t0_step"] < until_step for one in others)

    def _is_seen(self, values: Mapping[str, Any]) -> bool:
        return bool(values["label"] != b.NULL_LABEL and values["t0_step"] < self._end_step)

    @property
    def _lasts(self) -> bool:
        """Whether it lasts beyond the violation in both drives."""
        return bool(min(self._old["t1_step"], self._new["t1_step"]) >= self._end_step)

    def _times(self) -> list[str]:
        old, new = self._old, self._new
        times = []
        if "t0_step" in self._changed:
            times.append(f"from {_s(new['t0_step'])} s instead of {_s(old['t0_step'])} s")
        if "t1_step" in self._changed and not self._lasts:
            times.append(f"until {_s(new['t1_step'])} s instead of {_s(old['t1_step'])} s")
        if times:
            return [f"{self._who} is there {' and '.join(times)}"]
        if "t1_step" in self._changed:
            pace = "more slowly" if new["t1_step"] > old["t1_step"] else "faster"
            return [f"the box of {self._who} moves {pace} through the image"]
        return []

    def _boxes(self) -> list[str]:
        clauses = []
        for end, step, moment in ((0, "t0_step", "at first"), (1, "t1_step", "at last")):
            moved = [*self._across(end), *self._upright(end)]
            if moved:
                when = f"{moment}, at {_s(self._new[step])} s"
                if end == 1 and self._lasts:
                    when = f"where it is heading, at {_s(self._new[step])} s"
                clauses.append(f"the box of {self._who} is {' and '.join(moved)} ({when})")
        return clauses

    def _across(self, end: int) -> list[str]:
        """Return how the left and right edges changed."""
        left, right = (self._moved(f"x_{side}_{end}_px") for side in ("min", "max"))
        shift, growth = 0.5 * (left + right), right - left
        words = []
        if abs(shift) >= max(_LEAST_PX, _MINOR * abs(growth)):
            words.append(f"{_px(shift)} further {'right' if shift > 0 else 'left'}")
        if abs(growth) >= max(_LEAST_PX, _MINOR * abs(shift)):
            words.append(f"{_px(growth)} {'wider' if growth > 0 else 'narrower'}")
        return words

    def _upright(self, end: int) -> list[str]:
        """Return how the upper and lower edges changed."""
        upper, lower = (self._moved(f"y_{side}_{end}_px") for side in ("min", "max"))
        words = []
        if abs(lower) >= max(_LEAST_PX, _MINOR * abs(upper)):
            words.append(
                _distance(self._old[f"y_max_{end}_px"], self._new[f"y_max_{end}_px"])
                or f"{_px(lower)} {_way(lower)} at its lower edge"
            )
        if abs(upper) >= max(_LEAST_PX, _MINOR * abs(lower)):
            words.append(f"{_px(upper)} {_way(upper)} at its upper edge")
        return words

    def _moved(self, name: str) -> float:
        """Return by how many pixels an edge is further right or further down in the unsafe drive."""
        return float(self._new[name] - self._old[name]) if name in self._changed else 0.0


def _others(number: int, behaviour: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the values of the other trajectories of a drive, without the prefixes of their names."""
    return [
        {name: behaviour[f"trajectory_{one}.{name}"] for name in b.TRAJECTORY_FIELDS}
        for one in range(1, b.TRAJECTORY_COUNT + 1)
        if one != number
    ]


def _who(number: int, safe: Mapping[str, Any], unsafe: Mapping[str, Any]) -> str:
    """Return what a trajectory reports, such as ``the reported person``."""
    everyone: Sequence[int] = range(1, b.TRAJECTORY_COUNT + 1)
    labels = {one: unsafe[f"trajectory_{one}.label"] for one in everyone}
    label = labels[number]
    if label == b.NULL_LABEL:
        label = safe[f"trajectory_{number}.label"]
    same = [one for one in everyone if labels[one] == label]
    if len(same) < 2:
        return f"the reported {label}"
    first = min(same, key=lambda one: (unsafe[f"trajectory_{one}.t0_step"], one))
    return f"the {'first' if first == number else 'second'} reported {label}"


def _distance(old_px: float, new_px: float) -> str:
    """Return how far away two lower edges say that something is; empty if either is not trusted."""
    far = [_CAMERA.ground_depth_m(edge) for edge in (new_px, old_px)]
    new_m, old_m = (float("inf") if one is None else one for one in far)
    if max(new_m, old_m) > _TRUSTED_M:
        return ""
    digits = 1 if f"{new_m:.1f}" != f"{old_m:.1f}" else 2
    return f"{new_m:.{digits}f} m ahead instead of {old_m:.{digits}f} m by its lower edge"


def _px(change: float) -> str:
    return f"{abs(change):.{0 if abs(change) >= 10 else 1}f} px"


def _way(down: float) -> str:
    return "lower" if down > 0 else "higher"


def _seconds(values: Mapping[str, Any]) -> str:
    return f"{_s(values['t0_step'])} to {_s(values['t1_step'])} s"


def _s(step: float) -> str:
    return f"{step * b.PERCEPTION_STEP_S:.1f}"


def _plain(word: Any) -> str:
    return str(word).replace("_", " ")
