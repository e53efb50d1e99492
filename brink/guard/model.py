"""The model of a guard: boosted trees for each horizon, calibrated, stored as JSON and evaluated with NumPy alone.

A model says for which features and horizons it was fitted, and when it raises an alarm. The file format is

    {"format": "brink guard", "version": 1, "features": {"id": …, "names": […]}, "sensor": "boxes" | "range",
     "requirements": […], "horizons_s": […], "forest": {…}, "calibration": [[intercept, slope], …],
     "alarm": {"horizon_s": …, "threshold": …, "release": …, "confirm_steps": …, "hold_s": …}, "about": {…}}

It holds no code: everything that is read is checked, and a damaged file is refused with a `GuardFileError`.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Self

import numpy as np

from brink.forest import FeatureArray, FloatArray, Forest
from brink.guard.choices import Sensor
from brink.guard.features import ALL_FEATURES, FEATURES, FEATURES_ID
from brink.sim.errors import GuardFileError
from brink.sim.guard.option import MAX_FILE_BYTES
from brink.user_file import read_text

FORMAT: Final = "brink guard"
VERSION: Final = 1
MAX_CONFIRM_STEPS: Final = 50
MAX_HOLD_S: Final = 600.0


def feature_names(sensor: Sensor) -> tuple[str, ...]:
    """Return the names of the features of a car with a sensor, in order."""
    return FEATURES if sensor is Sensor.BOXES else ALL_FEATURES


@dataclass(frozen=True, slots=True, kw_only=True)
class AlarmRule:
    """When an alarm is raised, and when it ends.

    Attributes:
        horizon_s: The horizon whose probability decides.
        threshold: The alarm is raised once the probability has been at least this for `confirm_steps` steps.
        release: The alarm ends once the probability has been below this for `hold_s`.
        confirm_steps: Perception steps, at least 1.
        hold_s: Seconds, at least 0 and at most `MAX_HOLD_S`.
    """

    horizon_s: float
    threshold: float
    release: float
    confirm_steps: int = 2
    hold_s: float = 1.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.release <= self.threshold <= 1.0:
            raise ValueError(
                "alarm: expected 0 <= release <= threshold <= 1, "
                f"got a release of {self.release!r} and a threshold of {self.threshold!r}"
            )
        if type(self.confirm_steps) is not int or not 1 <= self.confirm_steps <= MAX_CONFIRM_STEPS:
            raise ValueError(
                f"alarm.confirm_steps: expected a whole number from 1 to {MAX_CONFIRM_STEPS}, "
                f"got {self.confirm_steps!r}"
            )
        if not 0.0 <= self.hold_s <= MAX_HOLD_S:  # which refuses NaN, too
            raise ValueError(f"alarm.hold_s: expected 0 to {MAX_HOLD_S:g} seconds, got {self.hold_s!r}")


def calibrated_probabilities(scores: FloatArray, calibration: FloatArray) -> FloatArray:
    """Return the probability of a violation within each horizon, shape ``(m, horizons)``.

    A longer horizon never has a smaller probability than a shorter one.

    Args:
        scores: Scores of the trees for each horizon, shape ``(m, horizons)``.
        calibration: Intercept and slope of each horizon, shape ``(horizons, 2)``.
    """
    log_odds = calibration[:, 0] + calibration[:, 1] * scores
    # Written with tanh, which cannot overflow.
    probabilities: FloatArray = 0.5 * (1.0 + np.tanh(0.5 * log_odds))
    return np.maximum.accumulate(probabilities, axis=1)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GuardModel:
    """Trees, their calibration, and the rule of the alarm.

    Attributes:
        sensor: What the car must have.
        requirements: Ids of the requirements whose violation it predicts.
        horizons_s: The horizons in seconds, ascending.
        forest: The trees; one model for each horizon.
        calibration: Intercept and slope that turn a score into calibrated log odds, shape ``(horizons, 2)``.
        alarm: The rule of the alarm.
        about: Provenance.
    """

    sensor: Sensor
    requirements: tuple[str, ...]
    horizons_s: tuple[float, ...]
    forest: Forest
    calibration: FloatArray
    alarm: AlarmRule
    about: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        horizons = np.asarray(self.horizons_s, np.float64)
        if not (
            horizons.size
            and np.isfinite(horizons).all()
            and horizons[0] > 0
            and (np.diff(horizons) > 0).all()
        ):
            raise ValueError(f"horizons_s: expected ascending numbers > 0, got {self.horizons_s!r}")
        if self.forest.offsets.size != horizons.size or self.calibration.shape != (horizons.size, 2):
            raise ValueError("expected one model and one calibration for each horizon")
        if not np.isfinite(self.calibration).all() or (self.calibration[:, 1] < 0).any():
            raise ValueError("calibration: expected finite numbers with slopes >= 0")
        if self.alarm.horizon_s not in self.horizons_s:
            raise ValueError(
                f"alarm.horizon_s: expected one of {self.horizons_s}, got {self.alarm.horizon_s!r}"
            )

    @property
    def deciding(self) -> int:
        """Index of the horizon whose probability decides about the alarm."""
        return self.horizons_s.index(self.alarm.horizon_s)

    def probabilities(self, features: FeatureArray) -> FloatArray:
        """Return the probability of a violation within each horizon, shape ``(m, horizons)``.

        A longer horizon never has a smaller probability than a shorter one.

        Args:
            features: Feature vectors in the order of `feature_names`, shape ``(m, features)``.
        """
        return calibrated_probabilities(self.forest.scores(features), self.calibration)

    def to_json(self) -> str:
        """Return the model as a JSON document."""
        alarm = self.alarm
        document = {
            "format": FORMAT,
            "version": VERSION,
            "features": {"id": FEATURES_ID, "names": list(feature_names(self.sensor))},
            "sensor": str(self.sensor),
            "requirements": list(self.requirements),
            "horizons_s": list(self.horizons_s),
            "forest": self.forest.to_document(),
            "calibration": self.calibration.tolist(),
            "alarm": {name: getattr(alarm, name) for name in alarm.__slots__},
            "about": dict(self.about),
        }
        return json.dumps(document, allow_nan=False)

    @classmethod
    def from_json(cls, text: str) -> Self:
        """Return the model in a JSON document.

        Raises:
            GuardFileError: The text is not a guard, or is one of another version or for other features.
        """
        try:
            document = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise GuardFileError(f"expected a guard: {error}") from None
        if not isinstance(document, dict) or document.get("format") != FORMAT:
            raise GuardFileError(f"expected a document with format {FORMAT!r}")
        if document.get("version") != VERSION:
            raise GuardFileError(
                f"expected version {VERSION}, got {document.get('version')!r:.80}: fit the guard again"
            )
        try:
            return cls._of(document)
        except (KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError) as error:
            raise GuardFileError(f"expected a guard: {type(error).__name__}: {error}") from None

    @classmethod
    def _of(cls, document: Mapping[str, Any]) -> Self:
        sensor = Sensor(document["sensor"])
        features = document["features"]
        if features["id"] != FEATURES_ID or tuple(features["names"]) != feature_names(sensor):
            raise GuardFileError(
                f"expected the features {FEATURES_ID}, got {features['id']!r:.80}: fit the guard again"
            )
        about = document["about"]
        return cls(
            sensor=sensor,
            requirements=_words(document["requirements"]),
            horizons_s=tuple(float(one) for one in document["horizons_s"]),
            forest=Forest.of(document["forest"], len(feature_names(sensor))),
            calibration=np.array(document["calibration"], np.float64),
            alarm=AlarmRule(**document["alarm"]),
            about=about if isinstance(about, dict) else {},
        )

    def save(self, path: str | Path) -> None:
        """Write the model to a file, atomically.

        Raises:
            OSError: The file cannot be written.
        """
        path = Path(path)
        part = path.with_name(f".{path.name}.part")
        part.write_text(self.to_json() + "\n", encoding="utf-8")
        part.replace(path)

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Return the model in a file.

        Raises:
            GuardFileError: The file does not contain a guard that this version can use.
            OSError: The file cannot be read.
        """
        path = Path(path)
        if path.stat().st_size > MAX_FILE_BYTES:
            raise GuardFileError(f"{path}: expected a guard of at most {MAX_FILE_BYTES} bytes")
        try:
            return cls.from_json(read_text(path, MAX_FILE_BYTES))
        except UnicodeDecodeError:
            raise GuardFileError(f"{path}: expected a guard, got a binary file") from None
        except GuardFileError as error:
            raise GuardFileError(f"{path}: {error}") from None


def _words(given: Sequence[Any]) -> tuple[str, ...]:
    if isinstance(given, str) or not given or not all(isinstance(one, str) for one in given):
        raise ValueError(f"requirements: expected a list of ids, got {given!r:.80}")
    return tuple(given)
