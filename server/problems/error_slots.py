"""Problems whose behaviour consists of slots: each has one error relative to the truth, or none.

A slot is a block of the behaviour's parameters: a categorical one that chooses the type of the error, possibly others
that say more about it, and the error's numbers, which are dormant where there is none. `ErrorSlots` owns what these
problems have in common: which slots were active in an episode, and what differs between two candidates.
`PerceptionErrors` adds severities, whose physical meaning a table of magnitudes gives.
"""

from abc import abstractmethod
from collections.abc import Collection, Mapping, Sequence, Set
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Final, Generic, Protocol, TypeVar

import numpy as np

from brink.search.parameters import Categorical, Dormant, Parameter, Value
from brink.search.space import Component, FloatArray, SearchSpace
from brink.server.problems.base import (
    BEHAVIOUR,
    Activity,
    SeverityScale,
    SimulatedProblem,
    SimulatedSolution,
    Vectors,
)
from brink.server.problems.changes import instead
from brink.sim.perception_errors import Magnitude
from brink.sim.urban.behaviour import steps_from_json
from brink.sim.urban.detection_errors import ERROR_STEPS

NO_ERROR: Final = "none"
"""The type of an error that is none."""
SCENARIO: Final = "scenario"

Values = Mapping[str, Value]
E = TypeVar("E")


def slots_component(slots: Sequence[Sequence[Parameter]]) -> Component:
    """Return the behaviour that consists of slots, which are interchangeable.

    Args:
        slots: The parameters of each: first the type, whose choice `NO_ERROR` means none, then the others.
    """
    return Component(
        name=BEHAVIOUR,
        parameters=tuple(parameter for slot in slots for parameter in slot),
        constraints=tuple(
            Dormant(
                label=slot[0].name,
                null_choice=NO_ERROR,
                members=tuple(one.name for one in slot if not isinstance(one, Categorical)),
            )
            for slot in slots
        ),
        interchangeable=interchangeable([[one.name for one in slot] for slot in slots]),
    )


def interchangeable(parts: Sequence[Sequence[str]]) -> tuple[tuple[str, ...], ...]:
    """Return parts as a component expects interchangeable ones: a single part is not interchangeable."""
    return tuple(map(tuple, parts)) if len(parts) > 1 else ()


def prefixes(name: str, count: int) -> list[str]:
    """Return the prefixes of the parameters of the slots, such as ``error_1.``."""
    return [f"{name}_{index}." for index in range(1, count + 1)]


@dataclass(frozen=True, slots=True, kw_only=True)
class Slot:
    """A block of the behaviour's parameters.

    Attributes:
        prefix: What the names of its parameters begin with; empty if there is only one slot without a number.
        names: Names of its parameters; the first one chooses the type.
        none: The choice for no error.
        numbers: The parameters that are dormant then.
    """

    prefix: str
    names: tuple[str, ...]
    none: str
    numbers: tuple[str, ...]

    @property
    def type(self) -> str:
        """Name of the parameter that chooses the type."""
        return self.names[0]

    def is_empty(self, behaviour: Values) -> bool:
        """Return whether a decoded behaviour has no error in this slot."""
        return behaviour[self.type] == self.none


def slots_in(component: Component) -> tuple[Slot, ...]:
    """Return the slots of a behaviour; each has one constraint that makes its numbers dormant."""
    slots = []
    for constraint in component.constraints:
        if isinstance(constraint, Dormant):
            prefix = constraint.label.removesuffix(constraint.label.rpartition(".")[2])
            slots.append(
                Slot(
                    prefix=prefix,
                    names=tuple(
                        parameter.name
                        for parameter in component.parameters
                        if parameter.name.startswith(prefix)
                    ),
                    none=constraint.null_choice,
                    numbers=constraint.members,
                )
            )
    return tuple(slots)


class Parts:
    """The parameters that were active in an episode, to be narrowed down from all of them."""

    def __init__(self, space: SearchSpace, vectors: Vectors) -> None:
        self._parameters = space.parameters
        self._columns = {name: column for column, name in enumerate(space.column_names())}
        self.active = np.ones(len(self._columns), dtype=np.bool_)
        self.effective: FloatArray = np.concatenate(
            [np.asarray(vector, dtype=np.float64) for vector in vectors]
        )

    def leave_out(self, component: str, names: Collection[str]) -> None:
        """Record that parameters were inactive; names that the component lacks are ignored."""
        full = [f"{component}.{name}" for name in names]
        self.active[[self._columns[name] for name in full if name in self._columns]] = False

    def silence(self, component: str, choice: str, none: str, numbers: Collection[str]) -> None:
        """Treat a choice as its null choice in the episode, with its numbers dormant."""
        column = self._columns[f"{component}.{choice}"]
        parameter = self._parameters[column]
        assert isinstance(parameter, Categorical)
        self.effective[column] = parameter.choices.index(none)
        self.zero(component, numbers)

    def zero(self, component: str, numbers: Collection[str]) -> None:
        """Treat inactive numbers as 0 in the episode."""
        self.effective[[self._columns[f"{component}.{name}"] for name in numbers]] = 0.0


class SlottedBehaviour(SimulatedProblem):
    """A problem whose behaviour, the last component, is a number of slots.

    Attributes:
        acted_feature: Feature of results with the first and last step at which what is in each slot acted, or null.
    """

    has_component = True
    records_activity = True
    acted_feature: ClassVar[str] = ERROR_STEPS

    @cached_property
    def slots(self) -> tuple[Slot, ...]:
        """The slots of the behaviour, which an ODD does not change."""
        return slots_in(self.space.components[-1])

    def narrow_scenario(self, parts: Parts, scenario: Values, features: Mapping[str, Any]) -> None:
        """Record which parameters of a decoded scenario were inactive in the episode."""

    def acted(self, features: Mapping[str, Any], present: Sequence[Slot]) -> Collection[Slot] | None:
        """Return in which slots something took effect in an episode; None if that was not recorded."""
        steps = steps_from_json(features.get(self.acted_feature))
        if self.is_true or steps is None or len(steps) != len(present):
            return None
        return [slot for slot, at in zip(present, steps, strict=True) if at is not None]

    def unused_in(self, slot: Slot, behaviour: Values) -> Collection[str]:
        """Return the parameters, without prefix, that the content of a slot lacks because of its type."""
        return ()

    def activity(self, vectors: Vectors, features: Mapping[str, Any]) -> Activity | None:
        """Return which parameters were active in an episode: those of each error that took effect."""
        values = self.space.decode(tuple(vectors))
        behaviour = values[BEHAVIOUR]
        present = [slot for slot in self.slots if not slot.is_empty(behaviour)]
        acted = self.acted(features, present)
        if acted is None:
            return None
        parts = Parts(self.space, vectors)
        self.narrow_scenario(parts, values.get(SCENARIO, {}), features)
        for slot in self.slots:
            if slot in acted:
                unused = self.unused_in(slot, behaviour)
                parts.leave_out(BEHAVIOUR, [slot.prefix + name for name in unused])
            else:
                # The type stays active where there is no error: another type would have been one.
                parts.leave_out(BEHAVIOUR, slot.names if slot in present else slot.names[1:])
                parts.silence(BEHAVIOUR, slot.type, slot.none, slot.numbers)
        return Activity(active=parts.active, effective=parts.effective, idle=() if acted else (BEHAVIOUR,))

    def slot_of(self, name: str) -> Slot | None:
        """Return the slot of a parameter, given as component.parameter; None if it is in none."""
        own = name.removeprefix(f"{BEHAVIOUR}.")
        return next((slot for slot in self.slots if own != name and own in slot.names), None)

    def traits(self, name: str, values: Mapping[str, Values]) -> tuple[str, ...]:
        """Return the parameter of a slot with the choices there, such as type and target, and the road."""
        slot = self.slot_of(name)
        scene = [
            str(values[component.name][parameter.name])
            for component in self.space.components
            for parameter in component.parameters
            if isinstance(parameter, Categorical) and parameter.tells_kinds
        ]
        if slot is None:
            return (name, *scene)
        chosen = [values[BEHAVIOUR][one] for one in slot.names]
        choices = (one for one in chosen if isinstance(one, str))
        own = name.removeprefix(f"{BEHAVIOUR}.{slot.prefix}")
        return (own, *choices, *scene)


class ErrorSlots(SlottedBehaviour, Generic[E]):
    """A problem with an error in each slot.

    Attributes:
        identity: Attributes that identify an error; if they differ, it is another error.
        lacking: How a change is described that takes away an error, which is filled in.
        episode_word: What an episode is called.
    """

    identity: ClassVar[tuple[str, ...]] = ("type", "target")
    lacking: ClassVar[str] = "without the error that {}"
    episode_word: ClassVar[str] = "drive"

    @abstractmethod
    def error(self, behaviour: Values, slot: Slot) -> E:
        """Return the error of a decoded behaviour in a slot that has one."""

    @abstractmethod
    def words_of_error(self, error: E) -> str:
        """Describe an error."""

    @abstractmethod
    def words_of_changed_error(self, old: E, new: E, changed: Set[str]) -> str:
        """Describe how an error differs from another with the same `identity`; empty without a visible difference.

        Args:
            old: The error in the safe episode.
            new: The error in the unsafe one.
            changed: The parameters of the slot that differ, without prefix.
        """

    @abstractmethod
    def scenario_changes(self, old: Values, new: Values, changed: Collection[str]) -> list[str]:
        """Describe the differences of the unsafe decoded scenario from the safe one, one part for each parameter.

        Args:
            old: The safe scenario.
            new: The unsafe one.
            changed: The parameters in which the candidates differ, as component.parameter.
        """

    @abstractmethod
    def unused(self, error: E) -> Collection[str]:
        """Return the parameters, without prefix, that an error of this type does not have."""

    def unused_in(self, slot: Slot, behaviour: Values) -> Collection[str]:
        """Return the parameters, without prefix, that the error in a slot does not have."""
        return self.unused(self.error(behaviour, slot))

    def errors(self, behaviour: Values) -> list[E]:
        """Return the errors of a decoded behaviour; none if perception is perfect."""
        if self.is_true:
            return []
        return [self.error(behaviour, slot) for slot in self.slots if not slot.is_empty(behaviour)]

    def words_of_errors(self, behaviour: Values) -> str:
        """Describe the errors of a decoded behaviour; empty for none."""
        return " and ".join(map(self.words_of_error, self.errors(behaviour)))

    def words_of_change(
        self, safe: SimulatedSolution, unsafe: SimulatedSolution, changed: Collection[str]
    ) -> str:
        """Describe the differences of the unsafe candidate from the safe one."""
        old, new = (self.space.decode(tuple(side.vectors)) for side in (safe, unsafe))
        parts = self.scenario_changes(old.get(SCENARIO, {}), new.get(SCENARIO, {}), changed)
        for slot in self.slots:
            prefix = f"{BEHAVIOUR}.{slot.prefix}"
            names = {name.removeprefix(prefix) for name in changed if name.startswith(prefix)}
            if names:
                parts.append(self._slot_change(slot, old[BEHAVIOUR], new[BEHAVIOUR], names))
        return "; ".join(filter(None, parts))

    def _slot_change(self, slot: Slot, old: Values, new: Values, changed: Set[str]) -> str:
        if slot.is_empty(new):
            return (
                "" if slot.is_empty(old) else self.lacking.format(self.words_of_error(self.error(old, slot)))
            )
        after = self.error(new, slot)
        if slot.is_empty(old):
            return self.words_of_error(after)
        before = self.error(old, slot)
        if any(getattr(before, name) != getattr(after, name) for name in self.identity):
            safe = f"in the safe {self.episode_word}, {self.words_of_error(before)}"
            return f"{self.words_of_error(after)} ({safe})"
        return self.words_of_changed_error(before, after, changed)


class PerceptionError(Protocol):
    """An error of perception with a magnitude."""

    @property
    def type(self) -> str:
        """What is wrong."""

    @property
    def magnitude(self) -> float:
        """How wrong, in the unit of the type."""

    @property
    def onset_s(self) -> float:
        """When it begins."""

    @property
    def duration_s(self) -> float:
        """How long it lasts."""

    @property
    def words(self) -> str:
        """The error in words."""

    def words_with(self, magnitude: str) -> str:
        """Describe the error with the given magnitude and without the times."""


P = TypeVar("P", bound=PerceptionError)


class PerceptionErrors(ErrorSlots[P]):
    """A problem with errors of perception, of which each type has a magnitude in a physical unit.

    Attributes:
        magnitudes: The magnitude of each type.
        onset_fields: Parameters that only errors with a time window have.
    """

    magnitudes: ClassVar[Mapping[Any, Magnitude]]
    onset_fields: ClassVar[tuple[str, ...]] = ("onset_s",)

    def first(self, name: str) -> str:
        """Return the full name of a parameter of the first slot, which studies of severities vary."""
        return f"{BEHAVIOUR}.{self.slots[0].prefix}{name}"

    def study_of_severity(self, fixed: Mapping[str, Any]) -> dict[str, Any]:
        """Return the parameters of an algorithm for studying the severity of one error.

        Args:
            fixed: Parameters of the first slot that stay fixed, besides there being no other errors.
        """
        others = {f"{BEHAVIOUR}.{slot.type}": NO_ERROR for slot in self.slots[1:]}
        return {
            "severity": self.first("severity"),
            "fixed": others | {self.first(name): value for name, value in fixed.items()},
            "truth": {self.first("type"): NO_ERROR},
        }

    def words_of_error(self, error: P) -> str:
        """Describe an error."""
        return error.words

    def unused(self, error: P) -> Collection[str]:
        """Return the parameters that an error of this type does not have."""
        scale = self.magnitudes[error.type]
        return (
            *(() if scale.has_window else self.onset_fields),
            *(() if scale.has_duration else ("duration_s",)),
        )

    def words_of_changed_error(self, old: P, new: P, changed: Set[str]) -> str:
        """Describe how an error differs, such as ``the lead is not reported for 1.5 s instead of 1.3 s``."""
        scale = self.magnitudes[new.type]
        parts = self.window_changes(old, new, changed)
        if old.magnitude == new.magnitude:
            much = scale.words(new.magnitude)
            return ", ".join([new.words_with(much), *parts]) if parts else ""
        much = instead(scale.number(old.magnitude), scale.number(new.magnitude), scale.shown_unit)
        return ", ".join([new.words_with(much), *parts])

    def window_changes(self, old: P, new: P, changed: Set[str]) -> list[str]:
        """Describe when an error differs."""
        scale, parts = self.magnitudes[new.type], []
        if scale.has_window and not changed.isdisjoint(self.onset_fields):
            parts.append(self.onset_change(old, new))
        if scale.has_duration and "duration_s" in changed:
            parts.append(f"for {instead(old.duration_s, new.duration_s, 's')}")
        return parts

    def onset_change(self, old: P, new: P) -> str:
        """Describe how the onset of an error differs."""
        return f"from {instead(old.onset_s, new.onset_s, 's')}"

    def severity_scale(self, choices: Mapping[str, str]) -> SeverityScale | None:
        """Return the scale of severities, given the type of the first error."""
        return self._scale(choices.get(self.first("type"), NO_ERROR))

    def scale_of(self, name: str, values: Mapping[str, Values]) -> SeverityScale | None:
        """Return the scale of a severity or of a time, given its error."""
        slot = self.slot_of(name)
        if slot is None or slot.is_empty(values[BEHAVIOUR]):
            return None
        field, error = name.removeprefix(f"{BEHAVIOUR}.{slot.prefix}"), self.error(values[BEHAVIOUR], slot)
        if field == "severity":
            return self._scale(error.type)
        if field not in ("onset_s", "duration_s"):
            return None
        which = "how long" if field == "duration_s" else "from when on"
        words = error.words_with(self.magnitudes[error.type].words(error.magnitude))
        return SeverityScale(unit="s", none=0.0, most=1.0, meaning=f"{which} {words}")

    def _scale(self, kind: str) -> SeverityScale | None:
        if kind == NO_ERROR:
            return None
        magnitude = self.magnitudes[kind]
        return SeverityScale(
            unit=magnitude.shown_unit,
            none=magnitude.number(magnitude.none),
            most=magnitude.number(magnitude.most),
            meaning=magnitude.meaning,
            decimals=0 if magnitude.shown_unit == "%" else 1,
        )
