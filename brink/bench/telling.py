"""How a measurement says how far it is."""

from collections.abc import Callable
from typing import TypeAlias

Told: TypeAlias = Callable[[str, int, int], None]
"""Hears of a part of the measurement what is done, and of how much."""
