"""The problem `urban-camera@1`: an urban scenario with a camera and an obstacle detector in the loop.

The scenario is that of `urban-injected@1`. Episodes also record the detector's errors, so that it can be checked
against a requirement (docs/how-to/set-a-requirement.md).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Self

from brink.search.settings import setting
from brink.search.space import SearchSpace
from brink.server.problems.base import SimulatedProblem, Vectors, wrong_detector
from brink.server.problems.driving_systems import Driven, about_driving
from brink.server.problems.requirements import Stated, formulas_in, requirement_setting
from brink.server.problems.urban_injected import (
    REQUIREMENTS,
    URBAN_MEASURES,
    UrbanParams,
    scenario_component,
    scenario_of,
)
from brink.sim.episode import EpisodeSpec, Json
from brink.sim.perception.user_files import DEFAULT_DETECTOR, weights_digest
from brink.sim.world.scenario import words_of_scenario

SIMULATOR = "brink-drive-camera@3"
WITH_TRUTH = "brink-drive-errors@2"


@dataclass(frozen=True, slots=True, kw_only=True)
class UrbanCameraParams(UrbanParams):
    """Parameters of the problem."""

    requirement: Stated = requirement_setting(["front-gap@1", "no-collision@1"], REQUIREMENTS)  # noqa: RUF009
    detector: str = setting(
        DEFAULT_DETECTOR, help="Id of the detector, or a file: onnx:FILE, torchscript:FILE, ultralytics:FILE."
    )
    threshold: float = setting(0.5, help="Minimum score of detections that count.", gt=0.0, lt=1.0)
    timeout_s: float = setting(120.0, gt=0.0, le=3600.0, unit="s", help="Wall-clock limit of an episode.")


class UrbanScenarios(Driven, SimulatedProblem):
    """Urban driving in which a candidate is a scenario, and the obstacle detector is the same in all of them.

    Attributes:
        simulator: Id of the simulator with the detector.
    """

    id: ClassVar[str]
    simulator: ClassVar[str]
    errors_problem = "urban-errors@1"
    recorded = REQUIREMENTS
    measures = URBAN_MEASURES
    has_component = True
    params: UrbanParams

    def __init__(self, params: Any) -> None:
        self.params = params
        self.space = SearchSpace((scenario_component(),))
        self.requirements = params.requirements
        self.formulas = formulas_in(params.requirement)
        self.needs = self.simulator
        self.timeout_s = params.timeout_s
        self.about_component = (type(self).about_component + about_driving(params.driving)).strip()

    def behaviour(self, seed: int) -> Mapping[str, Json]:
        """Return the behaviour of the detector in an episode."""
        raise NotImplementedError

    def episode(self, vectors: Vectors, seed: int) -> EpisodeSpec:
        """Return the episode of a scenario."""
        return EpisodeSpec(
            simulator=self.needs,
            scenario=scenario_of(self.space.decode(tuple(vectors))["scenario"]),
            behaviour={"mode": "errors", "errors": []} if self.is_true else self.behaviour(seed),
            requirements=self.evaluated,
            formulas=self.formulas,
            seed=seed,
            duration_s=self.params.duration_s,
            options=self.params.options,
        )

    def with_truth(self) -> Self | None:
        """Return the problem with a detector that reports the truth; None if this is it."""
        truth = super().with_truth()
        if truth is not None:
            truth.needs = WITH_TRUTH
        return truth

    def words(self, vectors: Vectors) -> str:
        """Describe a candidate."""
        return words_of_scenario(scenario_of(self.space.decode(tuple(vectors))["scenario"]))


class UrbanCamera(UrbanScenarios):
    """Urban driving with an obstacle detector on rendered camera images."""

    id: ClassVar[str] = "urban-camera@1"
    summary: ClassVar[str] = "Urban driving with a camera and an obstacle detector in the loop: 7 parameters."
    params_type: ClassVar[type[Any]] = UrbanCameraParams
    about_component = (
        "The detector is the one that the campaign names, on rendered images. On recorded ones it may err otherwise "
        "(see “Set a requirement for a detector” in Brink's documentation)."
    )
    simulator: ClassVar[str] = SIMULATOR
    extra = "vision"
    modules = ("cv2", "onnxruntime")
    params: UrbanCameraParams

    def __init__(self, params: UrbanCameraParams) -> None:
        super().__init__(params)
        self.measured_detector = params.detector

    def wrong_inputs(self) -> list[tuple[str, str]]:
        """Return what is wrong with the driving system's name, and with the detector's name or file."""
        return [*super().wrong_inputs(), *wrong_detector(self.params.detector)]

    def behaviour(self, seed: int) -> Mapping[str, Json]:
        """Return the detector."""
        params = self.params
        behaviour: dict[str, Json] = {
            "mode": "detector",
            "detector": params.detector,
            "threshold": params.threshold,
        }
        if digest := weights_digest(params.detector):
            behaviour["weights"] = digest
        return behaviour
