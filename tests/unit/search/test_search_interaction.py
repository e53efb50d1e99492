"""The added harm of a chain: how far its alpha lies below that of its most harmful part."""

import pytest

from brink.search.interaction import added_harm
from brink.search.slots import Chain, ChainGenome, Step, parts_of
from brink.search.testing import example_spaces

NOISE, BLUR, SNOW = Step(0, 4), Step(1, 12), Step(2, 1)
ALONE: dict[Chain, float] = {(NOISE,): 0.7, (BLUR,): 0.5}


@pytest.mark.parametrize(
    ("alpha", "expected"), [(0.3, 0.2), (0.5, 0.0), (0.6, -0.1)], ids=["together", "free rider", "masked"]
)
def test_added_harm_is_measured_against_the_most_harmful_part(alpha: float, expected: float) -> None:
    assert added_harm((NOISE, BLUR), {**ALONE, (NOISE, BLUR): alpha}) == pytest.approx(expected)


def test_known_parts_of_several_steps_count() -> None:
    chain = (NOISE, BLUR, SNOW)
    alphas = {**ALONE, (SNOW,): 0.8, chain: 0.2}
    assert added_harm(chain, alphas) == pytest.approx(0.3)
    assert added_harm(chain, {**alphas, (NOISE, SNOW): 0.25}) == pytest.approx(0.05)
    assert added_harm(chain, {**alphas, (SNOW, NOISE): 0.1}) == pytest.approx(0.3), (
        "not a part: another order"
    )


def test_added_harm_is_unknown_without_every_step_alone() -> None:
    assert added_harm((NOISE, BLUR), ALONE) is None
    assert added_harm((NOISE, SNOW), {**ALONE, (NOISE, SNOW): 0.1}) is None
    assert added_harm((NOISE,), ALONE) is None


def test_parts_keep_the_order_of_their_steps() -> None:
    assert parts_of((SNOW, NOISE, BLUR)) == [
        (SNOW,),
        (NOISE,),
        (BLUR,),
        (SNOW, NOISE),
        (SNOW, BLUR),
        (NOISE, BLUR),
    ]


def test_row_of_a_chain_gives_the_chain_and_is_valid() -> None:
    space = example_spaces()["slots"]
    genome = ChainGenome.of(space)
    for chain in ((), (BLUR,), (BLUR, NOISE)):
        row = genome.row(chain)
        assert genome.chain(row) == chain
        assert not list(genome.component.problems(row))


def test_a_part_of_two_individuals_is_one_row() -> None:
    genome = ChainGenome.of(example_spaces()["slots"])
    forward, backward = genome.row((NOISE, BLUR)), genome.row((BLUR, NOISE))
    for individual in (forward, backward):
        *parts, swapped = genome.ablations(individual)
        assert [genome.chain(part) for part in parts] == [(), *parts_of(genome.chain(individual))]
        assert [list(part) for part in parts] == [list(genome.row(genome.chain(part))) for part in parts]
        assert genome.chain(swapped) == genome.chain(individual)[::-1]
    first, second = ({row.tobytes() for row in genome.ablations(one)[:-1]} for one in (forward, backward))
    assert first == second
