"""Words that the sentences of several kinds of findings share."""

import math
from typing import TYPE_CHECKING

from brink.server.states import ENDED

if TYPE_CHECKING:
    from brink.server.campaigns.store import Campaign


def counted(count: int, noun: str, nouns: str = "") -> str:
    """Return a count with its noun, such as ``no pair``, ``1 pair`` or ``1,200 pairs``."""
    if not count:
        return f"no {noun}"
    return f"{count:,} {noun if count == 1 else nouns or f'{noun}s'}"


def full_sentence(words: str) -> str:
    """Return words with a capital letter and a full stop."""
    return f"{as_sentence(words).removesuffix('.')}."


def so_far(campaign: "Campaign", words: str) -> str:
    """Return words about a campaign, prefixed with its progress if it has not ended."""
    if campaign.status in ENDED:
        return words
    return f"so far, after {campaign.evaluated:,} of {campaign.budget:,} simulations: {words}"


def listed_words(listed: int, distinct: int, what: str = "distinct boundary solution") -> str:
    """Return the number of solutions listed, and the total if not all are listed.

    Args:
        listed: How many are listed, best first.
        distinct: How many there are.
        what: What one of them is called.
    """
    if listed < distinct:
        return f"the best {listed:,} of {distinct:,} {what}s"
    return f"{listed:,} {what}" if listed == 1 else f"{listed:,} {what}s"


def percent(share: float, *, outward: int = 0) -> str:
    """Return a share in per cent with two significant digits.

    Args:
        share: The share, in [0, 1].
        outward: 1 to round up, -1 to round down, so that an interval is never narrower than it is.
    """
    return f"{rounded(100.0 * share, outward=outward)}%"


def rounded(number: float, *, outward: int = 0) -> str:
    """Return a number >= 0 with two significant digits; see `percent`."""
    if number <= 0:
        return "0"
    step = 10.0 ** (math.floor(math.log10(number)) - 1)
    steps = number / step - outward * 1e-9
    whole = round(steps) if not outward else math.ceil(steps) if outward > 0 else math.floor(steps)
    value = whole * step
    return f"{value:.2g}" if value < 99.5 else f"{value:,.0f}"


def as_sentence(words: str) -> str:
    """Return words with a capital letter at the beginning."""
    return words[:1].upper() + words[1:]
