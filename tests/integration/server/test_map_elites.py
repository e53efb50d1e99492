"""Campaigns with MAP-Elites over the API: on traffic, and on any problem that declares measures."""

from typing import Any

import httpx
import pytest
from support.api import FakeWorker, ball, expect, submit
from support.problems import Ball, simulated
from support.traffic import origins, traffic_worker

from brink.search.algorithm import Measure
from brink.server.problems.base import SimulatedProblem
from brink.server.problems.catalogue import PROBLEMS
from brink.sim import catalogue
from brink.worker.wire import Completed, LeasedJob


def test_every_solution_of_overlapping_generations_has_its_origin(client: httpx.Client) -> None:
    campaign = submit(
        client,
        {
            "name": "kinds",
            "problem": {
                "id": "npc-actions@1",
                "params": {"participants": 2, "duration_s": 5.0, "count": "avoidable"},
            },
            "algorithm": {"id": "qd@1", "params": {"generation_size": 6, "in_flight": 3, "initial": 18}},
            "budget": {"simulations": 40},
            "seed": 1,
        },
    )
    assert origins(client, campaign) == ["random"] * 18
    stands = traffic_worker(client).work(campaign)
    assert (stands["status"], stands["failed"]) == ("finished", 0)
    assert stands["finds"] == ["violations"]
    found = origins(client, campaign)
    assert len(found) == 40
    assert set(found[:18]) == {"random"}
    assert set(found[18:]) >= {"mutation", "crossover"}


class Sides(Ball):
    """The ball, with the side on which a point lies as its measure."""

    id = "sides@1"
    requirements = ("distance@1",)
    measures = (Measure(name="east_m", low=-2.0, high=2.0, unit="m"),)
    evaluation = SimulatedProblem.evaluation


def with_side(job: LeasedJob) -> Completed:
    """Return the outcome of a point, whose feature is missing in the far north, as a worker may send anything."""
    result = simulated(job.spec)
    east: Any = job.spec["scenario"]["x"] if job.spec["behaviour"]["y"] < 1.5 else "?"
    return result.model_copy(update={"features": {"east_m": east}})


def test_a_problem_that_declares_measures_is_searched_for_each_of_their_cells(
    client: httpx.Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(catalogue._registered[PROBLEMS], Sides.id, Sides)
    listed = {one["id"]: one["measures"] for one in expect(client.get("/api/v1/problems"))}
    assert listed["sides@1"] == [{"name": "east_m", "low": -2.0, "high": 2.0, "unit": "m"}]
    assert listed["ball@1"] == []
    algorithm = {"id": "qd@1", "params": {"generation_size": 10, "initial": 20, "cells": 4}}
    campaign = submit(client, ball(simulations=80, problem={"id": Sides.id}, algorithm=algorithm))
    stands = FakeWorker(client, judge=with_side).work(campaign)
    assert (stands["status"], stands["failed"], stands["evaluated"]) == ("finished", 0, 80)
    assert set(origins(client, campaign)[20:]) >= {"mutation", "crossover", "again"}
    assert stands["generations"][-1]["best_fitness"] < 0, "an unsafe elite"
    found = expect(client.get(f"/api/v1/campaigns/{campaign}/findings"))
    assert "violations" not in [one["kind"] for one in found["findings"]], "the ball does not report any"
    assert found["words"]


def test_a_problem_without_measures_is_refused_on_submission(client: httpx.Client) -> None:
    refused = client.post("/api/v1/campaigns", json=ball(algorithm={"id": "qd@1"}))
    assert refused.status_code == 422
    [error] = refused.json()["errors"]
    assert error["pointer"] == "/algorithm/id"
    assert "ball@1 declares none: choose a problem that has measures" in error["message"]
