"""Random generators addressed by position; the only place where the search package creates them.

A generator depends on (seed, stream, index) alone: not on earlier draws, on the process, or on the order in which
results arrive.
"""

from enum import IntEnum

import numpy as np


class Stream(IntEnum):
    """Purpose of a generator. Never change or reuse a number, or stored campaigns cannot be reproduced."""

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
    EDGE = 11
    TOLERANCE = 12
    GUARD = 13
    ERRORS = 14
    THRESHOLDS = 15
    RATE = 16
    SUBSET = 17
    DEEPJANUS = 20
    STRADDLE = 21
    BSV = 22
    NEAREST_OPPOSITE = 23


def _sequence(seed: int, stream: int, index: tuple[int, ...]) -> np.random.SeedSequence:
    if seed < 0 or stream < 0 or any(part < 0 for part in index):
        raise ValueError(f"expected a seed, a stream and indices >= 0, got {seed}, {stream}, {index}")
    return np.random.SeedSequence(seed, spawn_key=(int(stream), *index))


def generator(seed: int, stream: Stream | int, *index: int) -> np.random.Generator:
    """Return the generator at one position of a stream.

    Args:
        seed: The campaign's seed, >= 0.
        stream: Purpose of the numbers. Plug-ins use 1,000 and above.
        index: Position in the stream, such as the generation; any number of integers >= 0.

    Raises:
        ValueError: A number is negative.
    """
    # PCG64 by name: numpy may change the bit generator of default_rng.
    return np.random.Generator(np.random.PCG64(_sequence(seed, stream, index)))


def episode_seed(campaign_seed: int, number: int) -> int:
    """Return the seed of a candidate's episode, in [0, 2**53) so that every JSON reader keeps it exactly.

    Raises:
        ValueError: A number is negative.
    """
    state = _sequence(campaign_seed, Stream.EPISODE, (number,)).generate_state(1, np.uint64)
    return int(state[0]) >> 11
