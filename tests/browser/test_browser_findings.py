"""A kind of findings that the page does not know is shown from its sentence and its tables."""

import re

import httpx
import pytest
from playwright.sync_api import expect as shown
from support.api import FakeWorker, ball, expect, finish
from support.bisection import Bisection
from support.extremes import ExtremesAlgorithm, ExtremesKind
from support.sweep import Sweep, along_x, by_seed

from brink.server.findings.kind import FINDINGS
from brink.server.problems.catalogue import ALGORITHMS
from brink.sim import catalogue
from browser.served import origin
from browser.visits import Visits


def test_a_toy_kind_has_a_card_with_its_table_and_all_its_rows(
    own: httpx.Client, visit: Visits, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(catalogue._registered, FINDINGS, {ExtremesKind.id: ExtremesKind})
    monkeypatch.setitem(catalogue._registered, ALGORITHMS, {ExtremesAlgorithm.id: ExtremesAlgorithm})
    campaign = finish(own, ball(simulations=40, algorithm={"id": ExtremesAlgorithm.id}))
    FakeWorker(own).lease()
    page = visit(origin(own), f"#/campaigns/{campaign}")
    worst = expect(own.get(f"/api/v1/campaigns/{campaign}/findings"))["findings"][0]["view"]["worst"]
    shown(page.get_by_role("region", name="Finding", exact=True)).to_contain_text(
        f"Solution {worst} is the most"
    )
    steps = page.get_by_role("region", name="What to do next")
    shown(steps.get_by_text("What happens there?")).to_be_visible()
    page.get_by_role("tab", name="Results").click()
    card = page.get_by_role("region", name="Extremes", exact=True)
    shown(card.get_by_role("columnheader", name="robustness (m)")).to_be_visible()
    shown(card.get_by_role("row")).to_have_count(11)
    shown(card.get_by_role("link", name=str(worst), exact=True)).to_be_visible()
    card.get_by_role("button", name="Show all 40 rows").click()
    shown(card.get_by_role("row")).to_have_count(41)


def test_a_toy_algorithm_of_pairs_has_the_pages_of_pairs(
    own: httpx.Client, visit: Visits, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(catalogue._registered, ALGORITHMS, {Bisection.id: Bisection})
    campaign = finish(own, ball(simulations=60, algorithm={"id": Bisection.id, "params": {"eps": 0.04}}))
    FakeWorker(own).lease()
    count = expect(own.get(f"/api/v1/campaigns/{campaign}/pairs"))["distinct"]
    page = visit(origin(own), f"#/campaigns/{campaign}")
    words = f"{count} distinct pairs across the boundary"
    shown(page.get_by_role("region", name="Finding", exact=True)).to_contain_text(words)
    shown(page.get_by_role("region", name="What to do next")).to_contain_text("Do the pairs hold?")
    page.get_by_role("tab", name="Search").click()
    shown(page.get_by_role("heading", name="Fitness by generation")).to_be_hidden()
    shown(page.get_by_role("heading", name="Distinct boundary solutions")).to_be_hidden()
    page = visit(origin(own), f"#/campaigns/{campaign}/pairs")
    shown(page.get_by_role("main")).to_contain_text(words)


def test_thresholds_have_a_curve_each(
    own: httpx.Client, visit: Visits, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(catalogue._registered, ALGORITHMS, {Sweep.id: Sweep})
    rows = along_x(0.0, [0.5, 0.7, 0.8, 0.9, 0.95, 1.0, 1.05, 1.1, 1.2, 1.5] * 3)
    body = ball(simulations=len(rows), algorithm={"id": Sweep.id, "params": {"rows": rows}})
    campaign = expect(own.post("/api/v1/campaigns", json=body), 201)["id"]
    FakeWorker(own, judge=by_seed).work(campaign)
    (one,) = expect(own.get(f"/api/v1/campaigns/{campaign}/findings/thresholds"))["view"]["thresholds"]
    page = visit(origin(own), f"#/campaigns/{campaign}")
    shown(page.get_by_role("region", name="Finding", exact=True)).to_contain_text("1 threshold of 1 kind")
    shown(page.get_by_role("region", name="What to do next")).to_contain_text("Do both ends hold?")
    page.get_by_role("tab", name="Results").click()
    card = page.get_by_role("region", name="Thresholds", exact=True)
    shown(card.get_by_role("img")).to_have_attribute("aria-label", re.compile(re.escape(one["turns"])))
    shown(card.locator("svg circle")).to_have_count(len(one["dots"]) + 1)
    shown(card.get_by_role("link", name=str(one["pair"]["unsafe"]["number"]), exact=True)).to_be_visible()


def test_an_experiment_compares_methods_by_their_thresholds(
    own: httpx.Client, visit: Visits, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(catalogue._registered, ALGORITHMS, {Sweep.id: Sweep})
    line = along_x(0.0, [0.5, 0.7, 0.8, 0.9, 0.95, 1.0, 1.05, 1.1, 1.2, 1.5] * 3)
    methods = {"along": line, "scattered": line[:2]}
    body = {
        "name": "turns",
        "problems": [{"id": "ball@1"}],
        "algorithms": [
            {"name": name, "id": Sweep.id, "params": {"rows": rows}} for name, rows in methods.items()
        ],
        "seeds": [1, 2],
        "budget": {"simulations": len(line)},
        "thresholds": {},
    }
    experiment = expect(own.post("/api/v1/experiments", json=body), 201)
    for member in experiment["members"]:
        FakeWorker(own, judge=by_seed).work(member["campaign"])
    page = visit(origin(own), f"#/experiments/{experiment['id']}")
    card = page.get_by_role("region", name="Thresholds", exact=True)
    shown(card).to_contain_text("none of them was simulated again with other seeds, so none is confirmed")
    shown(card).to_contain_text("along and scattered: distinct thresholds 1.0 against 0.0")
    row = card.get_by_role("row").filter(has=page.get_by_role("rowheader", name="along", exact=True))
    shown(row.get_by_role("cell")).to_have_text(["–", "–", "1.0 (1.0 to 1.0)", "1.0 (1.0 to 1.0)", "–", "–"])
    shown(page.get_by_role("region", name="Pairs across the boundary")).to_be_hidden()
    card.get_by_text("Campaigns", exact=True).click()
    first = experiment["members"][0]["campaign"]
    shown(card.get_by_role("link", name=first)).to_have_attribute("href", f"#/campaigns/{first}")
