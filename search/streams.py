"""Random generators, addressed by position; the one place in which the search package makes them.

A generator is a function of (seed, stream, index) and of nothing else: not of what was drawn before, in which
process, or in which order results arrived.
"""

from enum import IntEnum

import numpy as np


class Stream(IntEnum):
    """What a generator is for. The numbers are part of what makes a campaign reproducible: never reuse one."""

    EPISODE = 0
    START = 1
    COLLABORATION = 2
    POPULATION_ARCHIVE = 3
    BREEDING = 4
    CONTROL = 5
    CONTRACT = 6
    FINALISTS = 7
    SEEDS = 8
    MONITOR = 9
    REPEATS = 10


def _sequence(seed: int, stream: int, index: tuple[int, ...]) -> np.random.SeedSequence:
    if seed < 0 or stream < 0 or any(part < 0 for part in index):
        raise ValueError(f"expected a seed, a stream and indices >= 0, got {seed}, {stream}, {index}")
    return np.random.SeedSequence(seed, spawn_key=(int(stream), *index))


def generator(seed: int, stream: Stream | int, *index: int) -> np.random.Generator:
    """Return the generator at one position.

    Args:
        seed: The campaign's seed, >= 0.
        stream: What the numbers are for. Plug-ins take numbers from 1,000 up.
        index: Where in the stream, such as the generation; any number of parts >= 0.
    """
    # PCG64 by name: default_rng may change its bit generator from one numpy to the next.
    return np.random.Generator(np.random.PCG64(_sequence(seed, stream, index)))


def episode_seed(campaign_seed: int, number: int) -> int:
    """Return the seed of a candidate's episode, in [0, 2**53): JSON readers keep it exactly."""
    state = _sequence(campaign_seed, Stream.EPISODE, (number,)).generate_state(1, np.uint64)
    return int(state[0]) >> 11
