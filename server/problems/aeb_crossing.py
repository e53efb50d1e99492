"""The problem `aeb-crossing@1`: perturbations of camera images that make emergency braking hazardous.

A candidate combines a scenario (time of day, weather, the pedestrian's place and time) with ordered perturbations,
each a gene at a level. It is simulated, or measured on a data set, for which only the perturbations matter.
"""

from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from brink.search.algorithm import Measured
from brink.search.errors import ConfigError
from brink.search.parameters import ResolutionByChoice
from brink.search.settings import check_settings, setting
from brink.search.slots import Slots
from brink.search.space import Categorical, Component, Real, SearchSpace
from brink.server.errors import nearest
from brink.server.problems.base import SimulatedProblem, SimulatedSolution, Vectors, wrong_detector
from brink.server.problems.changes import different
from brink.server.problems.resolutions import RESOLUTION_M, RESOLUTION_S
from brink.sim.aeb.braking import PERSON_FRAMES, PERSON_WINDOW
from brink.sim.aeb.specification import (
    ARRIVAL_S,
    CROSSING_M,
    ONCOMING_M,
    SIZE_PX,
    TIMES,
    WEATHERS,
    Obstacle,
    Occluder,
    SightMode,
    describe_perturbations,
    describe_street,
)
from brink.sim.episode import EpisodeSpec, Json
from brink.sim.perception.user_files import (
    DEFAULT_DETECTOR,
    DatasetError,
    check_loads,
    check_sample,
    read_coco,
    weights_digest,
)
from brink.sim.perturbations import CATALOGUE
from brink.worker.wire import Completed

SIMULATOR = "brink-aeb@3"
EVALUATOR = "brink-dataset@2"
ACCIDENT = "no-collision@1"
DANGEROUS_STOP = "no-dangerous-stop@1"
EVERY = "all"
HAZARDS = {"any": (ACCIDENT, DANGEROUS_STOP), "accident": (ACCIDENT,), "dangerous-stop": (DANGEROUS_STOP,)}
"""Requirements whose violation is the hazard, by the name of the hazard."""
_SCENARIO = {
    "time_of_day": "at {} instead of {}",
    "weather": "weather {} instead of {}",
    "occluder": "the pedestrian steps out from behind a {} instead of a {}",
    "crossing_m": "the pedestrian crosses after {} m instead of {} m",
    "arrival_s": "the pedestrian is in mid-lane {} s instead of {} s after a car that does not brake",
    "oncoming_m": "oncoming car at {} m instead of {} m",
}
"""How a change of the scenario is described: its new value, then its old one."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AebCrossingParams:
    """Parameters of the problem."""

    hazard: str = setting("any", help="Hazard that counts as unsafe.", choices=tuple(HAZARDS))
    perturbations: int = setting(
        2, help="Number of perturbations in a candidate (m in the paper).", ge=1, le=4
    )
    techniques: str = setting(
        EVERY, help="Techniques to use, separated by commas (brink perturbations list), or all."
    )
    fields: str = setting(
        "per_frame",
        help="How often the random fields of perturbations are drawn.",
        choices=("per_frame", "per_episode"),
    )
    detector: str = setting(
        DEFAULT_DETECTOR, help="Id of the detector, or a file: onnx:FILE, torchscript:FILE, ultralytics:FILE."
    )
    threshold: float = setting(0.45, help="Minimum score of detections that count.", gt=0.0, lt=1.0)
    person_frames: int = setting(
        PERSON_FRAMES,
        help="Number of the last three frames in which a person must be reported, to brake (1 in the paper).",
        ge=1,
        le=PERSON_WINDOW,
    )
    obstacle: str = setting(
        "none", help="Additional obstacle on the road.", choices=tuple(item.value for item in Obstacle)
    )
    duration_s: float = setting(15.0, help="Maximum length of an episode.", ge=5.0, le=60.0, unit="s")
    width_px: int = setting(
        640, help="Width of the camera image; its aspect ratio is 16:9.", ge=160, le=1280, unit="px"
    )
    dataset: str = setting(
        "simulator", help="Images to measure on: the simulator's, or a file with annotations in COCO format."
    )
    dataset_frames: int = setting(60, help="Number of images to use from the data set.", ge=10, le=5_000)
    timeout_s: float = setting(120.0, help="Wall-clock limit of an episode.", gt=0.0, le=3600.0, unit="s")

    def __post_init__(self) -> None:
        check_settings(self)
        for name in self.genes:
            if name not in CATALOGUE:
                raise ConfigError(
                    "techniques",
                    f"expected {EVERY}, or some of {', '.join(CATALOGUE)}; got {name!r}",
                    nearest=nearest(name, CATALOGUE),
                )
        if len(self.genes) < self.perturbations:
            raise ConfigError(
                "techniques", f"expected at least {self.perturbations} techniques, got {len(self.genes)}"
            )

    @property
    def genes(self) -> tuple[str, ...]:
        """The techniques to use, without duplicates."""
        if self.techniques.strip() == EVERY:
            return tuple(CATALOGUE)
        return tuple(dict.fromkeys(filter(None, (name.strip() for name in self.techniques.split(",")))))


def scenario_component() -> Component:
    """Return the component that describes the street."""
    return Component(
        "scenario",
        (
            Categorical("time_of_day", tuple(item.value for item in TIMES)),
            Categorical("weather", tuple(item.value for item in WEATHERS)),
            Categorical("occluder", tuple(item.value for item in Occluder)),
            Real("crossing_m", *CROSSING_M, unit="m", resolution=RESOLUTION_M),
            Real("arrival_s", *ARRIVAL_S, unit="s", resolution=RESOLUTION_S),
            Real("oncoming_m", *ONCOMING_M, unit="m", resolution=RESOLUTION_M),
        ),
    )


def perturbation_component(count: int, genes: tuple[str, ...] = tuple(CATALOGUE)) -> Component:
    """Return the component of ordered perturbations, each a gene and an intensity that selects its level."""
    pairs = tuple((f"gene_{place}", f"intensity_{place}") for place in range(1, count + 1))
    levels = {gene: 1.0 / (CATALOGUE[gene].levels - 1) for gene in genes}
    return Component(
        "perturbation",
        tuple(
            parameter
            for gene, intensity in pairs
            for parameter in (
                Categorical(gene, genes),
                Real(intensity, 0.0, 1.0, resolution=ResolutionByChoice(gene, levels)),
            )
        ),
        (Slots(pairs, tuple(CATALOGUE[gene].levels for gene in genes)),),
    )


class AebCrossing(SimulatedProblem):
    """Emergency braking with perturbed images when a pedestrian steps out between parked cars."""

    id: ClassVar[str] = "aeb-crossing@1"
    summary: ClassVar[str] = "Emergency braking with perturbed images: 6 parameters, and 2 per perturbation."
    params_type: ClassVar[type[Any]] = AebCrossingParams
    extra = "vision"
    modules = ("cv2", "onnxruntime")
    recorded = (ACCIDENT, DANGEROUS_STOP)
    has_component = True

    def __init__(self, params: AebCrossingParams) -> None:
        self.params = params
        self.space = SearchSpace(
            (scenario_component(), perturbation_component(params.perturbations, params.genes))
        )
        self.requirements = HAZARDS[params.hazard]
        self.needs = SIMULATOR
        self.timeout_s = params.timeout_s
        self.dataset_needs = EVALUATOR
        self.dataset_timeout_s = max(600.0, 0.5 * params.dataset_frames)

    def wrong_inputs(self) -> list[tuple[str, str]]:
        """Return the errors of the detector and the data set."""
        wrong = wrong_detector(self.params.detector)
        try:
            if self.params.dataset != "simulator":
                data = read_coco(Path(self.params.dataset))
                # Cached: the detector was loaded above.
                labels = None if wrong else check_loads(self.params.detector)
                check_sample(data, self.params.dataset_frames, labels)
        except DatasetError as error:
            wrong.append(("dataset", str(error).removeprefix("dataset: ")))
        return wrong

    def _weights(self) -> str:
        return weights_digest(self.params.detector)

    def _digest(self) -> str:
        return "" if self.params.dataset == "simulator" else read_coco(Path(self.params.dataset)).digest

    def episode(self, vectors: Vectors, seed: int) -> EpisodeSpec:
        """Return the episode of a scenario and its perturbations."""
        decoded = self.space.decode(tuple(vectors))
        params = self.params
        scenario: dict[str, Json] = {**decoded["scenario"], "obstacle": params.obstacle}
        return EpisodeSpec(
            simulator=SIMULATOR,
            scenario=scenario,
            behaviour=self._behaviour(vectors),
            requirements=self.recorded,
            seed=seed,
            duration_s=params.duration_s,
            options={
                "width_px": params.width_px,
                "height_px": params.width_px * 9 // 16,
                "person_frames": params.person_frames,
            },
        )

    def _behaviour(self, vectors: Vectors) -> dict[str, Json]:
        if self.is_true:
            return {"mode": SightMode.ORACLE.value}
        return {"mode": SightMode.DETECTOR.value, **self._perception(vectors)}

    def _perception(self, vectors: Vectors) -> dict[str, Json]:
        weights = self._weights()
        return {
            "detector": self.params.detector,
            **({"weights": weights} if weights else {}),
            "threshold": self.params.threshold,
            "fields": self.params.fields,
            "perturbations": [dict(perturbation) for perturbation in self.perturbations(vectors)],
        }

    def perturbations(self, vectors: Vectors) -> list[dict[str, Json]]:
        """Return the perturbations of a candidate in order, each ``{"gene": name, "level": index}``."""
        decoded = self.space.decode(tuple(vectors))["perturbation"]
        named: list[dict[str, Json]] = []
        for place in range(1, self.params.perturbations + 1):
            gene, intensity = str(decoded[f"gene_{place}"]), float(decoded[f"intensity_{place}"])
            level = round(intensity * (CATALOGUE[gene].levels - 1))
            named.append({"gene": gene, "level": level})
        return named

    def words(self, vectors: Vectors) -> str:
        """Describe a candidate."""
        scenario = {**self.space.decode(tuple(vectors))["scenario"], "obstacle": self.params.obstacle}
        chain = describe_perturbations(self.perturbations(vectors)) or "not perturbed"
        if self.is_true:
            chain = "ground truth in place of the detector"
        return f"{chain}; {describe_street(scenario)}"

    def words_of_change(
        self, safe: SimulatedSolution, unsafe: SimulatedSolution, changed: Collection[str]
    ) -> str:
        """Describe each perturbation and each parameter of the scenario that differs."""
        old, new = (self.space.decode(tuple(side.vectors))["scenario"] for side in (safe, unsafe))
        clauses = []
        for name, template in _SCENARIO.items():
            if f"scenario.{name}" in changed:
                values = (word.replace("_", " ") for word in different(new[name], old[name]))
                clauses.append(template.format(*values))
        was, now = (
            [describe_perturbations([step]) or "none" for step in self.perturbations(side.vectors)]
            for side in (safe, unsafe)
        )
        several = sum({before, after} != {"none"} for before, after in zip(was, now, strict=True)) > 1
        for place, (before, after) in enumerate(zip(was, now, strict=True), start=1):
            if before != after:
                which = f"perturbation {place}" if several else "the perturbation"
                clauses.append(f"{which} is {after} instead of {before}")
        return "; ".join(clauses)

    def dataset_evaluation(self, vectors: Vectors) -> EpisodeSpec:
        """Return the specification that measures the perturbations; the scenario is ignored."""
        digest, width_px = self._digest(), self.params.width_px
        rendered = self.params.dataset == "simulator"
        return EpisodeSpec(
            simulator=EVALUATOR,
            scenario={
                "dataset": self.params.dataset,
                "frames": self.params.dataset_frames,
                **({"digest": digest} if digest else {}),
                **({"width_px": width_px} if rendered and width_px != SIZE_PX[0] else {}),
            },
            behaviour=self._perception(vectors),
            requirements=(),
            seed=0,
            duration_s=1.0,
        )

    def measurement(self, outcome: Completed) -> Measured:
        """Return alpha, the mAP of the detector."""
        return Measured(objectives={"alpha": outcome.objectives["alpha"]})
