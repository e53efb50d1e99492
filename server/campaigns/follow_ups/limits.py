"""Sizes of follow-ups: limits and defaults, cheap to import."""

from typing import Final

MOST: Final = 1_000
"""Maximum number of solutions, best first; limited because they are part of a campaign's parameters."""
MOST_PAIRS_FOLLOWED: Final = MOST // 2
"""Maximum number of pairs in a follow-up, checked ones first."""
DEFAULT_CONFIRMATIONS: Final = 30
"""Maximum number of simulations of each side, to confirm pairs; a clear side takes 15, or 4."""
DEFAULT_REPEATS: Final = 50
"""Simulations of each boundary solution, to repeat it."""
