"""Detectors that campaigns name: whether there is such a one, and whether its file loads."""

from typing import Final

from brink.sim.catalogue import plugin_ids
from brink.sim.perception.user_files import KINDS, DetectorError, check_loads

DETECTORS: Final = "brink.detectors"


def wrong_detector(name: str) -> list[tuple[str, str]]:
    """Return what is wrong with a detector, as the parameter and a message; nothing if it can be used."""
    known = plugin_ids(DETECTORS)
    if ":" not in name and name not in known:
        expected = ", ".join([*known, *(f"{kind}:FILE" for kind in KINDS)])
        return [("detector", f"expected one of {expected}; got {name!r}")]
    try:
        check_loads(name)
    except DetectorError as error:
        return [("detector", str(error).removeprefix("detector: "))]
    return []
