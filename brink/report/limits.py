"""Limits and file formats of reports: cheap to import."""

from typing import Final

MOST_PAIRS: Final = 6
"""Pairs that a report shows in full, unless told otherwise."""
FILMS: Final = (".mp4", ".gif")
"""Endings of files that hold films."""
