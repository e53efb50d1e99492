"""The problem `urban-injected@1`: an urban scenario with injected obstacle detections.

The scenario has seven categorical parameters, the behaviour two injected trajectories with eleven parameters each.
Source: Sharifi et al. 2023, section 4 (see docs/explanation/hazard-boundary.md).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from brink.search.algorithm import Evaluation, Scored
from brink.search.errors import ConfigError
from brink.search.settings import check_settings, setting
from brink.search.space import (
    Categorical,
    Component,
    Constraint,
    Dormant,
    Duration,
    Extent,
    Integer,
    Parameter,
    Real,
    SearchSpace,
)
from brink.server.errors import nearest
from brink.server.problems.base import Vectors
from brink.sim.catalogue import REQUIREMENTS as REQUIREMENT_PLUGINS
from brink.sim.catalogue import plugin_ids
from brink.sim.episode import EpisodeSpec, Json
from brink.sim.urban import behaviour as b
from brink.sim.world.scenario import (
    PEDESTRIAN_COUNTS,
    ROAD_IDS,
    ROAD_LENGTHS,
    SCENARIO_CHOICES,
    words_of_scenario,
)
from brink.worker.wire import Completed

SIMULATOR = "brink-drive@2"
REQUIREMENTS = (
    "front-gap@1",
    "no-collision@1",
    "lane-keeping@1",
    "red-light@1",
    "speed-limit@1",
    "progress@1",
)
BOX_SIGMA_PX = 40.0
"""Standard deviation of the mutation of a box coordinate: a tenth of 400 px."""

_INTEGER_SCENARIO = {"pedestrians": PEDESTRIAN_COUNTS, "road_id": ROAD_IDS, "road_length": ROAD_LENGTHS}


@dataclass(frozen=True, slots=True, kw_only=True)
class UrbanInjectedParams:
    """Parameters of the problem."""

    requirement: str = setting(
        "front-gap@1",
        help="Id of the requirement that gives the verdict; all built-in requirements are recorded.",
    )
    duration_s: float = setting(
        b.DEFAULT_DURATION_S, ge=5.0, le=120.0, unit="s", help="Length of an episode."
    )
    fidelity: str = setting("bicycle", help="Vehicle model of the ego.", choices=("bicycle", "wheels"))
    timeout_s: float = setting(60.0, gt=0.0, le=3600.0, unit="s", help="Wall-clock limit of an episode.")

    def __post_init__(self) -> None:
        check_settings(self)
        known = plugin_ids(REQUIREMENT_PLUGINS)
        if self.requirement not in known:
            raise ConfigError(
                "requirement",
                f"expected one of {', '.join(known)}; got {self.requirement!r}",
                nearest=nearest(self.requirement, known),
            )


def scenario_component() -> Component:
    """Return the seven categorical parameters of a scenario."""
    return Component(
        name="scenario",
        parameters=tuple(
            Categorical(name=name, choices=tuple(str(choice) for choice in choices))
            for name, choices in SCENARIO_CHOICES.items()
        ),
    )


def behaviour_component(duration_s: float) -> Component:
    """Return the component of the two injected trajectories."""
    parameters: list[Parameter] = []
    constraints: list[Constraint | Dormant] = []
    horizon = b.last_perception_step(duration_s)
    for index in range(1, b.TRAJECTORY_COUNT + 1):
        prefix = f"trajectory_{index}."
        parameters.append(Categorical(name=prefix + "label", choices=b.TRAJECTORY_LABELS))
        for name, (low, high, unit) in b.trajectory_ranges(duration_s).items():
            if name.endswith("_step"):
                parameters.append(Integer(name=prefix + name, low=int(low), high=int(high), unit=unit))
            else:
                parameters.append(Real(name=prefix + name, low=low, high=high, unit=unit, sigma=BOX_SIGMA_PX))
        constraints.append(
            Duration(
                start=prefix + "t0_step",
                end=prefix + "t1_step",
                minimum=int(np.ceil(horizon * b.MIN_DURATION_SHARE)),
                horizon=horizon,
            )
        )
        constraints += [
            Extent(
                low=f"{prefix}{axis}_min_{end}_px",
                high=f"{prefix}{axis}_max_{end}_px",
                minimum=b.MIN_BOX_PX,
                size=float(size),
            )
            for end in (0, 1)
            for axis, size in (("x", b.IMAGE_WIDTH_PX), ("y", b.IMAGE_HEIGHT_PX))
        ]
        constraints.append(
            Dormant(
                label=prefix + "label",
                null_choice=b.NULL_LABEL,
                members=tuple(prefix + name for name in b.TRAJECTORY_FIELDS if name != "label"),
            )
        )
    return Component(name="behaviour", parameters=tuple(parameters), constraints=tuple(constraints))


class UrbanInjected:
    """Urban driving with an obstacle detector whose detections are injected."""

    id: ClassVar[str] = "urban-injected@1"
    summary: ClassVar[str] = "Urban driving with injected obstacle detections: 7 + 22 parameters."
    params_type: ClassVar[type[Any]] = UrbanInjectedParams

    def __init__(self, params: UrbanInjectedParams) -> None:
        self.params = params
        self.space = SearchSpace((scenario_component(), behaviour_component(params.duration_s)))
        self.algorithm_defaults: Mapping[str, Any] = {}
        self.needs = SIMULATOR
        self.timeout_s = params.timeout_s

    def episode(self, vectors: Vectors, seed: int) -> EpisodeSpec:
        """Return the episode of a scenario and a behaviour."""
        decoded = self.space.decode(tuple(vectors))
        return EpisodeSpec(
            simulator=SIMULATOR,
            scenario=_scenario(decoded["scenario"]),
            behaviour=_behaviour(decoded["behaviour"]),
            requirements=tuple(dict.fromkeys((*REQUIREMENTS, self.params.requirement))),
            seed=seed,
            duration_s=self.params.duration_s,
            options={"fidelity": self.params.fidelity},
        )

    def words(self, vectors: Vectors) -> str:
        """Describe a candidate."""
        decoded = self.space.decode(tuple(vectors))
        trajectories = _behaviour(decoded["behaviour"])["trajectories"]
        return f"{words_of_scenario(_scenario(decoded['scenario']))}; {b.words_of_behaviour(trajectories)}"

    def evaluation(self, outcome: Completed) -> Evaluation:
        """Return the chosen requirement's verdict and all objectives."""
        verdict = outcome.verdicts[self.params.requirement]
        return Scored(
            unsafe=verdict.robustness < 0, robustness=verdict.robustness, objectives=outcome.objectives
        )


def _scenario(values: Mapping[str, Any]) -> dict[str, Json]:
    return {name: int(value) if name in _INTEGER_SCENARIO else value for name, value in values.items()}


def _behaviour(values: Mapping[str, Any]) -> dict[str, Json]:
    trajectories: list[Json] = [
        {name: values[f"trajectory_{index}.{name}"] for name in b.TRAJECTORY_FIELDS}
        for index in range(1, b.TRAJECTORY_COUNT + 1)
        if values[f"trajectory_{index}.label"] != b.NULL_LABEL
    ]
    return {"mode": b.BehaviourMode.INJECTED.value, "trajectories": trajectories}
