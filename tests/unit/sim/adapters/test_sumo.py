"""Traffic in SUMO: equal episodes are equal anywhere, errors of perception act, bad specifications are refused."""

import hashlib
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from brink.pictures.scene import front_gap
from brink.sim.adapters.sumo.specification import MAGNITUDES, ErrorType, Network
from brink.sim.catalogue import Simulator, make_simulator
from brink.sim.episode import EpisodeResult, EpisodeSpec, Json
from brink.sim.errors import InvalidEpisode
from brink.sim.trace import WORDS, Trace

pytestmark = pytest.mark.long("needs SUMO")

REQUIREMENTS = ("front-gap@1", "no-collision@1", "red-light@1")
NETWORKS = tuple(network.value for network in Network)
ROADS = Path(__file__).parents[4] / "sim" / "adapters" / "sumo" / "roads"
OWN_DEMAND = """<routes>
  <vType id="any" sigma="0.5"/>
  <route id="through" edges="before merge after"/>
  <vType id="slow" maxSpeed="12"/>
  <vehicle id="right" type="slow" route="through" depart="0" departLane="0" departPos="200" departSpeed="12"/>
  <vehicle id="lead" type="slow" route="through" depart="0" departLane="1" departPos="200" departSpeed="12"/>
  <vehicle id="left" type="slow" route="through" depart="0" departLane="2" departPos="200" departSpeed="12"/>
  <flow id="flow" type="any" route="through" begin="0" end="60" vehsPerHour="900" departLane="2"/>
  <vehicle id="mine" type="any" route="through" depart="1" departLane="1" departPos="120" departSpeed="20"/>
  <vehicle id="other" type="any" route="through" depart="4" departLane="1"/>
</routes>"""


@pytest.fixture(scope="module")
def simulator() -> Simulator:
    return make_simulator("sumo@1")


def gap_of(result: EpisodeResult) -> float:
    return result.verdicts["front-gap@1"].robustness


def specification(
    network: str = "arterial",
    error: dict[str, Json] | None = None,
    *,
    seed: int = 2,
    duration_s: float = 30.0,
    incident: tuple[float, float] | None = (12.0, 4.0),
    **scenario: Json,
) -> EpisodeSpec:
    happens: dict[str, Json] = {"incident": "none"}
    if incident is not None:
        happens = {"incident": "lead_brakes", "incident_s": incident[0], "incident_mps2": incident[1]}
    return EpisodeSpec(
        simulator="sumo@1",
        scenario={
            "network": network,
            "demand": 0.8,
            "trucks": 0.15,
            "imperfection": 0.5,
            "signals_s": 0.0,
            "automated": 0.3,
            "surface": "dry",
            **happens,
            **scenario,
        },
        behaviour={"mode": "errors", "error": error},
        requirements=REQUIREMENTS,
        seed=seed,
        duration_s=duration_s,
        options={"headway_s": 1.0},
    )


def error_of(
    kind: ErrorType,
    severity: float = 1.0,
    affected: str = "ego",
    *,
    onset_s: float = 3.0,
    duration_s: float = 12.0,
) -> dict[str, Json]:
    document: dict[str, Json] = {
        "type": kind.value,
        "affected": affected,
        "magnitude": MAGNITUDES[kind].at(severity),
        "onset_s": onset_s,
    }
    return document | ({"duration_s": duration_s} if MAGNITUDES[kind].has_duration else {})


def content(result: EpisodeResult) -> str:
    """Return everything in a result that must not depend on when and where it was simulated."""
    verdicts = {name: [one.robustness, one.violated_at_s] for name, one in result.verdicts.items()}
    document = json.dumps([verdicts, dict(result.objectives), dict(result.features)], sort_keys=True)
    return hashlib.sha256(document.encode() + (result.trace or b"")).hexdigest()


def some_episodes() -> list[EpisodeSpec]:
    return [
        specification("motorway", error_of(ErrorType.NOISE, 0.4, "fleet"), duration_s=15.0),
        specification("arterial", error_of(ErrorType.SHORT_RANGE, 0.9, "fleet"), duration_s=15.0),
        specification("grid", error_of(ErrorType.LATE, 0.3, "fleet"), duration_s=15.0),
        specification("ring", error_of(ErrorType.MISS), duration_s=15.0),
    ]


def test_equal_episodes_are_equal_after_others_and_with_and_without_a_trace(simulator: Simulator) -> None:
    specs = some_episodes()
    first = [content(simulator.run(spec, record=True)) for spec in specs]
    plain = [simulator.run(spec) for spec in reversed(specs)]
    again = [content(simulator.run(spec, record=True)) for spec in specs]
    assert again == first
    for spec, result in zip(specs, reversed(plain), strict=True):
        recorded = simulator.run(spec, record=True)
        assert content(replace(recorded, trace=None)) == content(result)


@pytest.mark.parametrize("network", NETWORKS)
def test_without_an_error_the_ego_keeps_all_requirements_in_traffic_without_collisions(
    simulator: Simulator, network: str
) -> None:
    for seed, surface in ((0, "dry"), (1, "icy")):
        result = simulator.run(specification(network, seed=seed, surface=surface))
        assert not any(verdict.violated for verdict in result.verdicts.values())
        assert result.features["crashes"] == 0
        assert result.features["ended_at_s"] == 30.0
        assert isinstance(vehicles := result.features["vehicles"], int)
        assert vehicles > 30
        assert result.features["error_acted_at_s"] is None


@pytest.mark.parametrize("kind", ErrorType)
def test_every_error_acts_from_its_onset_on_and_changes_the_drive(
    simulator: Simulator, kind: ErrorType
) -> None:
    true = simulator.run(specification("ring"), record=True)
    wrong = simulator.run(specification("ring", error_of(kind)), record=True)
    assert wrong.features["error_acted_at_s"] == pytest.approx(3.0)
    ways = [motion(result)[:, :2] for result in (true, wrong)]
    shorter = min(map(len, ways))
    apart_m = np.hypot(*(ways[0][:shorter] - ways[1][:shorter]).T)
    assert (apart_m[:30] == 0).all()
    assert apart_m.max() > 0.5


def motion(result: EpisodeResult) -> Any:
    assert result.trace is not None
    return Trace.from_bytes(result.trace).ego


def test_the_more_severe_an_error_the_smaller_the_gap(simulator: Simulator) -> None:
    gaps = [
        simulator.run(specification(error=error_of(ErrorType.TOO_FAR, severity, duration_s=25.0)))
        .verdicts["front-gap@1"]
        .robustness
        for severity in (0.0, 0.03, 0.06, 0.3)
    ]
    assert gaps == sorted(gaps, reverse=True)
    assert gaps[0] > 0 > gaps[-1]


def test_an_error_of_no_magnitude_is_the_truth(simulator: Simulator) -> None:
    true = simulator.run(specification())
    for kind in (ErrorType.TOO_FAR, ErrorType.TOO_NEAR, ErrorType.TOO_FAST, ErrorType.NOISE):
        assert simulator.run(specification(error=error_of(kind, 0.0))).verdicts == true.verdicts


def test_a_collision_ends_the_episode_and_is_in_the_trace(simulator: Simulator) -> None:
    result = simulator.run(specification("ring", error_of(ErrorType.MISS)), record=True)
    assert result.features["ended"] == "collision"
    assert result.trace is not None
    trace = Trace.from_bytes(result.trace)
    [event] = trace.events
    assert event.kind == "collision"
    lead = result.features["no-collision@1:collision_with"]
    assert event.text.startswith(f"the ego hits {lead} at")
    assert event.time_s == result.features["ended_at_s"] == pytest.approx(float(trace.time_s[-1]))
    assert lead in {actor.name for actor in trace.actors}


def test_nothing_is_printed_or_left_behind(
    simulator: Simulator, capfd: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    simulator.run(specification("ring", error_of(ErrorType.MISS)), record=True)
    assert capfd.readouterr() == ("", "")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"scenario": {"network": "motorways"}}, "did you mean 'motorway'"),
        ({"scenario": {"demand": 1.5}}, "scenario.demand: expected a number in \\[0, 1\\]"),
        ({"scenario": {"demand": True}}, "scenario.demand"),
        ({"scenario": {"surface": None}}, "scenario.surface: expected one of dry, wet, icy"),
        ({"scenario": {"weather": "rain"}}, "unknown field 'weather'"),
        ({"behaviour": {"mode": "oracle"}}, "behaviour.mode: expected errors"),
        ({"behaviour": {"error": {"type": "miss"}}}, "behaviour.error.affected: missing"),
        ({"behaviour": {"error": {"type": "blind"}}}, "behaviour.error.type: expected one of miss"),
        ({"behaviour": {"error": "miss"}}, "behaviour.error: expected an object"),
        ({"behaviour": {"error": error_of(ErrorType.MISS) | {"magnitude": 11.0}}}, "in \\[0, 10\\]"),
        ({"behaviour": {"error": error_of(ErrorType.LATE, onset_s=31.0)}}, "in \\[0, 30\\]"),
        ({"options": {"headway_s": 0.0}}, "options.headway_s"),
        ({"options": {"tau": 1.0}}, "options: unknown field 'tau'"),
        ({"duration_s": 1e9}, "at most 600 seconds"),
        ({"simulator": "brink-drive@3"}, "expected sumo@1"),
        ({"requirements": ("front-gap",)}, "did you mean 'front-gap@2'"),
    ],
)
def test_an_episode_that_can_never_run_is_refused(
    simulator: Simulator, changes: dict[str, Any], message: str
) -> None:
    spec = specification()
    merged: dict[str, Any] = {
        name: {**getattr(spec, name), **value} if isinstance(value, dict) else value
        for name, value in changes.items()
    }
    with pytest.raises(InvalidEpisode, match=message):
        simulator.run(replace(spec, **merged))


@pytest.fixture
def own_files(tmp_path: Path) -> dict[str, str]:
    from brink.sim.adapters.sumo.own_files import OwnFiles

    demand = tmp_path / "demand.rou.xml"
    demand.write_text(OWN_DEMAND, encoding="utf-8")
    found = OwnFiles.read(str(ROADS / "motorway.net.xml.gz"), str(demand), "mine")
    return {name: str(value) for name, value in found.to_json().items()}


def with_own_files(
    files: dict[str, str], error: dict[str, Json] | None = None, **scenario: Json
) -> EpisodeSpec:
    return replace(
        specification(error=error),
        scenario={
            "files": dict(files),
            "demand": 1.0,
            "automated": 0.5,
            "surface": "dry",
            "incident": "none",
            **scenario,
        },
    )


def test_a_network_of_ones_own_runs_with_errors_of_the_ego(
    simulator: Simulator, own_files: dict[str, str]
) -> None:
    true, wrong = (
        simulator.run(with_own_files(own_files, error), record=True)
        for error in (None, error_of(ErrorType.TOO_FAR))
    )
    assert wrong.features["error_acted_at_s"] == pytest.approx(3.0)
    assert not np.array_equal(motion(wrong), motion(true))
    assert true.trace is not None
    assert "lead" in {actor.name for actor in Trace.from_bytes(true.trace).actors}


def test_a_share_of_a_demand_of_ones_own_keeps_the_ego(
    simulator: Simulator, own_files: dict[str, str]
) -> None:
    none, half, whole = (
        simulator.run(with_own_files(own_files, demand=demand)).features["vehicles"]
        for demand in (0.0, 0.5, 1.0)
    )
    assert isinstance(half, int)
    assert isinstance(whole, int)
    assert none == 1 < half < whole


def test_files_that_have_changed_or_that_sumo_refuses_are_refused(
    simulator: Simulator, own_files: dict[str, str], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    from brink.sim.adapters.sumo.own_files import digest_of

    spec = with_own_files(own_files)
    demand = tmp_path / "demand.rou.xml"
    demand.write_text(OWN_DEMAND.replace("before merge after", "before nowhere"), encoding="utf-8")
    with pytest.raises(InvalidEpisode, match="they have changed since the campaign was submitted"):
        simulator.run(spec)
    files = own_files | {"digest": digest_of(own_files["network"], str(demand))}
    with pytest.raises(InvalidEpisode, match="nowhere"):
        simulator.run(with_own_files(files))
    with pytest.raises(InvalidEpisode, match="no such file"):
        simulator.run(with_own_files(files | {"network": "/nowhere.net.xml"}))
    assert capfd.readouterr().err == ""
    assert simulator.run(specification("ring")).features["ended"] == "time"


def test_errors_of_the_fleet_act_on_other_vehicles(simulator: Simulator) -> None:
    alone, fleet = (
        simulator.run(
            specification("ring", error_of(ErrorType.MISS, 1.0, affected, onset_s=1.0), automated=0.9)
        )
        for affected in ("ego", "fleet")
    )
    assert isinstance(alone.features["crashes"], int)
    assert isinstance(fleet.features["crashes"], int)
    assert fleet.features["crashes"] > alone.features["crashes"]


def test_the_lead_brakes_at_the_incident(simulator: Simulator) -> None:
    calm = simulator.run(specification("motorway", incident=None))
    tense = simulator.run(specification("motorway", incident=(5.0, 6.0)))
    assert calm.features["incident_at_s"] is None
    assert tense.features["incident_at_s"] == pytest.approx(5.0)
    assert gap_of(tense) < gap_of(calm)


def test_the_trace_shows_the_gap_that_the_requirement_measured(simulator: Simulator) -> None:
    error = error_of(ErrorType.TOO_FAR, 0.1, duration_s=25.0)
    result = simulator.run(specification(error=error), record=True)
    assert result.trace is not None
    trace = Trace.from_bytes(result.trace)
    decisive = int(trace.robustness["front-gap@1"].argmin())
    gap = front_gap(trace, decisive)
    assert gap is not None
    body = gap.ends[1] - gap.ends[0]
    assert np.hypot(*body) == pytest.approx(gap.gap_m, abs=0.1)
    assert trace.about[WORDS] == (
        "arterial road with traffic lights, traffic at 80% of capacity, 15% trucks, 30% automated cars, dry road; "
        "the vehicle ahead brakes at 4.0 m/s² from 12.0 s on; "
        "from 3.0 s on, the ego perceives things ahead 90% too far away for 25.0 s"
    )


def test_an_ego_that_perceives_a_red_light_too_late_runs_it(simulator: Simulator) -> None:
    true, wrong = (
        simulator.run(specification(error=error, incident=None, demand=0.2, seed=0, duration_s=60.0))
        for error in (None, error_of(ErrorType.TOO_FAR, onset_s=20.0, duration_s=40.0))
    )
    assert true.verdicts["red-light@1"].robustness == pytest.approx(1.0, abs=0.1)
    assert wrong.verdicts["red-light@1"].robustness < -2.0
    assert wrong.features["hardest_braking_mps2"] == pytest.approx(8.0)
