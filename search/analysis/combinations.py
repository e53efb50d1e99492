"""Hazardous combinations of techniques, compared with their parts and with other orders.

This works on archives of spaces with ordered slots (`brink.search.slots`). A *chain* is the sequence of techniques in
the slots of a solution, without empty slots; a *place* is the rest of the solution. Whatever is said about a chain
and its parts or other orders is about places in which all of them were simulated, of which there are at least
`MIN_PLACES`.

Source: Ferreira et al. 2022: combinations that are hazardous although each part alone is safe (Fig. 6), or in one
order only (Fig. 7), decided by four of five seeds.
"""

import itertools
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple, TypeAlias

import numpy as np

from brink.search.archive import Archive
from brink.search.slots import Chain, ChainGenome, Step
from brink.search.space import SearchSpace

HAZARDOUS: Final = 0.8
"""Smallest unsafe share of a hazardous chain: four of five places."""
SAFE: Final = 0.2
"""Largest unsafe share of a safe chain: one of five places."""
MIN_PLACES: Final = 3
"""Number of places below which nothing is said about a chain: one drive that happens to be unsafe says little."""


Verdicts: TypeAlias = Mapping[bytes, "Verdict"]
"""Verdicts of a chain, by place."""


class Verdict(NamedTuple):
    """The number of a simulated solution, and its verdict."""

    number: int
    unsafe: bool


class Tally(NamedTuple):
    """Number of unsafe simulations, and number of all simulations."""

    unsafe: int
    trials: int

    @property
    def share(self) -> float:
        """Unsafe share; NaN without simulations."""
        return self.unsafe / self.trials if self.trials else float("nan")


@dataclass(frozen=True, slots=True, kw_only=True)
class Combination:
    """A chain, compared with its variants in the places that they share.

    Attributes:
        chain: Two steps or more.
        tally: Tally of the chain in all its places.
        parts: Tally of each proper part that shares a place with it, the empty chain included.
        orders: Tally of each other order of the same steps that shares a place with it.
        joint_hazards: Numbers of its unsafe solutions in places where all parts were simulated and are safe.
        order_hazards: Numbers of its unsafe solutions in places where another order is safe.
        hazardous: Whether the chain is unsafe in at least a share `HAZARDOUS` of its places.
        minimal: Whether it is hazardous, and none of its parts is.
        only_together: Whether it is hazardous, and every part of it is safe.
        order_matters: Whether it is hazardous, and another order of its steps is safe.
    """

    chain: Chain
    tally: Tally
    parts: Mapping[Chain, Tally]
    orders: Mapping[Chain, Tally]
    joint_hazards: tuple[int, ...]
    order_hazards: tuple[int, ...]
    hazardous: bool
    minimal: bool
    only_together: bool
    order_matters: bool


def verdicts_by_chain(space: SearchSpace, archive: Archive) -> dict[Chain, dict[bytes, Verdict]]:
    """Return the verdicts of an archive by chain and place; for repeated solutions, the first verdict.

    Raises:
        UnsupportedSpace: The space has no slots.
    """
    genome = ChainGenome.of(space)
    part = space.slices[genome.index]
    verdicts: dict[Chain, dict[bytes, Verdict]] = {}
    for number, row, unsafe in zip(
        archive.numbers.tolist(), archive.vectors, archive.unsafe.tolist(), strict=True
    ):
        chain = genome.chain(row[part])
        place = np.delete(row, np.arange(part.start, part.stop)).tobytes()
        verdicts.setdefault(chain, {}).setdefault(place, Verdict(number, bool(unsafe)))
    return verdicts


def combinations(verdicts: Mapping[Chain, Verdicts]) -> list[Combination]:
    """Return every chain of two or more steps, sorted by how clearly it is more hazardous than its parts."""
    by_steps: dict[frozenset[Step], list[Chain]] = {}
    for chain in verdicts:
        by_steps.setdefault(frozenset(chain), []).append(chain)
    combined = [_combination(chain, verdicts, by_steps) for chain in verdicts if len(chain) > 1]
    return sorted(
        combined,
        key=lambda one: (
            not one.only_together,
            not one.order_matters,
            not one.minimal,
            -len(one.joint_hazards),
            -len(one.order_hazards),
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
    common = own.keys() & set.intersection(*(set(seen) for seen in parts.values())) if complete else set()
    together = _hazardous(own) and _hazardous(own, common)
    unsafe = {place: verdict.number for place, verdict in own.items() if verdict.unsafe}
    return Combination(
        chain=chain,
        tally=_tally(own.values()),
        parts={part: _shared(seen, own) for part, seen in parts.items()},
        orders={other: _shared(seen, own) for other, seen in orders.items()},
        joint_hazards=tuple(
            number
            for place, number in unsafe.items()
            if complete and all(place in seen and not seen[place].unsafe for seen in parts.values())
        ),
        order_hazards=tuple(
            number
            for place, number in unsafe.items()
            if any(place in seen and not seen[place].unsafe for seen in orders.values())
        ),
        hazardous=_hazardous(own),
        minimal=together and all(_shared(seen, common).share < HAZARDOUS for seen in parts.values()),
        only_together=together and all(_shared(seen, common).share <= SAFE for seen in parts.values()),
        order_matters=_hazardous(own)
        and any(
            _hazardous(own, own.keys() & seen.keys()) and _shared(seen, own).share <= SAFE
            for seen in orders.values()
        ),
    )


def _hazardous(verdicts: Verdicts, places: Collection[bytes] | None = None) -> bool:
    """Return whether a chain is hazardous in some of its places, by default in all."""
    tally = _shared(verdicts, verdicts if places is None else places)
    return tally.trials >= MIN_PLACES and tally.share >= HAZARDOUS


def _tally(verdicts: Iterable[Verdict]) -> Tally:
    kept = list(verdicts)
    return Tally(sum(verdict.unsafe for verdict in kept), len(kept))


def _shared(verdicts: Verdicts, places: Iterable[bytes]) -> Tally:
    return _tally(verdicts[place] for place in places if place in verdicts)


def variants_at(verdicts: Mapping[Chain, Verdicts], chain: Chain, number: int) -> dict[Chain, Verdict]:
    """Return the verdicts of a chain, its parts and its other orders in the place of one of its solutions.

    Args:
        verdicts: The result of `verdicts_by_chain`.
        chain: The chain.
        number: Number of the solution.

    Raises:
        KeyError: The chain has no such solution.
    """
    places = [place for place, verdict in verdicts[chain].items() if verdict.number == number]
    if not places:
        raise KeyError(number)
    variants = [part for size in range(len(chain) + 1) for part in itertools.combinations(chain, size)]
    variants += [order for order in verdicts if order != chain and set(order) == set(chain)]
    return {
        variant: verdicts[variant][places[0]]
        for variant in variants
        if places[0] in verdicts.get(variant, {})
    }


def tally_by_step(verdicts: Mapping[Chain, Verdicts]) -> dict[Step, tuple[Tally, Tally]]:
    """Return two tallies for each step: alone, and in chains with others."""
    alone: dict[Step, list[Verdict]] = {}
    joined: dict[Step, list[Verdict]] = {}
    for chain, seen in verdicts.items():
        for step in chain:
            (alone if len(chain) == 1 else joined).setdefault(step, []).extend(seen.values())
    return {
        step: (_tally(alone.get(step, [])), _tally(joined.get(step, [])))
        for step in sorted({*alone, *joined})
    }
