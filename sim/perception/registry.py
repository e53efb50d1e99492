"""Finds detectors by id, from the entry-point group `brink.detectors`."""

from collections.abc import Callable
from typing import Final, cast

from brink.sim.catalogue import load_plugin, plugin_ids
from brink.sim.episode import nearest
from brink.sim.errors import InvalidEpisode
from brink.sim.perception.adapters import file_detector
from brink.sim.perception.detector import Detector
from brink.sim.perception.errors import DetectorError
from brink.sim.perception.weights_file import KINDS

DETECTORS: Final = "brink.detectors"


def find_detector(detector_id: str) -> Detector:
    """Return the detector of an id; it may be shared, since detectors keep nothing between pictures.

    Args:
        detector_id: A registered one such as ``brink-det@1``, or a file of a user's: ``onnx:FILE``,
            ``torchscript:FILE``, ``ultralytics:FILE``.

    Raises:
        InvalidEpisode: None of that id is registered, or the file is no detector.
    """
    if ":" in detector_id:
        try:
            return file_detector(detector_id)
        except DetectorError as error:
            raise InvalidEpisode(str(error)) from error
    try:
        factory = load_plugin(DETECTORS, detector_id)
    except KeyError:
        known = plugin_ids(DETECTORS)
        expected = ", ".join([*known, *(f"{kind}:FILE" for kind in KINDS)]) + nearest(detector_id, known)
        raise InvalidEpisode(f"detector: expected one of {expected}; got {detector_id!r}") from None
    return cast(Callable[[], Detector], factory)()
