"""Small guards and recorded drives made by hand."""

from collections.abc import Sequence

import numpy as np

from brink.forest import Forest
from brink.guard.choices import Sensor
from brink.guard.drives import Drive, behaviour_of, scenario_of
from brink.guard.features import ALL_FEATURES
from brink.guard.model import AlarmRule, GuardModel, feature_names
from brink.sim.episode import EpisodeSpec

REQUIREMENT = "front-gap@1"


def stump_guard(
    *,
    sensor: Sensor = Sensor.BOXES,
    feature: str = "speed_mps",
    above: float = 5.0,
    alarm: AlarmRule | None = None,
) -> GuardModel:
    """Return a guard with one tree for each horizon: log odds of 2, 3 and 4 above a value of a feature, else -2."""
    place = feature_names(sensor).index(feature)
    return GuardModel(
        sensor=sensor,
        requirements=(REQUIREMENT,),
        horizons_s=(1.0, 2.0, 3.0),
        forest=Forest.of(
            {
                "right": [2, 0, 0, 5, 0, 0, 8, 0, 0],
                "feature": [place, 0, 0] * 3,
                "value": [above, -2.0, 2.0, above, -2.0, 3.0, above, -2.0, 4.0],
                "roots": [0, 3, 6],
                "owners": [0, 1, 2],
                "offsets": [0.0, 0.0, 0.0],
            },
            len(feature_names(sensor)),
        ),
        calibration=np.array([[0.0, 1.0]] * 3),
        alarm=alarm or AlarmRule(horizon_s=3.0, threshold=0.5, release=0.25, confirm_steps=2, hold_s=0.5),
        about={"problem": {"id": "urban-injected@1", "params": {}}, "drives": 2, "violations": 1},
    )


def drive_with(
    values: Sequence[float],
    *,
    feature: str = "speed_mps",
    violated_at_s: float | None = None,
    begins_s: float = 0.0,
    scenario: str = "{}",
    spec: EpisodeSpec | None = None,
) -> Drive:
    """Return a recorded drive in which one feature has the given values, and all others are 0.

    Its scenario and digest are those of an episode, if one is given.
    """
    behaviour, seed = "{}", 0
    if spec is not None:
        scenario, behaviour, seed = scenario_of(spec), behaviour_of(spec), spec.seed
    features = np.zeros((len(values), len(ALL_FEATURES)), np.float16)
    features[:, ALL_FEATURES.index("ttc_s")] = features[:, ALL_FEATURES.index("range_path_ttc_s")] = 10.0
    features[:, ALL_FEATURES.index(feature)] = values
    return Drive(
        digest="" if spec is None else spec.digest(),
        scenario=scenario,
        behaviour=behaviour,
        seed=seed,
        features=features,
        begins_s=begins_s,
        violated_at_s={REQUIREMENT: violated_at_s},
        robustness={REQUIREMENT: 1.0 if violated_at_s is None else -1.0},
        ended_at_s=begins_s + 0.1 * len(values),
    )
