"""Text from others, made harmless for terminals and logs.

Messages of workers, names in imported files and text of plug-ins may contain escape sequences, which change what a
terminal shows or does, and marks that reverse the order of letters.
"""

import re
from typing import Final

_CONTROLS: Final = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]"
)
"""Control characters but for tab and line feed, marks that change the direction of text, and lone surrogates."""


def printable(text: str) -> str:
    r"""Return a text with every control character written out, such as ``\u001b``, which JSON reads as well."""
    return _CONTROLS.sub(lambda found: f"\\u{ord(found[0]):04x}", text)
