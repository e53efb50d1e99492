"""Owns how a look chooses among colours and shapes: always the same way, unlike from one question to the next."""

from typing import Final

_MULTIPLIER: Final = 0x9E3779B97F4A7C15
_MASK: Final = (1 << 64) - 1


def choice(look: int, question: int, count: int) -> int:
    """Return a number from 0 to count - 1 for a look; `question` tells independent choices apart."""
    mixed = (look * _MULTIPLIER + question * 0xD1B54A32D192ED03 + 0x632BE59BD9B4E019) & _MASK
    mixed ^= mixed >> 31
    mixed = (mixed * 0xBF58476D1CE4E5B9) & _MASK
    mixed ^= mixed >> 29
    return (mixed >> 11) % count


def share(look: int, question: int) -> float:
    """Return a number in [0, 1) for a look."""
    return choice(look, question, 4096) / 4096
