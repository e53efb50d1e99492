"""Combinations of techniques that are hazardous only together, only in one order, or minimal."""

import itertools
from typing import TypeAlias

import numpy as np
import pytest

from brink.search.analysis.combinations import Combination, combinations, variants_at, verdicts_by_chain
from brink.search.archive import Archive, Neighbourhood
from brink.search.errors import UnsupportedSpace
from brink.search.slots import Chain, Step, slots_of
from brink.search.testing import example_spaces

SPACE = example_spaces()["slots"]
NOISE, BLUR = Step(0, 4), Step(1, 12)


Trial: TypeAlias = tuple[int, Chain, bool]


def archive_of(trials: list[Trial]) -> Archive:
    """Return an archive; each trial is a place, a chain, and whether it was unsafe."""
    index, slots = slots_of(SPACE)
    rng = np.random.default_rng(0)
    places = [SPACE.sample(rng) for _ in range(6)]
    rows = []
    for place, chain, _ in trials:
        filled = [*chain, *(Step(t, 0) for t in range(5) if t not in {step.technique for step in chain})][:2]
        vector = np.array([x for t, level in filled for x in (t, slots.intensity(t, level))], np.float64)
        vectors = [vector if part == index else whole for part, whole in enumerate(places[place])]
        rows.append(SPACE.join(vectors))
    unsafe = np.array([trial[2] for trial in trials])
    archive = Archive.empty(SPACE, Neighbourhood(radius=0.3, p_th=0.1, z=1.96))
    return archive.grown(np.arange(len(rows)), np.array(rows), unsafe, np.where(unsafe, -1.0, 1.0))


def found(trials: list[Trial]) -> dict[Chain, Combination]:
    return {one.chain: one for one in combinations(verdicts_by_chain(SPACE, archive_of(trials)))}


def test_a_pair_that_is_hazardous_only_together_and_only_in_one_order() -> None:
    trials = [
        *((place, (NOISE, BLUR), place != 0) for place in range(5)),
        *((place, (BLUR, NOISE), place == 1) for place in range(5)),
        *((place, (NOISE,), False) for place in range(5)),
        *((place, (BLUR,), place == 1) for place in range(5)),
        *((place, (), False) for place in range(5)),
    ]
    one = found(trials)[NOISE, BLUR]
    assert one.tally == (4, 5)
    assert one.parts == {(): (0, 5), (NOISE,): (0, 5), (BLUR,): (1, 5)}
    assert one.orders == {(BLUR, NOISE): (1, 5)}
    assert one.only_together
    assert one.order_matters
    assert one.minimal
    assert one.joint_hazards == (2, 3, 4), "solutions, not places: at place 1 blur alone was unsafe"
    assert one.order_hazards == (2, 3, 4)
    other = found(trials)[BLUR, NOISE]
    assert not any((other.hazardous, other.only_together, other.order_matters))


def test_a_pair_with_a_hazardous_part_is_not_minimal() -> None:
    trials = list(itertools.product(range(3), [(NOISE, BLUR), (BLUR,)], [True]))
    trials += [(place, part, False) for place in range(3) for part in ((NOISE,), ())]
    one = found(trials)[NOISE, BLUR]
    assert one.hazardous
    assert not any((one.minimal, one.only_together, one.joint_hazards))


def test_nothing_is_concluded_without_simulations_of_every_part() -> None:
    trials = [
        *((place, (NOISE, BLUR), True) for place in range(3)),
        *((p, (NOISE,), False) for p in range(3)),
    ]
    one = found([*trials, (5, (BLUR,), False)])[NOISE, BLUR]
    assert one.parts == {(NOISE,): (0, 3)}, "blur was simulated in another place"
    assert not any((one.minimal, one.only_together, one.joint_hazards))


def test_a_chain_and_its_variants_are_judged_in_the_same_places() -> None:
    trials: list[Trial] = [
        *((place, (NOISE, BLUR), place != 0) for place in range(5)),
        *((0, variant, False) for variant in ((NOISE,), (BLUR,), (), (BLUR, NOISE))),
    ]
    one = found(trials)[NOISE, BLUR]
    assert one.hazardous
    assert one.parts == {(): (0, 1), (NOISE,): (0, 1), (BLUR,): (0, 1)}
    assert not any((one.only_together, one.minimal, one.order_matters)), (
        "safe in the only place of the others"
    )
    trials += [
        (place, variant, False) for place in (1, 2) for variant in ((NOISE,), (BLUR,), (), (BLUR, NOISE))
    ]
    one = found(trials)[NOISE, BLUR]
    assert not any((one.only_together, one.minimal, one.order_matters)), "unsafe in two of the three places"
    trials += [(place, variant, False) for place in (3, 4) for variant in ((NOISE,), (BLUR,), ())]
    one = found(trials)[NOISE, BLUR]
    assert (one.only_together, one.minimal, one.order_matters) == (True, True, False)


def test_nothing_is_concluded_from_fewer_than_three_places() -> None:
    variants: tuple[Chain, ...] = ((NOISE,), (BLUR,), (), (BLUR, NOISE))
    for places in (1, 2, 3):
        trials: list[Trial] = [(place, (NOISE, BLUR), True) for place in range(places)]
        trials += [(place, variant, False) for place in range(places) for variant in variants]
        one = found(trials)[NOISE, BLUR]
        claims = {one.hazardous, one.only_together, one.minimal, one.order_matters}
        assert claims == {places == 3}
        assert len(one.joint_hazards) == len(one.order_hazards) == places, "single drives are still shown"


def test_variants_at_a_solution_were_simulated_in_its_place() -> None:
    trials = [
        (0, (NOISE, BLUR), True),
        (1, (NOISE, BLUR), False),
        (1, (BLUR, NOISE), True),
        (1, (BLUR,), False),
        (0, (), False),
        (1, (), False),
        (1, (Step(2, 3),), True),
    ]
    verdicts = verdicts_by_chain(SPACE, archive_of(trials))
    assert variants_at(verdicts, (NOISE, BLUR), 1) == {
        (): (5, False),
        (BLUR,): (3, False),
        (NOISE, BLUR): (1, False),
        (BLUR, NOISE): (2, True),
    }
    with pytest.raises(KeyError):
        variants_at(verdicts, (NOISE, BLUR), 2)


def test_a_space_without_slots_is_rejected() -> None:
    space = next(space for name, space in example_spaces().items() if name != "slots")
    with pytest.raises(UnsupportedSpace, match="ordered slots"):
        verdicts_by_chain(space, Archive.empty(space, Neighbourhood(radius=0.3, p_th=0.1, z=1.96)))
