"""A campaign with MAP-Elites over the API: several generations in flight, and the origin of every solution."""

import httpx
from support.api import submit
from support.traffic import origins, traffic_worker


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
