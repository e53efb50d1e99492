"""Solutions from the text of a reply, one by one: what is valid is kept, the rest is listed with its errors.

Never trusted: text may be anything. JSON is looked for plain, in fences, after chatter or thoughts; a list that
breaks off gives its complete items. Errors are words of ours with JSON pointers, fit to be sent back.
"""

import itertools
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

from brink.search.traffic.participants import Solution
from brink.server.errors import FieldError
from brink.server.llm.drivable import Drivable
from brink.server.llm.form import read
from brink.server.llm.untrusted_json import BadJson, decoded_at

MOST_CHARS: Final = 1_000_000
"""Text after so much is not looked at."""
MOST_ERRORS: Final = 40

_MOST_BROKEN: Final = 8
_MOST_LISTS: Final = 4
_THOUGHTS_END: Final = "</think>"
_LIST: Final = re.compile(r'"solutions"\s*:\s*\[')
_BARE_LIST: Final = re.compile(r'\[(?=\s*\{\s*"participants")')
_ITEM: Final = re.compile(r'\{\s*"participants"')
_BETWEEN: Final = re.compile(r"[\s,]*")


@dataclass(frozen=True, slots=True, kw_only=True)
class Parsed:
    """What of a reply can be used.

    Attributes:
        solutions: Valid ones, as the road has them, each once.
        errors: What is wrong with the others, and with the reply.
        found: Items that were looked at.
    """

    solutions: tuple[Solution, ...] = ()
    errors: tuple[FieldError, ...] = ()
    found: int = 0


class _Broken:
    """Stands for an item that cannot be decoded."""


_BROKEN: Final = _Broken()


@dataclass(slots=True)
class _Scan:
    """Items of a list. Changes in place.

    Attributes:
        items: Decoded values, `_BROKEN` where there is none.
        closed: Whether the list came to its end.
    """

    items: list[object] = field(default_factory=list)
    closed: bool = False

    @property
    def whole(self) -> int:
        """How many items could be decoded."""
        return sum(item is not _BROKEN for item in self.items)


def parse(text: str, drivable: Drivable, wanted: int, known: Sequence[Solution] = ()) -> Parsed:
    """Return the solutions in the text of a reply, at most as many as are wanted.

    Args:
        text: Whatever came.
        drivable: Knows the road.
        wanted: How many solutions.
        known: Solutions that are not taken again.
    """
    scan = _scanned(text[:MOST_CHARS], most=4 * wanted + 16)
    if scan is None:
        message = 'expected one JSON object {"solutions": [...]}, found none'
        return Parsed(errors=(FieldError(pointer="", message=message),))
    taken: dict[Solution, str] = dict.fromkeys(known, "a solution that was accepted before")
    solutions: list[Solution] = []
    errors: list[FieldError] = []
    for place, item in enumerate(scan.items):
        if len(solutions) == wanted:
            break
        pointer = f"/solutions/{place}"
        placed = _placed(item, drivable, pointer)
        if isinstance(placed, list):
            errors += placed
        elif placed in taken:
            errors.append(FieldError(pointer=pointer, message=f"the same as {taken[placed]}"))
        else:
            taken[placed] = pointer
            solutions.append(placed)
    if not scan.closed and len(solutions) < wanted:
        message = "the reply breaks off before the list ends: write less, and no text beside the JSON"
        errors.append(FieldError(pointer="/solutions", message=message))
    elif not scan.items:
        errors.append(FieldError(pointer="/solutions", message=f"expected {wanted} solutions, got none"))
    return Parsed(solutions=tuple(solutions), errors=tuple(errors[:MOST_ERRORS]), found=len(scan.items))


def _placed(item: object, drivable: Drivable, pointer: str) -> Solution | list[FieldError]:
    if item is _BROKEN:
        return [FieldError(pointer=pointer, message="expected JSON, got something broken or unfinished")]
    solution = read(item, drivable.most, pointer)
    return solution if isinstance(solution, list) else drivable.placed(solution, pointer)


def _scanned(text: str, most: int) -> _Scan | None:
    """Return the list with the most items, the last of those; None if there is none."""
    answer = text.rpartition(_THOUGHTS_END)[2]
    for part in (answer, text):
        lists = list(itertools.islice(_LIST.finditer(part), _MOST_LISTS)) or [
            *itertools.islice(_BARE_LIST.finditer(part), 1)
        ]
        if lists:
            scans = [_list_from(part, found.end(), most) for found in lists]
            return max(reversed(scans), key=lambda scan: scan.whole)
        if _ITEM.search(part):
            return _loose_items(part, most)
    return None


def _list_from(text: str, start: int, most: int) -> _Scan:
    """Return the items of the list that begins before a character; past a broken one it goes on at the next."""
    scan, at, broken = _Scan(), start, 0
    while len(scan.items) < most and broken < _MOST_BROKEN:
        between = _BETWEEN.match(text, at)
        at = between.end() if between else at
        if text[at : at + 1] in ("]", ""):
            scan.closed = at < len(text)
            return scan
        try:
            item, at = decoded_at(text, at)
        except BadJson:
            item, broken = _BROKEN, broken + 1
        scan.items.append(item)
        if item is _BROKEN:
            following = _ITEM.search(text, at + 1)
            if following is None:
                return scan
            at = following.start()
    scan.closed = broken < _MOST_BROKEN
    return scan


def _loose_items(text: str, most: int) -> _Scan:
    """Return items that are in no list."""
    scan, at, broken = _Scan(), 0, 0
    while len(scan.items) < most and broken < _MOST_BROKEN and (found := _ITEM.search(text, at)):
        try:
            item, at = decoded_at(text, found.start())
        except BadJson:
            item, at, broken = _BROKEN, found.end(), broken + 1
        scan.items.append(item)
    scan.closed = not broken
    return scan
