"""Finds detectors by id, from the entry-point group `brink.detectors`."""

from collections.abc import Callable
from typing import Final, cast

from sim.catalogue import load_plugin, plugin_ids
from sim.errors import InvalidEpisode
from sim.perception.detector import Detector
from sim.urban.scenario import nearest

DETECTORS: Final = "brink.detectors"


def find_detector(detector_id: str) -> Detector:
    """Return the detector of an id; it may be shared, since detectors keep nothing between pictures.

    Raises:
        InvalidEpisode: None of that id is registered; the message names those that are.
    """
    try:
        factory = load_plugin(DETECTORS, detector_id)
    except KeyError:
        known = plugin_ids(DETECTORS)
        expected = f"{', '.join(known) or 'none'}{nearest(detector_id, known)}"
        raise InvalidEpisode(f"detector: expected one of {expected}; got {detector_id!r}") from None
    return cast(Callable[[], Detector], factory)()
