"""Finding one's way: campaigns by name and state, an experiment's results, campaigns side by side."""

import re

import httpx
from playwright.sync_api import expect as shown
from support.api import FakeWorker, ball, expect, submit
from support.urban_pairs import SAFE, UNSAFE, judged

from brink.server.problems.urban_injected import SIMULATOR
from browser.served import NOBODYS, Served, origin
from browser.visits import Browse, Visits


def test_campaigns_are_found_by_name_and_state_and_steered_from_the_list(
    site: Served, browse: Browse
) -> None:
    submit(site.client, ball(name="needle one", problem=NOBODYS))
    submit(site.client, ball(name="needle two", problem=NOBODYS))
    page = browse()
    rows = page.locator("table.campaigns tbody tr")
    shown(rows.filter(has_text="night rain")).to_be_visible()
    page.get_by_label("Find").fill("needle")
    shown(rows).to_have_count(2)
    page.get_by_role("button", name="Pause needle one").click()
    shown(rows.filter(has_text="needle one").locator(".badge")).to_have_text("paused")
    page.get_by_label("Status").select_option("paused")
    shown(rows).to_have_count(1)
    page.reload()
    shown(rows).to_have_count(1)
    shown(page.get_by_label("Find")).to_have_value("needle")
    page.get_by_label("Find").fill("haystack")
    shown(page.get_by_text("No campaign matches.")).to_be_visible()


def test_rows_with_equal_names_show_their_ids(own: httpx.Client, visit: Visits) -> None:
    twins = [submit(own, ball(name="twin", seed=seed)) for seed in (1, 2)]
    single = submit(own, ball(name="single"))
    body = {
        "name": "again",
        "problems": [{"id": "ball@1"}],
        "algorithms": [{"id": "random@1"}],
        "budget": {"simulations": 8},
    }
    experiments = [
        str(expect(own.post("/api/v1/experiments", json={**body, "seeds": [seed]}), 201)["id"])
        for seed in (1, 2)
    ]
    page = visit(origin(own))
    rows = page.locator("table.campaigns tbody tr")
    for campaign in twins:
        shown(rows.filter(has_text=campaign)).to_contain_text("twin")
    shown(rows.filter(has_text="single")).to_be_visible()
    shown(rows.filter(has_text=single)).to_have_count(0)
    page.goto(f"{origin(own)}/#/experiments")
    for experiment in experiments:
        shown(page.locator("table.experiments tbody tr").filter(has_text=experiment)).to_contain_text("again")
    page.goto(f"{origin(own)}/#/compare?ids={','.join(twins)}")
    chosen = page.get_by_role("list", name="Compared campaigns").get_by_role("listitem")
    shown(chosen).to_have_text([f"twin {campaign}×" for campaign in twins])


def test_an_experiment_shows_its_results_and_its_campaigns(site: Served, browse: Browse) -> None:
    page = browse("#/experiments")
    page.get_by_role("link", name="two on a ball").click()
    shown(page.locator(".head .badge")).to_have_text("finished")
    shown(page.get_by_role("region", name="Progress")).to_contain_text("4 of 4")
    shown(page.get_by_role("rowheader", name="random@1").first).to_be_visible()
    page.get_by_role("link", name="Show campaigns").click()
    shown(page.locator("table.campaigns tbody tr")).to_have_count(4)


def test_an_experiment_shows_the_pairs_of_its_methods(site: Served, browse: Browse) -> None:
    page = browse(f"#/experiments/{site.experiment}")
    pairs = page.get_by_role("region", name="Pairs across the boundary")
    shown(pairs).to_contain_text("Compared on distinct pairs")
    standings = page.get_by_role("region", name="Pairs of each method on ball@1").locator("tbody tr")
    shown(standings).to_have_count(2)
    shown(pairs.locator(".sentences li")).to_contain_text("distinct pairs")
    pairs.get_by_text("Campaigns", exact=True).click()
    campaigns = page.get_by_role("region", name="Pairs of each finished campaign")
    shown(campaigns.locator("tbody tr")).to_have_count(4)
    campaigns.locator("tbody a").first.click()
    shown(page.get_by_role("heading", name="Pairs", exact=True)).to_be_visible()


def test_the_pairs_of_an_experiment_follow_its_problems_and_its_follow_ups(
    own: httpx.Client, visit: Visits
) -> None:
    finds = {"id": "repeat@1", "params": {"solutions": [SAFE, UNSAFE]}}
    body = {
        "name": "followed",
        "algorithms": [{"name": "finds", **finds}],
        "seeds": [1],
        "problems": [{"name": name, "id": "urban-injected@1"} for name in ("first", "second")],
        "budget": {"simulations": 2},
        "pairs": {"component": True},
    }
    experiment = str(expect(own.post("/api/v1/experiments", json=body), 201)["id"])
    members = expect(own.get(f"/api/v1/experiments/{experiment}"))["members"]
    first, second = (f"/api/v1/campaigns/{one['campaign']}" for one in members)
    worker = FakeWorker(own, capabilities=(SIMULATOR,), judge=judged)
    expect(own.post(f"{second}/pause"))
    worker.work(members[0]["campaign"])
    page = visit(origin(own), f"#/experiments/{experiment}")
    pairs = page.get_by_role("region", name="Pairs across the boundary")
    cells = page.get_by_role("region", name="Pairs of each method on first").locator("tbody td")
    shown(cells.last).to_have_text("–")
    shown(pairs.get_by_role("heading", name="first")).to_be_hidden()
    expect(own.post(f"{second}/resume"))
    worker.work(members[1]["campaign"])
    for name in ("first", "second"):
        shown(pairs.get_by_role("heading", name=name)).to_be_visible(timeout=30_000)
    asked = expect(own.post(f"{first}/pairs/follow-ups", json={"kind": "component"}), 201)
    worker.work(asked["campaign"])
    shown(cells.last).to_have_text("100% (1 of 1)", timeout=30_000)


def test_campaigns_that_are_ticked_stand_side_by_side(site: Served, browse: Browse) -> None:
    page = browse(f"#/compare?ids={site.urban}")
    shown(page.get_by_text("Choose one more campaign.")).to_be_visible()
    page.get_by_role("checkbox", name=re.compile("^ball ")).check()
    shown(page.get_by_role("heading", name="Side by side")).to_be_visible()
    page.reload()
    chosen = page.get_by_role("list", name="Compared campaigns").get_by_role("listitem")
    shown(chosen).to_have_text(["night rain×", "ball×"])
    shown(page.get_by_role("heading", name="Settings that differ")).to_be_visible()
    chosen.filter(has_text="night rain").get_by_role("button").click()
    shown(chosen).to_have_count(1)


def test_searches_for_pairs_are_compared_by_their_pairs(own: httpx.Client, visit: Visits) -> None:
    edge = {"id": "edge@1", "params": {"eps": 0.3, "d_th": 0.1}}
    campaigns = [submit(own, ball(name=f"seed {seed}", seed=seed, algorithm=edge)) for seed in (1, 2)]
    pairs = []
    for campaign in campaigns:
        FakeWorker(own).work(campaign)
        pairs.append(expect(own.get(f"/api/v1/campaigns/{campaign}/pairs"))["distinct"])
    page = visit(origin(own), f"#/compare?ids={','.join(campaigns)}")
    row = page.get_by_role("row").filter(has_text="Distinct pairs")
    shown(row.locator("td")).to_have_text([str(count) for count in pairs])
    shown(page.get_by_role("heading", name=re.compile("DBS"))).to_have_count(0)
