"""JSON from strangers: whatever comes, it is decoded or `BadJson` is raised.

NaN and Infinity, which Python takes for JSON, and integers of more digits than any of ours become numbers that are
not finite, for whoever checks ranges to refuse. Nesting past the interpreter's limit is bad JSON.
"""

import json
import math
from typing import Final

_MOST_DIGITS: Final = 18


class BadJson(ValueError):
    """Not JSON, or nested too deeply."""


def _constant(name: str) -> float:
    return math.nan if name == "NaN" else math.inf


def _integer(digits: str) -> int | float:
    return int(digits) if len(digits) <= _MOST_DIGITS else math.inf


_DECODER: Final = json.JSONDecoder(parse_constant=_constant, parse_int=_integer)


def decoded(text: str) -> object:
    """Return the value that a text is.

    Raises:
        BadJson: It is none.
    """
    stripped = text.strip()
    value, end = decoded_at(stripped, 0)
    if end != len(stripped):
        raise BadJson(f"expected nothing after character {end}")
    return value


def decoded_at(text: str, start: int) -> tuple[object, int]:
    """Return the value that begins at a character, and where it ends.

    Raises:
        BadJson: None begins there, or it is broken.
    """
    try:
        value, end = _DECODER.raw_decode(text, start)
    except RecursionError:
        raise BadJson("nested too deeply") from None
    except ValueError as error:
        reason = error.msg if isinstance(error, json.JSONDecodeError) else "malformed"
        raise BadJson(reason) from None
    return value, end
