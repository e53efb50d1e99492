"""Owns the random streams of an episode: one generator for each thing that chance decides.

Addressed by position, so that one actor more, or one draw more, never shifts what another one draws.
"""

from enum import IntEnum

import numpy as np


class Stream(IntEnum):
    """What a stream of random numbers is for. Values are part of what makes episodes repeatable."""

    START = 0
    LOCALISATION = 1
    LIGHT_DETECTION = 2
    SIGNALS = 3
    VEHICLE = 4
    PEDESTRIAN = 5
    DRIVING_SYSTEM = 6
    LOOKS = 100
    STREET = 101
    STROLLERS = 102
    OTHER_TRAFFIC = 103


def generator(seed: int, stream: Stream, index: int = 0) -> np.random.Generator:
    """Return the generator at a position of an episode.

    Args:
        seed: The episode's seed.
        stream: What it is for.
        index: Which of them, such as the number of a vehicle.
    """
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(int(stream), index)))
