import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from brink.search.streams import Stream, episode_seed, generator

PINNED_DRAWS = [610, 30, 691, 773]
PINNED_SEEDS = [3247884046075857, 5214422823215758, 7562003829803771]


def test_equal_positions_give_equal_numbers_and_different_ones_do_not() -> None:
    positions: list[tuple[int, int, tuple[int, ...]]] = [
        (seed, stream, index)
        for seed in (0, 1, 2**40)
        for stream in Stream
        for index in ((), (0,), (1,), (0, 0))
    ]
    draws = [generator(seed, stream, *index).random(4).tobytes() for seed, stream, index in positions]
    again = [generator(seed, stream, *index).random(4).tobytes() for seed, stream, index in positions]
    assert draws == again
    assert len(set(draws)) == len(draws)


def test_numbers_of_a_position_never_change() -> None:
    # Pinned: stored campaigns are reproduced only as long as these stay.
    assert generator(1, Stream.BREEDING, 2).integers(1000, size=4).tolist() == PINNED_DRAWS
    assert [episode_seed(1, number) for number in range(3)] == PINNED_SEEDS


@given(st.integers(0, 2**63), st.integers(0, 10**9))
@settings(deadline=None)
def test_episode_seeds_survive_readers_that_keep_numbers_as_doubles(seed: int, number: int) -> None:
    value = episode_seed(seed, number)
    assert 0 <= value < 2**53
    assert int(float(value)) == value
    assert value == episode_seed(seed, number)


def test_episode_seeds_of_a_campaign_differ() -> None:
    assert len({episode_seed(5, number) for number in range(5000)}) == 5000


@pytest.mark.parametrize(("seed", "index"), [(-1, 0), (0, -1)])
def test_negative_positions_are_refused(seed: int, index: int) -> None:
    with pytest.raises(ValueError, match=">= 0"):
        generator(seed, Stream.START, index)


def test_stream_numbers_are_unique() -> None:
    assert len(Stream) == len(set(Stream))
    assert np.all(np.array(list(Stream)) < 1000)
