"""The change between two candidates of scripted traffic, in words for each road user."""

import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from brink.search.parameters import Parameter, Value
from brink.search.space import FloatArray
from brink.search.traffic.constraint import Participants
from brink.search.traffic.participants import NONE, Action, Kind, ParameterNames, magnitude_of
from brink.server.problems.changes import different, instead

MOST_TOLD: Final = 12
"""Differences beyond which two candidates are far apart: then their number comes first."""
_SHOWN: Final = 3
"""Changes that are described; the others are counted."""
_ORDINALS: Final = ("1st", "2nd", "3rd", "4th", "5th", "6th", "7th", "8th")
_DOING: Final = {
    Action.KEEP: "keeping its speed",
    Action.ACCELERATE: "accelerating",
    Action.DECELERATE: "slowing down",
    Action.BRAKE: "braking hard",
    Action.CHANGE_LEFT: "moving to its left",
    Action.CHANGE_RIGHT: "moving to its right",
    Action.CUT_IN: "cutting in",
    Action.CROSS: "crossing the road",
}
_AMOUNTS: Final = {
    Action.ACCELERATE: "accelerates at {} m/s² instead of {} m/s²",
    Action.DECELERATE: "slows down at {} m/s² instead of {} m/s²",
    Action.BRAKE: "brakes at {} m/s² instead of {} m/s²",
    Action.CHANGE_LEFT: "goes {} lane widths to its left instead of {}",
    Action.CHANGE_RIGHT: "goes {} lane widths to its right instead of {}",
    Action.CUT_IN: "cuts in while braking at {} m/s² instead of {} m/s²",
    Action.CROSS: "crosses at {} m/s instead of {} m/s",
}
"""How a change of an action's magnitude is described, for all actions that have one."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Change:
    """A change of one road user.

    Attributes:
        place: Place of the road user.
        who: The road user.
        words: What is different, following `who`, or following ``its`` if it is about an action.
        is_action: Whether it is about an action.
        size: The difference as a share of its range; 1 for a choice.
        parameters: Number of parameters that it stands for.
    """

    place: int
    who: str
    words: str
    is_action: bool = False
    size: float = 1.0
    parameters: int = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class _Sides:
    """One road user in the safe and in the unsafe candidate.

    Attributes:
        place: Its place.
        who: What it is called: by its kind, unless that is different, and its number.
        names: Names of its parameters.
        parameters: The parameters, by name.
        safe: Values in the safe candidate, by name.
        unsafe: Values in the unsafe candidate, by name.
        changed: Names of the parameters to describe.
    """

    place: int
    who: str
    names: ParameterNames
    parameters: dict[str, Parameter]
    safe: dict[str, float]
    unsafe: dict[str, float]
    changed: frozenset[str]

    def values(self, name: str) -> tuple[Value, Value]:
        """Return the decoded values of a parameter: the unsafe one, then the safe one."""
        decode = self.parameters[name].decode
        return decode(self.unsafe[name]), decode(self.safe[name])

    def size(self, name: str) -> float:
        """Return the difference of a number as a share of its range."""
        parameter = self.parameters[name]
        return abs(self.unsafe[name] - self.safe[name]) / getattr(parameter, "range", 1.0)

    def instead(self, name: str, unit: str) -> str:
        """Describe how the value of a parameter differs."""
        new, old = self.values(name)
        return instead(old, new, unit)

    def change(self, words: str, name: str = "", *, parameters: int = 1, is_action: bool = False) -> _Change:
        """Return a change of this road user; without the name of a number, it counts as a choice."""
        return _Change(
            place=self.place,
            who=self.who,
            words=words,
            size=self.size(name) if name else 1.0,
            parameters=parameters,
            is_action=is_action,
        )


def words_of_traffic_change(
    rule: Participants, safe: FloatArray, unsafe: FloatArray, changed: Collection[str]
) -> str:
    """Describe the largest differences of the unsafe candidate by road user, and count the others.

    Args:
        rule: How candidates are encoded.
        safe: The safe candidate.
        unsafe: The unsafe candidate.
        changed: Names of the parameters in which they differ that had a part in either episode.
    """
    changes = [change for sides in _sides(rule, safe, unsafe, changed) for change in _changes(sides)]
    told = sorted(changes, key=lambda change: -change.size)[:_SHOWN]
    total = sum(change.parameters for change in changes)
    more = total - sum(change.parameters for change in told)
    words = _by_road_user(told)
    if total > MOST_TOLD:
        users = len({change.place for change in changes})
        return f"{total} changes in {users} road user{'' if users == 1 else 's'}, the largest: {words}"
    return words + (f"; and {more} more change{'' if more == 1 else 's'}" if more else "")


def _by_road_user(changes: Sequence[_Change]) -> str:
    """Return changes in words; those of one road user together, such as ``car 1 starts …; its 4th …``."""
    groups: dict[int, list[_Change]] = {}
    for change in changes:
        groups.setdefault(change.place, []).append(change)
    clauses = []
    for group in groups.values():
        for place, change in enumerate(sorted(group, key=lambda change: change.is_action)):
            on_foot = change.who.startswith(Kind.PEDESTRIAN)
            who = change.who if not place else "the pedestrian" if on_foot else "it"
            whose = f"{change.who}'s" if not place else "their" if on_foot else "its"
            clauses.append(f"{whose if change.is_action else who} {change.words}")
    return "; ".join(clauses)


def _sides(
    rule: Participants, safe: FloatArray, unsafe: FloatArray, changed: Collection[str]
) -> Iterator[_Sides]:
    old, new = (dict(zip(rule.names, side.tolist(), strict=True)) for side in (safe, unsafe))
    for place, names in enumerate(rule.places, start=1):
        own = frozenset(changed).intersection(names.all)
        if not own:
            continue
        parameters = {parameter.name: parameter for parameter in names.parameters()}
        kinds = [str(parameters[names.kind].decode(side[names.kind])) for side in (new, old)]
        present = {kind for kind in kinds if kind != NONE}
        who = present.pop() if len(present) == 1 else "road user"
        yield _Sides(
            place=place,
            who=f"{who} {place}",
            names=names,
            parameters=parameters,
            safe=old,
            unsafe=new,
            changed=own,
        )


def _changes(sides: _Sides) -> Iterator[_Change]:
    """Yield the changes of a road user."""
    new, old = sides.values(sides.names.kind)
    if NONE in (new, old):
        yield sides.change("is not there" if new == NONE else "is added", parameters=len(sides.changed))
        return
    if new != old:
        yield sides.change(f"is a {new} instead of a {old}")
    along, across, heading, speed = sides.names.start
    if along in sides.changed:
        yield sides.change(f"starts {_apart(sides, along, 'ahead', 'behind')}", along)
    if across in sides.changed:
        yield sides.change(f"starts {_apart(sides, across, 'to the left', 'to the right')}", across)
    if heading in sides.changed:
        ways = [_way(float(value)) for value in sides.values(heading)]
        yield sides.change(f"heads {ways[0]} instead of {ways[1]}")
    if speed in sides.changed:
        yield sides.change(f"starts at {sides.instead(speed, 'm/s')}", speed)
    for ordinal, gene in zip(_ORDINALS, sides.names.genes, strict=True):
        yield from _changes_of_action(sides, ordinal, gene)


def _changes_of_action(sides: _Sides, ordinal: str, gene: tuple[str, str, str]) -> Iterator[_Change]:
    """Yield the changes of an action; another manoeuvre is one change together with its duration and magnitude."""
    choice, duration, magnitude = gene
    new, old = sides.values(choice)
    if choice in sides.changed:
        parameters = len(sides.changed.intersection(gene))
        words = f"{ordinal} action {_manoeuvre(str(new), str(old))}"
        yield sides.change(words, parameters=parameters, is_action=True)
        return
    if duration in sides.changed:
        words = f"{ordinal} action lasts {sides.instead(duration, 's')}"
        yield sides.change(words, duration, is_action=True)
    if magnitude in sides.changed:
        action = Action(str(new))
        amounts = [magnitude_of(action, float(share)) for share in sides.values(magnitude)]
        words = _AMOUNTS[action].format(*different(*amounts))
        yield sides.change(f"{ordinal} action {words}", magnitude, is_action=True)


def _manoeuvre(new: str, old: str) -> str:
    """Describe an action that is another one, or occurs in only one of two candidates."""
    if NONE in (new, old):
        action, what = (old, "is left out") if new == NONE else (new, "is added")
        return f"({_DOING[Action(action)]}) {what}"
    return f"is {_DOING[Action(new)]} instead of {_DOING[Action(old)]}"


def _apart(sides: _Sides, name: str, positive: str, negative: str) -> str:
    """Describe two positions, such as ``55 m ahead instead of 43 m``; the side is repeated if it differs."""
    new, old = (float(value) for value in sides.values(name))
    now, was = different(abs(new), abs(old))
    side, former = (positive if value >= 0 else negative for value in (new, old))
    return f"{now} m {side} instead of {was} m{'' if side == former else f' {former}'}"


def _way(heading_rad: float) -> str:
    """Return the direction in which a road user heads at the start."""
    if abs(math.sin(heading_rad)) > 0.5:
        return "across to the left" if heading_rad > 0 else "across to the right"
    return "the same way as the ego" if math.cos(heading_rad) > 0 else "towards the ego"
