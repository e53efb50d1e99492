"""The problem `npc-actions@1`: actions of other road users that make a driving system violate a requirement.

A candidate is one to six participants with timed actions on a road. The search measures distances with their
kinematic roll-out, which is also the script that they follow in the simulator.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, ClassVar, Final, Self

import numpy as np

from brink.search.algorithm import Evaluation, Niche, Scored
from brink.search.algorithms.multi_objective import CRITICALITY
from brink.search.analysis.avoidable import Avoidable, avoidable_of
from brink.search.analysis.violations import kinds_of, niche_of
from brink.search.errors import ConfigError
from brink.search.settings import check_settings, setting
from brink.search.space import SearchSpace
from brink.search.traffic.constraint import participants_component, participants_of
from brink.search.traffic.motion import roll_out, waypoints
from brink.search.traffic.participants import MAX_PARTICIPANTS, ParameterNames, Participant, RoadLimits
from brink.server.problems.base import (
    Activity,
    SimulatedProblem,
    SimulatedSolution,
    Vectors,
    is_number,
    wrong_detector,
)
from brink.server.problems.camera_settings import latency_setting, least_visible_setting, pitch_setting
from brink.server.problems.driving_systems import (
    Driven,
    about_driving,
    check_driving_settings,
    driving_options,
    driving_setting,
    driving_settings_setting,
)
from brink.server.problems.traffic_changes import words_of_traffic_change
from brink.sim.driving_systems.option import OWN
from brink.sim.encounter.specification import (
    PLACE_FIELDS,
    REFERENCE,
    describe_script,
    get_lane_layout,
    stretch_to_json,
)
from brink.sim.episode import EpisodeSpec, Json, JsonObject
from brink.sim.perception.user_files import DEFAULT_DETECTOR, weights_digest
from brink.sim.urban.options import CAMERA_OPTIONS
from brink.sim.world.scenario import SCENARIO_CHOICES, UrbanScenario
from brink.worker.wire import Completed

SIMULATORS: Final = {"oracle": "brink-encounter@2", "detector": "brink-encounter-camera@3"}
"""Simulators by the perception of the driving system."""
ORACLES: Final = (
    "no-collision@1",
    "front-gap@2",
    "lane-keeping@1",
    "red-light@1",
    "speed-limit@1",
    "progress@1",
)
FORMER: Final = {"front-gap@1": "front-gap@2"}
"""Requirements that campaigns may name besides, and the present ones, of which results of old campaigns have none."""
UNAVOIDABLE_M: Final = 250.0
"""Criticality of a violation that does not count: worse than that of any solution without a violation."""
_BY_GAP: Final = ("any", "no-collision@1", "front-gap@2", *FORMER)
"""Values of `violation` for which the gap between the ego and the nearest road user is meaningful."""
ROAD_USERS: Final = "road_users"
LIT: Final = "crossroad"
_SYSTEM: Final = (
    "a modular automated car with a camera, an obstacle detector, tracking, prediction, planning and control"
)
_OTHER_SYSTEM: Final = (
    "an automated car with a camera, an obstacle detector, and a driving system of the user's own"
)


def _words(name: str) -> tuple[str, ...]:
    return tuple(str(choice) for choice in SCENARIO_CHOICES[name])


@dataclass(frozen=True, slots=True, kw_only=True)
class NpcActionsParams:
    """Parameters of the problem."""

    participants: int = setting(
        4, help="Maximum number of road users in a candidate.", ge=1, le=MAX_PARTICIPANTS
    )
    violation: str = setting(
        "any",
        help="Requirement whose violation counts as unsafe; any stands for all six, with front-gap@2.",
        choices=("any", *ORACLES, *FORMER),
    )
    count: str = setting(
        "all",
        help="Violations that the search is for: all, or those that a careful driver would have avoided. Guides "
        "qd@1, mumoea@1, mosat@1 and nsga2@1 only; verdicts and the violations found are the same.",
        choices=("all", "avoidable"),
    )
    criticality: str = setting(
        "auto",
        choices=("auto", "gap", "robustness"),
        help="Measure of criticality: the smallest gap to a road user, or the lowest robustness; auto takes the gap "
        "for collisions, front gaps and any violation.",
    )
    sight: str = setting(
        "oracle",
        help="Perception of the driving system: ground truth, or a detector on camera images (vision extra).",
        choices=tuple(SIMULATORS),
    )
    detector: str = setting(
        DEFAULT_DETECTOR,
        help="Detector if sight is detector: its id, or onnx:FILE, torchscript:FILE, ultralytics:FILE.",
    )
    threshold: float = setting(0.6, help="Minimum score of detections that count.", gt=0.0, lt=1.0)
    road_curve: str = setting("crossroad", help="Shape of the road.", choices=_words("road_curve"))
    road_id: int = setting(0, help="Index of the road among those of this shape.", ge=0, le=2)
    road_length: int = setting(0, help="0 short, 1 medium, 2 long.", ge=0, le=2)
    driving_task: str = setting("follow_road", help="Task of the ego.", choices=_words("driving_task"))
    time_of_day: str = setting("noon", help="Time of day.", choices=_words("time_of_day"))
    weather: str = setting("clear", help="Sky, rain and road surface.", choices=_words("weather"))
    duration_s: float = setting(25.0, help="Length of an episode.", ge=5.0, le=120.0, unit="s")
    latency_s: float = latency_setting()
    pitch: bool = pitch_setting()
    least_visible: float = least_visible_setting()
    driving: str = driving_setting()
    driving_settings: dict[str, Any] = driving_settings_setting()  # noqa: RUF009  (returns a field)
    timeout_s: float = setting(60.0, help="Wall-clock limit of an episode.", gt=0.0, le=3600.0, unit="s")

    def __post_init__(self) -> None:
        check_settings(self)
        check_driving_settings(self.driving_settings, self.driving)
        if self.violation == "red-light@1" and self.road_curve != LIT:
            raise ConfigError(
                "violation", f"expected another requirement, or road_curve: {LIT}; no other road has lights"
            )


_RANKS: Final[Mapping[Avoidable | None, int]] = {
    Avoidable.CAREFUL: 0,
    Avoidable.IDEAL: 2,
    Avoidable.NO: 3,
    None: 3,
}
"""Ranks of violations; a solution without any has rank 1."""


class NpcActions(Driven, SimulatedProblem):
    """Scripted road users that challenge a driving system."""

    id: ClassVar[str] = "npc-actions@1"
    summary: ClassVar[str] = "A driving system among up to six road users with timed actions."
    params_type: ClassVar[type[Any]] = NpcActionsParams
    recorded = ORACLES
    records_activity = True
    has_component = True
    names_niches = True
    extra = "vision"
    params: NpcActionsParams

    def __init__(self, params: NpcActionsParams) -> None:
        self.params = params
        self._place: JsonObject = {name: getattr(params, name) for name in PLACE_FIELDS}
        lanes = get_lane_layout(UrbanScenario.from_json({**self._place, "pedestrians": 0}))
        self.road = RoadLimits(
            lane_width_m=lanes.lane_width_m,
            strip_m=lanes.strip_m,
            pavement_m=lanes.pavement_m,
            streets_m=lanes.crossing_streets_m,
        )
        self.max_participants = params.participants
        self.system = _SYSTEM if params.driving == OWN else _OTHER_SYSTEM
        self.space = SearchSpace((participants_component(ROAD_USERS, params.participants, self.road),))
        self._rule = participants_of(self.space)[1]
        self.needs = SIMULATORS[params.sight]
        self.timeout_s = params.timeout_s
        self.about_component = (type(self).about_component + about_driving(params.driving)).strip()
        self.requirements = ORACLES if params.violation == "any" else (params.violation,)
        self.modules = () if params.sight == "oracle" else ("cv2", "onnxruntime")

    @property
    def by_gap(self) -> bool:
        """Whether criticality is the smallest gap to a road user, not the robustness."""
        if self.params.criticality == "auto":
            return self.params.violation in _BY_GAP
        return self.params.criticality == "gap"

    def wrong_criticality(self) -> tuple[str, str] | None:
        """Return the parameter that keeps criticality from measuring the requirement, and a message; or None."""
        if not self.by_gap or self.params.violation in _BY_GAP:
            return None
        return "criticality", (
            f"expected auto or robustness: the gap to road users is not meaningful for {self.params.violation}"
        )

    def with_truth(self) -> Self | None:
        """Return the problem with ground truth in place of a detector; None if it has no detector."""
        if self.params.sight == "oracle":
            return None
        return type(self)(replace(self.params, sight="oracle"))

    def wrong_inputs(self) -> list[tuple[str, str]]:
        """Return what is wrong with the driving system's name, and with the detector's name or file."""
        detector = [] if self.params.sight == "oracle" else wrong_detector(self.params.detector)
        return [*super().wrong_inputs(), *detector]

    def participants(self, vectors: Vectors) -> tuple[Participant, ...]:
        """Return the road users of a candidate."""
        return self._rule.decode(vectors[0])

    def waypoints(self, vectors: Vectors) -> list[list[list[float]]]:
        """Return station and offset at the end of each action, in m, as one list per road user."""
        points: list[list[list[float]]] = [
            waypoints(participant, self.road).tolist() for participant in self.participants(vectors)
        ]
        return points

    def scripts(self, vectors: Vectors) -> list[Json]:
        """Return the scripts of the road users of a candidate, as in specifications."""
        scripts: list[Json] = []
        for participant in self.participants(vectors):
            stretches: list[Json] = [
                stretch_to_json(asdict(stretch), participant.genes[stretch.gene].action.value)
                for stretch in roll_out(participant, self.road, self.params.duration_s)
            ]
            scripts.append({"kind": participant.kind.value, "stretches": stretches})
        return scripts

    def episode(self, vectors: Vectors, seed: int) -> EpisodeSpec:
        """Return the episode of a candidate."""
        return EpisodeSpec(
            simulator=self.needs,
            scenario={**self._place, "road_users": self.scripts(vectors)},
            behaviour=self._behaviour(),
            requirements=self.evaluated,
            seed=seed,
            duration_s=self.params.duration_s,
            options={
                REFERENCE: True,
                **{name: getattr(self.params, name) for name in CAMERA_OPTIONS},
                **driving_options(self.params.driving, self.params.driving_settings),
            },
        )

    def _behaviour(self) -> dict[str, Json]:
        if self.params.sight == "oracle":
            return {"mode": "oracle"}
        weights = weights_digest(self.params.detector)
        return {
            "mode": "detector",
            "detector": self.params.detector,
            "threshold": self.params.threshold,
            **({"weights": weights} if weights else {}),
        }

    def words(self, vectors: Vectors) -> str:
        """Describe a candidate."""
        return "; ".join(
            describe_script(script) for script in self.scripts(vectors) if isinstance(script, dict)
        )

    def words_of_change(
        self, safe: SimulatedSolution, unsafe: SimulatedSolution, changed: Collection[str]
    ) -> str:
        """Describe the largest differences by road user, and count the others."""
        names = {name.removeprefix(f"{ROAD_USERS}.") for name in changed}
        return words_of_traffic_change(self._rule, safe.vectors[0], unsafe.vectors[0], names)

    def activity(self, vectors: Vectors, features: Mapping[str, Any]) -> Activity | None:
        """Return which road users and actions were active in an episode: actions that began before it ended.

        A vehicle that has to wait for others is later than its script, so an action counts as active if it might have
        begun.
        """
        ended_at_s = features.get("ended_at_s")
        if not is_number(ended_at_s):
            return None
        component = self.space.components[0]
        place = {parameter.name: index for index, parameter in enumerate(component.parameters)}
        active = np.zeros(component.dimension, dtype=np.bool_)
        for number, participant in enumerate(self.participants(vectors), start=1):
            names = ParameterNames.of(number)
            active[[place[name] for name in (names.kind, *names.start)]] = True
            begins_s = 0.0
            for gene, of_gene in zip(participant.genes, names.genes, strict=False):
                active[[place[name] for name in of_gene]] = begins_s < ended_at_s
                begins_s += gene.duration_s
        return Activity(active=active, effective=np.where(active, vectors[0], 0.0))

    def violations(self, outcome: Completed) -> list[dict[str, Any]]:
        """Return the circumstances of the violations that count as unsafe."""
        reported = outcome.features.get("violations")
        return [
            dict(one)
            for one in (reported if isinstance(reported, list) else [])
            if isinstance(one, dict) and self._counts(one.get("requirement"))
        ]

    def _counts(self, requirement: object) -> bool:
        """Return whether a violation of a requirement makes a solution unsafe, including in old campaigns."""
        return requirement in self.requirements or FORMER.get(str(requirement)) in self.requirements

    def evaluation(self, outcome: Completed) -> Evaluation:
        """Return the verdict, in the unit of its requirement, and all objectives."""
        robustness = min(self._robustness(outcome, name) for name in self.requirements)
        violations = self.violations(outcome)
        objectives = dict(outcome.objectives)
        closest = outcome.features.get("closest")
        counted = violations
        if self.params.count == "avoidable":
            # A standing ego is not to blame for what comes close to it. Results of older versions lack these values.
            objectives[CRITICALITY] = objectives.get("moving_criticality_m", objectives[CRITICALITY])
            closest = outcome.features.get("closest_moving", closest)
            counted = [violation for violation in violations if avoidable_of(violation) is Avoidable.CAREFUL]
        if not self.by_gap:
            objectives[CRITICALITY] = robustness
        if violations and not counted:
            objectives[CRITICALITY] = UNAVOIDABLE_M
        return Scored(
            unsafe=robustness < 0,
            robustness=robustness,
            objectives=objectives,
            kinds=kinds_of(counted),
            niches=self._niches(violations, closest, objectives[CRITICALITY]),
            counts=not violations or bool(counted),
        )

    @staticmethod
    def _robustness(outcome: Completed, requirement: str) -> float:
        """Return the robustness of a requirement, which results of old campaigns store under its former id."""
        former = {new: old for old, new in FORMER.items()}
        verdict = outcome.verdicts.get(requirement) or outcome.verdicts[former.get(requirement, requirement)]
        return verdict.robustness

    def _niches(
        self, violations: Sequence[Mapping[str, Any]], closest: Any, value: float
    ) -> tuple[Niche, ...]:
        """Return the niches of a solution: its violations, or its closest approach if there are none.

        Args:
            violations: Circumstances of its violations.
            closest: Circumstances of the closest approach.
            value: Its criticality.
        """
        if violations:
            ranks = _RANKS if self.params.count == "avoidable" else {}
            listed = [(violation, ranks.get(avoidable_of(violation), 0)) for violation in violations]
        elif isinstance(closest, Mapping):
            listed = [({"requirement": "", "collision": None, **closest}, 1)]
        else:
            listed = []
        niches = [Niche(name=name, rank=rank, value=value) for one, rank in listed if (name := niche_of(one))]
        return tuple(niches)
