"""Policies and margins for the example environments; write your own in the same way.

A policy maps an observation to an action. It is a function, or a class without arguments whose instances are called:
each episode gets its own. A margin maps a whole episode to a number that is negative if the episode is unsafe.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

_CART_POLE_GAINS: Final = np.array([0.1, 0.35, 3.0, 1.0])
"""Weights of cart position, cart velocity, pole angle and pole angular velocity."""
CART_POLE_ANGLE_RAD: Final = 12 * 2 * np.pi / 360
"""Beyond this angle, CartPole terminates."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Episode:
    """The record of an episode; the first row of states and observations comes from the reset.

    Attributes:
        states: The observations as the environment returned them, flattened, shape ``(n + 1, d)``.
        observations: The same as the policy received them, shape ``(n + 1, d)``.
        actions: The actions, n of them.
        rewards: The rewards, shape ``(n,)``.
        terminated: Whether the environment ended the episode, rather than the limit on its steps.
    """

    states: NDArray[np.float64]
    observations: NDArray[np.float64]
    actions: Sequence[Any]
    rewards: NDArray[np.float64]
    terminated: bool


def balance_cart_pole(observation: NDArray[Any]) -> int:
    """Balance the pole of CartPole near the middle of the track: push to the side to which it is about to fall."""
    return int(float(_CART_POLE_GAINS @ observation) > 0.0)


def pole_angle_margin(episode: Episode) -> float:
    """Return how far the pole of CartPole stayed from the angle at which it counts as fallen, in radians."""
    return float(CART_POLE_ANGLE_RAD - np.abs(episode.states[:, 2]).max())
