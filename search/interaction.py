"""Interaction: how much more a chain of techniques harms a component than its most harmful part does.

The *added harm* of a chain is the alpha of its most harmful part minus its own alpha. A chain without added harm owes
its harm to one of its parts; its other steps are free riders. Harms that merely add up count: a chain that loses what
its parts lose together has added harm, although no part affects another. Alphas here are qualities, such as the mAP
on a data set: lower values are more harm. They say nothing about hazards in drives.
"""

from collections.abc import Mapping
from typing import Final

from brink.search.slots import Chain, parts_of

_TOLERANCE: Final = 1e-9
"""Added harm counts if it falls short of the margin by at most this, so that rounding decides nothing."""


def added_harm(chain: Chain, alphas: Mapping[Chain, float]) -> float | None:
    """Return how far the alpha of a chain lies below that of its most harmful part.

    Args:
        chain: The chain.
        alphas: Known qualities of the component by chain. Parts of two steps or more count if they are here.

    Returns:
        None if the chain has only one step, or its alpha or that of one of its steps alone is unknown.
    """
    if len(chain) < 2 or chain not in alphas or any((step,) not in alphas for step in chain):
        return None
    return min(alphas[part] for part in parts_of(chain) if part in alphas) - alphas[chain]


def interacts(harm: float, margin: float) -> bool:
    """Return whether a chain with so much added harm interacts; NaN does not."""
    return harm >= margin - _TOLERANCE
