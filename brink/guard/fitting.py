"""Fitting a guard to recorded drives."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import numpy as np

from brink import __version__
from brink.guard.choices import FALSE_ALARMS, Sensor
from brink.guard.drives import Drive
from brink.guard.evaluation import confirmed, peak, threshold_at
from brink.guard.model import AlarmRule, GuardModel, calibrated_probabilities, feature_names
from brink.guard.seen import ABOUT, SeenDrives
from brink.search.analysis.guard_training import fit_horizons
from brink.search.streams import Stream, generator
from brink.server.errors import Conflict

HORIZONS_S: Final = (1.0, 2.0, 3.0)
CONFIRM_STEPS: Final = 2
HOLD_S: Final = 1.0
RELEASE_SHARE: Final = 0.5
"""The alarm ends below this share of its threshold."""


def fit(
    drives: Sequence[Drive],
    requirements: Sequence[str],
    *,
    sensor: Sensor = Sensor.BOXES,
    horizons_s: Sequence[float] = HORIZONS_S,
    false_alarms: float = FALSE_ALARMS,
    seed: int = 1,
    about: Mapping[str, Any] | None = None,
    on_progress: Callable[[int, int], None] | None = None,
) -> GuardModel:
    """Fit a guard.

    The alarm goes by the longest horizon. Its threshold is the lowest at which models that did not see a drive raise
    an alarm in at most the wanted share of the safe drives.

    Args:
        drives: Recorded drives.
        requirements: Ids of the requirements whose violation it predicts.
        sensor: The sensors of the car.
        horizons_s: Horizons in seconds, ascending.
        false_alarms: Share of safe drives that may have an alarm.
        seed: Divides the drives.
        about: Provenance to store.
        on_progress: Called with the number of fitted models and their total.

    Raises:
        MissingExtra: scikit-learn is not installed.
        Conflict: There are too few drives with or without a violation.
    """
    series = [drive.series(requirements, len(feature_names(sensor))) for drive in drives]
    try:
        fitted = fit_horizons(series, horizons_s, generator(seed, Stream.GUARD), on_progress)
    except ValueError as error:
        raise Conflict(str(error)) from None
    peaks = [
        peak(confirmed(calibrated_probabilities(scores, fitted.calibration)[:, -1], CONFIRM_STEPS))
        for scores, drive in zip(fitted.unseen, series, strict=True)
        if not drive.violated
    ]
    threshold = float(np.clip(threshold_at(np.array(peaks), false_alarms), np.nextafter(0.0, 1.0), 1.0))
    return GuardModel(
        sensor=sensor,
        requirements=tuple(requirements),
        horizons_s=tuple(horizons_s),
        forest=fitted.forest,
        calibration=fitted.calibration,
        alarm=AlarmRule(
            horizon_s=horizons_s[-1],
            threshold=threshold,
            release=RELEASE_SHARE * threshold,
            confirm_steps=CONFIRM_STEPS,
            hold_s=HOLD_S,
        ),
        about={
            "brink": __version__,
            "drives": len(drives),
            "violations": sum(one.violated for one in series),
            "false_alarms": false_alarms,
            ABOUT: SeenDrives.of(drives).to_json(),
            **(about or {}),
        },
    )
