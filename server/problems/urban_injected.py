"""The problem `urban-injected@1`: an urban scenario with injected obstacle detections.

The scenario has seven categorical parameters, the behaviour one to six injected trajectories, two by default, with
eleven parameters each. Sources: Sharifi et al. 2023, sections 5.1 (encoding) and 6.1 (requirement). Not in the
paper but in the authors' code are the label ``null``, the smallest box, the shortest trajectory, the sigmas and the
order of repairs; see docs/explanation/hazard-boundary.md.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Final

import numpy as np

from brink.search.algorithm import Measure
from brink.search.parameters import Value
from brink.search.settings import check_settings, setting
from brink.search.space import (
    Categorical,
    Component,
    Constraint,
    Dormant,
    Duration,
    Extent,
    FloatArray,
    Integer,
    Parameter,
    Real,
    SearchSpace,
)
from brink.server.problems.base import BEHAVIOUR, Activity, SeverityScale, SimulatedSolution, Vectors
from brink.server.problems.camera_settings import latency_setting, least_visible_setting, pitch_setting
from brink.server.problems.driving_systems import (
    Driven,
    about_driving,
    check_driving_settings,
    driving_options,
    driving_setting,
    driving_settings_setting,
)
from brink.server.problems.error_slots import SCENARIO, SlottedBehaviour, interchangeable, prefixes
from brink.server.problems.requirements import (
    Stated,
    check_requirements,
    chosen_requirements,
    formulas_in,
    requirement_setting,
)
from brink.server.problems.resolutions import RESOLUTION_PX
from brink.server.problems.urban_changes import words_of_changes
from brink.sim.catalogue import REQUIREMENTS as REQUIREMENT_PLUGINS
from brink.sim.catalogue import plugin_ids
from brink.sim.driving.interface import PERCEPTION_STEP_S
from brink.sim.episode import EpisodeSpec, Json
from brink.sim.urban import behaviour as b
from brink.sim.urban.options import BICYCLE, FIDELITIES, DriveOptions
from brink.sim.world.scenario import (
    PEDESTRIAN_COUNTS,
    ROAD_IDS,
    ROAD_LENGTHS,
    SCENARIO_CHOICES,
    words_of_scenario,
)

SIMULATOR = "brink-drive@3"
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

_EDGES: Final = dict(zip(b.BOX_SIDES, ("left", "right", "upper", "lower"), strict=True))
_INTEGER_SCENARIO = {"pedestrians": PEDESTRIAN_COUNTS, "road_id": ROAD_IDS, "road_length": ROAD_LENGTHS}


MOST_TRAJECTORIES = 6
URBAN_MEASURES: Final = (
    Measure(name="least_front_gap_m", low=0.0, high=30.0, unit="m"),
    Measure(name="way_m", low=0.0, high=200.0, unit="m"),
)
"""How near the ego came to what was ahead of it, and how far it went."""


@dataclass(frozen=True, slots=True, kw_only=True)
class UrbanParams:
    """Parameters of all problems of urban driving."""

    requirement: Stated = requirement_setting("front-gap@1", REQUIREMENTS)  # noqa: RUF009  (returns a field)
    duration_s: float = setting(
        b.DEFAULT_DURATION_S, ge=5.0, le=120.0, unit="s", help="Length of an episode."
    )
    fidelity: str = setting(BICYCLE, help="Vehicle model of the ego.", choices=FIDELITIES)
    latency_s: float = latency_setting()
    pitch: bool = pitch_setting()
    least_visible: float = least_visible_setting()
    driving: str = driving_setting()
    driving_settings: dict[str, Any] = driving_settings_setting()  # noqa: RUF009  (returns a field)
    timeout_s: float = setting(60.0, gt=0.0, le=3600.0, unit="s", help="Wall-clock limit of an episode.")

    def __post_init__(self) -> None:
        check_settings(self)
        check_driving_settings(self.driving_settings, self.driving)
        check_requirements(self.requirement, plugin_ids(REQUIREMENT_PLUGINS), duration_s=self.duration_s)

    @property
    def options(self) -> dict[str, Json]:
        """The options of each episode."""
        return {
            **DriveOptions(
                fidelity=self.fidelity,
                latency_s=self.latency_s,
                pitch=self.pitch,
                least_visible=self.least_visible,
            ).to_json(),
            **driving_options(self.driving, self.driving_settings),
        }

    @property
    def requirements(self) -> tuple[str, ...]:
        """Ids of the requirements that give the verdict."""
        return chosen_requirements(self.requirement, REQUIREMENTS)


@dataclass(frozen=True, slots=True, kw_only=True)
class UrbanInjectedParams(UrbanParams):
    """Parameters of the problem."""

    trajectories: int = setting(
        b.TRAJECTORY_COUNT,
        ge=1,
        le=MOST_TRAJECTORIES,
        help="Maximum number of injected trajectories in an episode.",
    )


def scenario_component() -> Component:
    """Return the seven categorical parameters of a scenario."""
    return Component(
        name="scenario",
        parameters=tuple(
            Categorical(
                name=name, choices=tuple(str(choice) for choice in choices), tells_kinds=name == "road_curve"
            )
            for name, choices in SCENARIO_CHOICES.items()
        ),
    )


def behaviour_component(duration_s: float, count: int = b.TRAJECTORY_COUNT) -> Component:
    """Return the component of `count` injected trajectories in episodes of a length."""
    parameters: list[Parameter] = []
    constraints: list[Constraint | Dormant] = []
    horizon = b.last_perception_step(duration_s)
    for prefix in prefixes("trajectory", count):
        parameters.append(Categorical(name=prefix + "label", choices=b.TRAJECTORY_LABELS))
        for name, (low, high, unit) in b.trajectory_ranges(duration_s).items():
            if name.endswith("_step"):
                parameters.append(
                    Integer(name=prefix + name, low=int(low), high=int(high), unit=unit, resolution=1)
                )
            else:
                parameters.append(
                    Real(
                        name=prefix + name,
                        low=low,
                        high=high,
                        unit=unit,
                        sigma=BOX_SIGMA_PX,
                        resolution=RESOLUTION_PX,
                    )
                )
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
    return Component(
        name=BEHAVIOUR,
        parameters=tuple(parameters),
        constraints=tuple(constraints),
        interchangeable=interchangeable(
            [[prefix + name for name in b.TRAJECTORY_FIELDS] for prefix in prefixes("trajectory", count)]
        ),
    )


class UrbanInjected(Driven, SlottedBehaviour):
    """Urban driving with an obstacle detector whose detections are injected."""

    id: ClassVar[str] = "urban-injected@1"
    summary: ClassVar[str] = "Urban driving with injected obstacle detections: 7 + 22 parameters."
    params_type: ClassVar[type[Any]] = UrbanInjectedParams
    errors_problem = "urban-errors@1"
    recorded = REQUIREMENTS
    measures = URBAN_MEASURES
    acted_feature = b.DELIVERED
    terms_of_changes = (
        "reported: what the search makes the detector report, the only thing that the driving system learns about "
        "other road users. Real ones are never reported, unless a made-up box happens to lie on one: pictures of a "
        "pair show what is there. Metres: where the driving system takes the reported thing to be, by its box"
    )
    about_component = (
        "The detector's errors are injected: results show what would happen if a detector erred like this, not that "
        "yours does. Whether it does is checked with that detector, on urban-camera@1: see “Set a requirement for a "
        "detector” in Brink's documentation."
    )

    def __init__(self, params: UrbanInjectedParams) -> None:
        self.params = params
        self.space = SearchSpace(
            (scenario_component(), behaviour_component(params.duration_s, params.trajectories))
        )
        self.requirements = params.requirements
        self.formulas = formulas_in(params.requirement)
        self.needs = SIMULATOR
        self._trajectories = _trajectories(self.space)
        self.timeout_s = params.timeout_s
        self.about_component = (type(self).about_component + about_driving(params.driving)).strip()

    def episode(self, vectors: Vectors, seed: int) -> EpisodeSpec:
        """Return the episode of a scenario and a behaviour."""
        decoded = self.space.decode(tuple(vectors))
        return EpisodeSpec(
            simulator=SIMULATOR,
            scenario=scenario_of(decoded[SCENARIO]),
            behaviour=self._behaviour(decoded[BEHAVIOUR]),
            requirements=self.evaluated,
            formulas=self.formulas,
            seed=seed,
            duration_s=self.params.duration_s,
            options=self.params.options,
        )

    def _behaviour(self, values: Mapping[str, Any]) -> dict[str, Json]:
        """Return the detector's reports: the injected trajectories, or the ground truth."""
        if self.is_true:
            return {"mode": b.BehaviourMode.ORACLE.value}
        return _behaviour(values)

    def words(self, vectors: Vectors) -> str:
        """Describe a candidate."""
        decoded = self.space.decode(tuple(vectors))
        if self.is_true:
            return f"{words_of_scenario(scenario_of(decoded['scenario']))}; reported: the ground truth"
        trajectories = _behaviour(decoded[BEHAVIOUR])["trajectories"]
        return f"{words_of_scenario(scenario_of(decoded['scenario']))}; {b.words_of_behaviour(trajectories)}"

    def words_of_change(
        self, safe: SimulatedSolution, unsafe: SimulatedSolution, changed: Collection[str]
    ) -> str:
        """Describe the differences of the unsafe candidate from the safe one."""
        old, new = (self.space.decode(tuple(side.vectors)) for side in (safe, unsafe))
        verdicts = (unsafe.result or {}).get("verdicts") or {}
        times = [(verdicts.get(name) or {}).get("violated_at_s") for name in self.requirements]
        return words_of_changes(
            old,
            new,
            changed,
            min((t for t in times if t is not None), default=None),
            ended_at_step=min(self._ended_at_step(one) for one in (safe, unsafe)),
            unsafe_ended_at_step=_last_step(unsafe),
        )

    def scale_of(self, name: str, values: Mapping[str, Mapping[str, Value]]) -> SeverityScale | None:
        """Return the scale of a step, which is a time, or of the edge of a box; None for other numbers."""
        trajectory, _, field = name.removeprefix(f"{BEHAVIOUR}.").partition(".")
        report = f"report {trajectory.removeprefix('trajectory_')}"
        if field in b.BOX_FIELDS:
            side, end = field[: len("x_min")], "first" if "_0_" in field else "last"
            meaning = f"{_EDGES[side]} edge of the {end} box of {report} in the image"
            return SeverityScale(unit="px", none=0.0, most=1.0, meaning=meaning)
        if not field.endswith("_step"):
            return None
        meaning = f"when {report} {'begins' if field == 't0_step' else 'ends'}"
        return SeverityScale(unit="s", none=0.0, most=PERCEPTION_STEP_S, meaning=meaning)

    def _ended_at_step(self, one: SimulatedSolution) -> float:
        """Return the perception step at which a drive ended; infinity unless that cut off what was reported."""
        delivered = b.steps_from_json(((one.result or {}).get("features") or {}).get(b.DELIVERED)) or ()
        injected = [t for t in self._trajectories if one.vectors[1][t.label] != t.null_choice]
        if len(delivered) != len(injected):
            return float("inf")
        cut_off = [
            steps[1]
            for t, steps in zip(injected, delivered, strict=True)
            if steps is not None and steps[1] < np.floor(one.vectors[1][t.end])
        ]
        return float(min(cut_off, default=float("inf")))

    def activity(self, vectors: Vectors, features: Mapping[str, Any]) -> Activity | None:
        """Return which parameters were active in an episode, from when each trajectory was delivered.

        A trajectory that was delivered until the end is described as it was seen: until its last step, with the box
        that it had then.
        """
        activity = super().activity(vectors, features)
        delivered = b.steps_from_json(features.get(b.DELIVERED))
        if activity is None or delivered is None:
            return None
        behaviour = activity.effective[len(vectors[0]) :]
        injected = [t for t in self._trajectories if vectors[1][t.label] != t.null_choice]
        for trajectory, steps in zip(injected, delivered, strict=True):
            if steps is not None:
                trajectory.cut_off(behaviour, last_step=steps[1])
        return activity


def _last_step(one: SimulatedSolution) -> float | None:
    """Return the perception step at which a drive ended; None if that was not recorded."""
    ended_at_s = ((one.result or {}).get("features") or {}).get("ended_at_s")
    return ended_at_s / PERCEPTION_STEP_S if isinstance(ended_at_s, int | float) else None


def scenario_of(values: Mapping[str, Any]) -> dict[str, Json]:
    """Return a decoded scenario in the form that episodes use."""
    return {name: int(value) if name in _INTEGER_SCENARIO else value for name, value in values.items()}


@dataclass(frozen=True, slots=True, kw_only=True)
class _Trajectory:
    """Positions of the parameters of a trajectory in the vector of a behaviour.

    Attributes:
        label: Of the label.
        null_choice: Index of the label for no trajectory.
        start: Of the first step.
        end: Of the last step.
        first_px: Of the sides of the box at the first step.
        last_px: Of the sides of the box at the last step.
    """

    label: int
    null_choice: int
    start: int
    end: int
    first_px: tuple[int, ...]
    last_px: tuple[int, ...]

    @property
    def numbers(self) -> tuple[int, ...]:
        """Positions of all parameters but the label."""
        return (self.start, self.end, *self.first_px, *self.last_px)

    def cut_off(self, values: FloatArray, *, last_step: int) -> None:
        """End the trajectory of a behaviour after a step, with the box that it has then."""
        start, end = values[self.start], values[self.end]
        if last_step >= np.floor(end):
            return
        share = (last_step - start) / (end - start)
        first, last = list(self.first_px), list(self.last_px)
        values[last] = values[first] + share * (values[last] - values[first])
        values[self.end] = last_step


def _trajectories(space: SearchSpace) -> list[_Trajectory]:
    behaviour = space.components[1]
    place = {parameter.name: index for index, parameter in enumerate(behaviour.parameters)}
    prefixes = [f"trajectory_{number}." for number in b.trajectory_numbers(place)]
    return [
        _Trajectory(
            label=place[prefix + "label"],
            null_choice=b.TRAJECTORY_LABELS.index(b.NULL_LABEL),
            start=place[prefix + "t0_step"],
            end=place[prefix + "t1_step"],
            first_px=tuple(place[f"{prefix}{side}_0_px"] for side in b.BOX_SIDES),
            last_px=tuple(place[f"{prefix}{side}_1_px"] for side in b.BOX_SIDES),
        )
        for prefix in prefixes
    ]


def _behaviour(values: Mapping[str, Any]) -> dict[str, Json]:
    trajectories: list[Json] = [
        {name: values[f"trajectory_{index}.{name}"] for name in b.TRAJECTORY_FIELDS}
        for index in b.trajectory_numbers(values)
        if values[f"trajectory_{index}.label"] != b.NULL_LABEL
    ]
    return {"mode": b.BehaviourMode.INJECTED.value, "trajectories": trajectories}
