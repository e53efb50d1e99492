"""Random streams of an episode: one generator for each random quantity.

Generators are addressed by position, so adding an actor or a draw never changes what another actor draws.
"""

from enum import IntEnum

import numpy as np


class Stream(IntEnum):
    """Purpose of a random stream. Changing a value changes the outcome of episodes."""

    START = 0
    LOCALISATION = 1
    LIGHT_DETECTION = 2
    SIGNALS = 3
    VEHICLE = 4
    PEDESTRIAN = 5
    DRIVING_SYSTEM = 6
    RANGE_SENSOR = 7
    DETECTOR = 8
    DETECTOR_NOISE = 9
    DETECTOR_GHOSTS = 10
    LOOKS = 100
    STREET = 101
    STROLLERS = 102
    OTHER_TRAFFIC = 103


def generator(seed: int, stream: Stream, index: int = 0) -> np.random.Generator:
    """Return the random generator for one quantity of an episode.

    Args:
        seed: The episode's seed.
        stream: Purpose of the stream.
        index: Index within the stream, such as the number of a vehicle.
    """
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(int(stream), index)))
