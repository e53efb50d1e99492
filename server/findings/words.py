"""Counts in words."""


def listed_words(listed: int, distinct: int, what: str = "distinct boundary solution") -> str:
    """Return how many solutions are listed, and of how many if these are not all.

    Args:
        listed: How many are listed, best first.
        distinct: How many there are.
        what: What one of them is called.
    """
    if listed < distinct:
        return f"the best {listed:,} of {distinct:,} {what}s"
    return f"{listed:,} {what}" if listed == 1 else f"{listed:,} {what}s"
