"""The problem `commonroad@1`: driving in recorded traffic with errors of perception.

The scenario is a file of recorded traffic and how fast the ego begins; the behaviour is that of `urban-errors@1` on
the list of objects. Source: ours; see docs/adr/0091.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any, ClassVar, Final

from brink.search.errors import ConfigError
from brink.search.settings import check_settings, setting
from brink.search.space import Categorical, Component, Real, SearchSpace
from brink.server.problems.base import BEHAVIOUR, Vectors
from brink.server.problems.camera_settings import latency_setting
from brink.server.problems.changes import instead
from brink.server.problems.driving_systems import (
    check_driving_settings,
    driving_options,
    driving_setting,
    driving_settings_setting,
)
from brink.server.problems.error_slots import SCENARIO, Values
from brink.server.problems.requirements import (
    Stated,
    check_requirements,
    chosen_requirements,
    formulas_in,
    requirement_setting,
)
from brink.server.problems.resolutions import RESOLUTION_SHARE
from brink.server.problems.urban_errors import COVERED, UrbanErrors, errors_component
from brink.sim.catalogue import REQUIREMENTS as REQUIREMENT_PLUGINS
from brink.sim.catalogue import plugin_ids
from brink.sim.commonroad.example import example_document
from brink.sim.commonroad.files import MAX_FILES, SCENARIOS, document_of
from brink.sim.commonroad.recording import RecordingError, packed
from brink.sim.commonroad.roads import Place, place_in
from brink.sim.commonroad.specification import MAX_NAME_CHARS, SIMULATOR_ID, START_SPEEDS, RecordedScenario
from brink.sim.driving.interface import PERCEPTION_STEP_S
from brink.sim.episode import EpisodeSpec, Json
from brink.sim.perception_errors import MODE
from brink.sim.urban.detection_errors import MAX_ERRORS, ON_OBJECTS, DetectionError, ErrorType, Onset, Target

REQUIREMENTS: Final = ("no-collision@1", "front-gap@2", "lane-keeping@1")
"""Requirements that every episode records."""
ON_ROAD: Final[Mapping[str, Any]] = {"on-road": {"stl": "always (road_edge_gap_m > -0.2)", "unit": "m"}}
NOT_MEASURED: Final = ("red-light@1", "progress@1")
"""Requirements about what recordings do not have."""
NOT_RECORDED: Final = ("stop_line_gap_m", "light_red", "light_amber", "in_conflict_area")
RECORDED: Final = ("road_edge_gap_m",)
MAX_CHARS: Final = 8_000_000
"""Maximum length of all packed recordings together."""
SHORTEST_S: Final = 1.0
_PEDESTRIAN: Final = "pedestrian"


@dataclass(frozen=True, slots=True, kw_only=True)
class CommonRoadParams:
    """Parameters of the problem."""

    scenarios: dict[str, Any] = field(
        default_factory=lambda: {"braking": packed(example_document())},
        metadata={
            "help": "CommonRoad files: a folder, or a list of files. In a request: their content by name; a small "
            "example by default."
        },
    )
    requirement: Stated = requirement_setting(["no-collision@1", dict(ON_ROAD)], REQUIREMENTS)  # noqa: RUF009
    errors: int = setting(2, ge=1, le=MAX_ERRORS, help="Maximum number of errors in an episode.")
    reacting: bool = setting(
        False, help="Whether other vehicles keep their distance, on their recorded paths."
    )
    duration_s: float = setting(
        20.0, ge=1.0, le=120.0, unit="s", help="Longest drive; it ends earlier with its recording."
    )
    latency_s: float = latency_setting()
    driving: str = driving_setting()
    driving_settings: dict[str, Any] = driving_settings_setting()  # noqa: RUF009  (returns a field)
    timeout_s: float = setting(120.0, gt=0.0, le=3600.0, unit="s", help="Wall-clock limit of an episode.")

    def __post_init__(self) -> None:
        check_settings(self)
        check_driving_settings(self.driving_settings, self.driving)
        known = [name for name in plugin_ids(REQUIREMENT_PLUGINS) if name not in NOT_MEASURED]
        check_requirements(
            self.requirement, known, duration_s=self.duration_s, not_recorded=NOT_RECORDED, recorded=RECORDED
        )
        object.__setattr__(self, SCENARIOS, _packed_scenarios(self.scenarios))

    @property
    def requirements(self) -> tuple[str, ...]:
        """Ids of the requirements that give the verdict."""
        return chosen_requirements(self.requirement, REQUIREMENTS)

    @property
    def errors_on(self) -> str:
        """What is wrong: the list of objects."""
        return ON_OBJECTS


def _packed_scenarios(given: Mapping[str, Any]) -> dict[str, str]:
    """Return packed recordings by name, after checking that the ego can drive in each.

    Raises:
        ConfigError: There is none, one is malformed, or they are too large together.
    """
    if not 1 <= len(given) <= MAX_FILES:
        raise ConfigError(SCENARIOS, f"expected 1 to {MAX_FILES} files, got {len(given)}")
    found = {}
    for name, text in given.items():
        if not 0 < len(name) <= MAX_NAME_CHARS or not name.isprintable():
            raise ConfigError(
                SCENARIOS, f"expected names of 1 to {MAX_NAME_CHARS} characters, got {name!r:.200}"
            )
        if not isinstance(text, str):
            raise ConfigError(
                SCENARIOS, f"{name}: expected the content of a CommonRoad file as text, got {text!r:.80}"
            )
        try:
            found[name] = _packed_xml(text) if text.lstrip().startswith("<") else text
            duration_s = place_in(found[name]).recording.duration_s
        except RecordingError as error:
            raise ConfigError(SCENARIOS, f"{name}: {error}") from None
        if 0.0 < duration_s < SHORTEST_S:
            raise ConfigError(
                SCENARIOS,
                f"{name}: expected a recording of at least {SHORTEST_S:g} s, got {duration_s:.1f} s",
            )
    if (size := sum(map(len, found.values()))) > MAX_CHARS:
        raise ConfigError(
            SCENARIOS, f"expected files of at most {MAX_CHARS:,} characters when packed, got {size:,}"
        )
    return found


@lru_cache(maxsize=32)
def _packed_xml(text: str) -> str:
    return packed(document_of(text))


class CommonRoad(UrbanErrors):
    """Driving in recorded traffic with errors in the list of objects."""

    id: ClassVar[str] = "commonroad@1"
    summary: ClassVar[str] = "Recorded traffic (CommonRoad files) and errors in the list of objects."
    params_type: ClassVar[type[Any]] = CommonRoadParams
    errors_problem = "commonroad@1"
    recorded: ClassVar[tuple[str, ...]] = REQUIREMENTS
    terms_of_changes = "reported: what the list of objects tells the driving system"
    about_component = (
        "Errors of the list of objects are injected: results show what would happen if a perception erred like this, "
        "not that yours does."
    )
    params: CommonRoadParams

    def __init__(self, params: CommonRoadParams) -> None:
        self.params = params
        self._places: dict[str, Place] = {name: place_in(text) for name, text in params.scenarios.items()}
        longest_s = max(map(self._duration_s, self._places))
        has_people = any(
            user.kind == _PEDESTRIAN for place in self._places.values() for user in place.recording.road_users
        )
        targets = [one for one in Target if has_people or one is not Target.PEDESTRIAN]
        self.space = SearchSpace(
            (
                scenario_component(tuple(self._places)),
                errors_component(
                    params.errors,
                    longest_s,
                    ErrorType,
                    targets=targets,
                    onsets=(Onset.TIME, Onset.LEAD_BRAKES),
                ),
            )
        )
        self.algorithm_defaults = self.study_of_severity(
            {"onset": Onset.TIME.value, "duration_s": longest_s}
        ) | {
            "grossest": {self.first("type"): ErrorType.SHORT_RANGE.value},
            "covers": {self.first("type"): [kind.value for kind in COVERED]},
        }
        self.usual_cells = {  # type: ignore[misc]  # (depends on who is in the files)
            "type": UrbanErrors.usual_cells["type"],
            "target": [
                one for one in UrbanErrors.usual_cells["target"] if one in {item.value for item in targets}
            ],
        }
        self.requirements = params.requirements
        self.formulas = formulas_in(params.requirement)
        self.needs = SIMULATOR_ID
        self.timeout_s = params.timeout_s

    def _duration_s(self, file: str) -> float:
        """Return the length of the longest drive in a file, a multiple of the perception step."""
        longest_s, recorded_s = self.params.duration_s, self._places[file].recording.duration_s
        wanted_s = min(longest_s, recorded_s) if recorded_s > 0.0 else longest_s
        return round(int(wanted_s / PERCEPTION_STEP_S + 1e-6) * PERCEPTION_STEP_S, 6)

    def _scenario(self, values: Values) -> dict[str, Json]:
        file = str(values["file"])
        return {
            "file": file,
            "recording": self.params.scenarios[file],
            "start_speed": float(values["start_speed"]),
            "reacting": self.params.reacting,
        }

    def episode(self, vectors: Vectors, seed: int) -> EpisodeSpec:
        """Return the episode of a scenario and the errors in it."""
        decoded = self.space.decode(tuple(vectors))
        scenario = self._scenario(decoded[SCENARIO])
        duration_s = self._duration_s(str(scenario["file"]))
        errors: list[Json] = [
            _within(error, duration_s).to_json() for error in self.errors(decoded[BEHAVIOUR])
        ]
        return EpisodeSpec(
            simulator=SIMULATOR_ID,
            scenario=scenario,
            behaviour={"mode": MODE, "on": ON_OBJECTS, "errors": errors},
            requirements=self.evaluated,
            formulas=self.formulas,
            seed=seed,
            duration_s=duration_s,
            options={
                "latency_s": self.params.latency_s,
                **driving_options(self.params.driving, self.params.driving_settings),
            },
        )

    def words(self, vectors: Vectors) -> str:
        """Describe a candidate."""
        decoded = self.space.decode(tuple(vectors))
        scenario = RecordedScenario.from_json(self._scenario(decoded[SCENARIO]))
        return f"{scenario.words}; {self.words_of_errors(decoded[BEHAVIOUR]) or 'no error'}"

    def scenario_changes(self, old: Values, new: Values, changed: Collection[str]) -> list[str]:
        """Describe the differences of the unsafe scenario from the safe one, one part for each parameter."""
        parts = []
        if f"{SCENARIO}.file" in changed:
            parts.append(f"in {new['file']} instead of {old['file']}")
        if f"{SCENARIO}.start_speed" in changed:
            speeds = (100.0 * float(old["start_speed"]), 100.0 * float(new["start_speed"]))
            parts.append(f"the ego starts at {instead(*speeds, '%')} of the recorded speed")
        return parts


def _within(error: DetectionError, duration_s: float) -> DetectionError:
    """Return an error whose window begins within a drive; recordings of one campaign differ in length."""
    return replace(
        error, onset_s=min(error.onset_s, duration_s), duration_s=min(error.duration_s, duration_s)
    )


def scenario_component(files: tuple[str, ...]) -> Component:
    """Return the parameters of a scenario in some of the files."""
    low, high = START_SPEEDS
    return Component(
        name=SCENARIO,
        parameters=(
            Categorical(name="file", choices=files),
            Real(name="start_speed", low=low, high=high, unit="", resolution=RESOLUTION_SHARE),
        ),
    )
