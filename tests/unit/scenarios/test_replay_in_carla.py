"""The script for CARLA, run against a stand-in for CARLA's client that keeps what it is told: no CARLA is at hand."""

import math
import runpy
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from support.drives import absent, urban_drive

from brink.scenarios.exportable import EgoControl
from brink.scenarios.folder import Origin, write_openscenario
from brink.sim.trace import Trace

ORIGIN = Origin(campaign="3f2a0000", name="quickstart", number=17, words="a drive", deciding=())
HALF_PERSON_M = 0.875
STATES = {"Red": "red", "Yellow": "amber", "Green": "green"}


@dataclass
class FakeActor:
    """Keeps where it was placed, by tick."""

    blueprint: str
    world: "FakeWorld"
    places: dict[int, Any] = field(default_factory=dict)
    physics: bool = True
    alive: bool = True

    def set_transform(self, transform: Any) -> None:
        assert self.alive
        assert not self.physics
        self.places[self.world.ticks] = transform

    def set_simulate_physics(self, wanted: bool) -> None:
        self.physics = wanted

    def destroy(self) -> None:
        assert self.alive
        self.alive = False


class FakeLight:
    def __init__(self) -> None:
        self.states: list[str] = []
        self.frozen = False

    def set_state(self, state: str) -> None:
        self.states.append(state)

    def freeze(self, frozen: bool) -> None:
        self.frozen = frozen


class FakeLibrary:
    def filter(self, pattern: str) -> list[str]:
        return [] if pattern == "vehicle.mercedes.sprinter" else [pattern]


class FakeWorld:
    """A world with lights that knows only some of them by their ids, as CARLA may."""

    def __init__(self) -> None:
        self.ticks = 0
        self.actors: list[FakeActor] = []
        self.lights = {"1": FakeLight(), "3": FakeLight()}
        self.settings = SimpleNamespace(synchronous_mode=False, fixed_delta_seconds=None)
        self.applied: list[tuple[bool, float | None]] = []

    def get_settings(self) -> SimpleNamespace:
        return SimpleNamespace(**vars(self.settings))

    def apply_settings(self, settings: SimpleNamespace) -> None:
        self.settings = settings
        self.applied.append((settings.synchronous_mode, settings.fixed_delta_seconds))

    def get_blueprint_library(self) -> FakeLibrary:
        return FakeLibrary()

    def try_spawn_actor(self, blueprint: str, transform: Any) -> FakeActor | None:
        if len(self.actors) == 40:
            return None
        actor = FakeActor(blueprint, self)
        actor.places[self.ticks] = transform
        self.actors.append(actor)
        return actor

    def get_traffic_light_from_opendrive_id(self, signal: str) -> FakeLight | None:
        return self.lights.get(signal)

    def tick(self) -> None:
        self.ticks += 1


@pytest.fixture
def world(monkeypatch: pytest.MonkeyPatch) -> Iterator[FakeWorld]:
    made = FakeWorld()

    def generate(document: str, parameters: Any) -> FakeWorld:
        assert "<OpenDRIVE>" in document
        return made

    client = SimpleNamespace(set_timeout=lambda seconds: None, generate_opendrive_world=generate)
    carla = SimpleNamespace(
        Client=lambda host, port: client,
        OpendriveGenerationParameters=SimpleNamespace,
        Transform=lambda location, rotation: SimpleNamespace(location=location, rotation=rotation),
        Location=SimpleNamespace,
        Rotation=SimpleNamespace,
        TrafficLightState=SimpleNamespace(Red="Red", Yellow="Yellow", Green="Green"),
    )
    monkeypatch.setitem(sys.modules, "carla", carla)
    yield made
    assert not any(actor.alive for actor in made.actors), "all actors are removed"
    assert made.applied == [(True, 0.05), (False, None)], "the settings are restored"


def replayed(trace: Trace, folder: Path, monkeypatch: pytest.MonkeyPatch, *options: str) -> None:
    """Export a drive and run its script where it was written."""
    moment = datetime(2026, 1, 1, tzinfo=UTC)
    write_openscenario(trace, ORIGIN, folder, ego=EgoControl.RECORDED, created_at=moment)
    script = folder / "replay_in_carla.py"
    monkeypatch.setattr(sys, "argv", [str(script), *options])
    runpy.run_path(str(script), run_name="__main__")


def test_road_users_move_as_recorded_in_carlas_axes(
    world: FakeWorld, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    trace = urban_drive(9)
    replayed(trace, tmp_path, monkeypatch)
    tracks = [trace.ego, *(actor.motion for actor in trace.actors)]
    assert len(world.actors) == len(tracks)
    for actor, track in zip(world.actors, tracks, strict=True):
        for tick, transform in actor.places.items():
            time_s = tick * 0.05
            if time_s > trace.time_s[-1]:
                continue
            x_m, y_m = (np.interp(time_s, trace.time_s, track[:, column]) for column in (0, 1))
            assert transform.location.x == pytest.approx(x_m, abs=0.02)
            assert transform.location.y == pytest.approx(-y_m, abs=0.02)
        first = actor.places[0]
        assert math.cos(math.radians(first.rotation.yaw) + float(track[0, 2])) > 1.0 - 1e-6
        assert len(actor.places) >= len(trace.time_s)
    pedestrians = [actor for actor in world.actors if actor.blueprint.startswith("walker")]
    assert len(pedestrians) == sum(actor.kind == "pedestrian" for actor in trace.actors) > 0
    assert {one.places[0].location.z for one in pedestrians} == {HALF_PERSON_M + 0.05}
    assert {one.blueprint for one in world.actors} == {
        "vehicle.tesla.model3",
        "vehicle.*",
        "walker.pedestrian.0001",
    }


def test_lights_that_carla_knows_are_set(
    world: FakeWorld, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    trace = urban_drive(9)
    replayed(trace, tmp_path, monkeypatch)
    main = world.lights["1"]
    assert main.frozen
    for time_s, shown in zip(trace.time_s.astype(float).tolist(), trace.lights, strict=True):
        tick = round(time_s / 0.05)
        if shown and tick + 1 < len(main.states):
            assert shown in {STATES[main.states[index]] for index in (tick - 1, tick, tick + 1) if index >= 0}
    assert {STATES[state] for state in world.lights["3"].states} <= {"red", "amber", "green"}


def test_road_users_are_absent_when_they_were(
    world: FakeWorld, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    trace = absent(urban_drive(0), "lead", (0, 20), (50, 80))
    replayed(trace, tmp_path, monkeypatch)
    assert len(world.actors) == 1 + len(trace.actors) + 1, "one more when it comes back"
    leads = [actor for actor in world.actors if min(actor.places) > 0]
    assert [min(actor.places) * 0.05 for actor in leads] == pytest.approx(
        [float(trace.time_s[20]), float(trace.time_s[80])], abs=0.051
    )


def test_skipped_entities_are_left_to_others(
    world: FakeWorld, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    trace = urban_drive(0)
    replayed(trace, tmp_path, monkeypatch, "--skip", "ego")
    assert len(world.actors) == len(trace.actors)


def test_an_actor_without_room_is_left_out(
    world: FakeWorld, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    trace = urban_drive(1)
    replayed(trace, tmp_path, monkeypatch)
    assert len(world.actors) == 40
    assert "no room for parked-" in capsys.readouterr().out
