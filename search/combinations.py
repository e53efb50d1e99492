"""Which combinations of techniques are hazardous, and whether their parts or another order are too.

Works on archives of spaces with ordered slots (`brink.search.levels`). A *chain* is what the slots of a solution
hold, in order, empty ones left out; a *place* is everything else in the solution. Chains compare where they were
simulated in the same places.

Source: Ferreira et al. 2022, combinations that are hazardous while each part alone is safe (Fig. 6), or in one order
alone (Fig. 7), each judged by four of five seeds.
"""

import itertools
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple, TypeAlias

import numpy as np

from brink.search.archive import Archive
from brink.search.levels import slots_of
from brink.search.space import SearchSpace

HAZARDOUS: Final = 0.8
"""Share of places from which on a chain counts as hazardous: four of five."""
SAFE: Final = 0.2
"""Share of places up to which it counts as safe: one of five."""


class Step(NamedTuple):
    """A technique at a level, by their indices."""

    technique: int
    level: int


Chain: TypeAlias = tuple[Step, ...]
Verdicts: TypeAlias = Mapping[bytes, "Verdict"]
"""Verdict of a chain at each place."""


class Verdict(NamedTuple):
    """One simulation: the number of its solution, and how it ended."""

    number: int
    unsafe: bool


class Tally(NamedTuple):
    """How many of some simulations were unsafe."""

    unsafe: int
    trials: int

    @property
    def share(self) -> float:
        """Unsafe share; NaN if there are none."""
        return self.unsafe / self.trials if self.trials else float("nan")


@dataclass(frozen=True, slots=True, kw_only=True)
class Combination:
    """A chain, and what was seen of its variants in places where both were simulated.

    Attributes:
        chain: Two steps or more.
        tally: Of the chain, in all its places.
        parts: Of each proper part, nothing at all among them, that shares a place with it.
        orders: Of each other order of the same steps that shares a place with it.
        together: Solutions of the chain that are unsafe where every part is safe: all parts were simulated there.
        turned: Solutions of the chain that are unsafe where another order is safe.
    """

    chain: Chain
    tally: Tally
    parts: Mapping[Chain, Tally]
    orders: Mapping[Chain, Tally]
    together: tuple[int, ...]
    turned: tuple[int, ...]

    @property
    def complete(self) -> bool:
        """Whether every part was simulated."""
        return len(self.parts) == (1 << len(self.chain)) - 1

    @property
    def hazardous(self) -> bool:
        """Whether it is unsafe in most places."""
        return self.tally.share >= HAZARDOUS

    @property
    def minimal(self) -> bool:
        """Whether it is hazardous and no part is."""
        return (
            self.hazardous and self.complete and all(part.share < HAZARDOUS for part in self.parts.values())
        )

    @property
    def only_together(self) -> bool:
        """Whether it is hazardous and every part is safe."""
        return self.hazardous and self.complete and all(part.share <= SAFE for part in self.parts.values())

    @property
    def order_matters(self) -> bool:
        """Whether it is hazardous and another order is safe."""
        return self.hazardous and any(order.share <= SAFE for order in self.orders.values())


def verdicts_by_chain(space: SearchSpace, archive: Archive) -> dict[Chain, dict[bytes, Verdict]]:
    """Return the verdicts of an archive by chain and place; where one comes twice, the first.

    Raises:
        UnsupportedSpace: The space has no slots.
    """
    index, slots = slots_of(space)
    names = [parameter.name for parameter in space.components[index].parameters]
    columns = [(names.index(technique), names.index(intensity)) for technique, intensity in slots.pairs]
    part = space.slices[index]
    found: dict[Chain, dict[bytes, Verdict]] = {}
    for number, row, unsafe in zip(
        archive.numbers.tolist(), archive.vectors, archive.unsafe.tolist(), strict=True
    ):
        steps = [(int(row[part][technique]), float(row[part][intensity])) for technique, intensity in columns]
        chain = tuple(Step(choice, slots.level(choice, intensity)) for choice, intensity in steps)
        chain = tuple(step for step in chain if step.level)
        place = np.delete(row, np.arange(part.start, part.stop)).tobytes()
        found.setdefault(chain, {}).setdefault(place, Verdict(number, bool(unsafe)))
    return found


def combinations(verdicts: Mapping[Chain, Verdicts]) -> list[Combination]:
    """Return every chain of two steps or more, those first that are hazardous most clearly beyond their parts."""
    by_steps: dict[frozenset[Step], list[Chain]] = {}
    for chain in verdicts:
        by_steps.setdefault(frozenset(chain), []).append(chain)
    found = [_combination(chain, verdicts, by_steps) for chain in verdicts if len(chain) > 1]
    return sorted(
        found,
        key=lambda one: (
            not one.only_together,
            not one.order_matters,
            not one.minimal,
            -len(one.together),
            -len(one.turned),
            -one.tally.share,
            one.chain,
        ),
    )


def _combination(
    chain: Chain, verdicts: Mapping[Chain, Verdicts], by_steps: Mapping[frozenset[Step], list[Chain]]
) -> Combination:
    own = verdicts[chain]
    parts = {
        part: verdicts[part]
        for size in range(len(chain))
        for part in itertools.combinations(chain, size)
        if part in verdicts and own.keys() & verdicts[part].keys()
    }
    orders = {
        other: verdicts[other]
        for other in by_steps[frozenset(chain)]
        if other != chain and own.keys() & verdicts[other].keys()
    }
    complete = len(parts) == (1 << len(chain)) - 1
    unsafe = {place: verdict.number for place, verdict in own.items() if verdict.unsafe}
    return Combination(
        chain=chain,
        tally=_tally(own.values()),
        parts={part: _shared(seen, own) for part, seen in parts.items()},
        orders={other: _shared(seen, own) for other, seen in orders.items()},
        together=tuple(
            number
            for place, number in unsafe.items()
            if complete and all(place in seen and not seen[place].unsafe for seen in parts.values())
        ),
        turned=tuple(
            number
            for place, number in unsafe.items()
            if any(place in seen and not seen[place].unsafe for seen in orders.values())
        ),
    )


def _tally(verdicts: Iterable[Verdict]) -> Tally:
    kept = list(verdicts)
    return Tally(sum(verdict.unsafe for verdict in kept), len(kept))


def _shared(verdicts: Verdicts, places: Iterable[bytes]) -> Tally:
    return _tally(verdicts[place] for place in places if place in verdicts)


def beside(verdicts: Mapping[Chain, Verdicts], chain: Chain, number: int) -> dict[Chain, Verdict]:
    """Return the verdicts of a chain, its parts and its other orders where one solution of it was simulated.

    Args:
        verdicts: As `verdicts_by_chain` gives them.
        chain: The chain.
        number: Of the solution.

    Raises:
        KeyError: The chain has no such solution.
    """
    places = [place for place, verdict in verdicts[chain].items() if verdict.number == number]
    if not places:
        raise KeyError(number)
    variants = [part for size in range(len(chain) + 1) for part in itertools.combinations(chain, size)]
    variants += [order for order in verdicts if order != chain and set(order) == set(chain)]
    return {one: verdicts[one][places[0]] for one in variants if places[0] in verdicts.get(one, {})}


def tally_by_step(verdicts: Mapping[Chain, Verdicts]) -> dict[Step, tuple[Tally, Tally]]:
    """Return, for each step, how often it was unsafe alone and how often in chains with others."""
    alone: dict[Step, list[Verdict]] = {}
    joined: dict[Step, list[Verdict]] = {}
    for chain, seen in verdicts.items():
        for step in chain:
            (alone if len(chain) == 1 else joined).setdefault(step, []).extend(seen.values())
    return {
        step: (_tally(alone.get(step, [])), _tally(joined.get(step, [])))
        for step in sorted({*alone, *joined})
    }
