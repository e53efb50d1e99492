"""The page of one campaign: its map, its convergence, its table of boundary solutions, what can be done with it."""

import csv
import io
import re
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Locator, Page
from playwright.sync_api import expect as shown
from support.api import ball, expect, progress, submit

from browser.canvas import changes, picture
from browser.served import API, LOOSE, NOBODYS, Served, loose
from browser.visits import Browse

pytestmark = pytest.mark.long("the dashboard beyond a walk through it")


@pytest.fixture
def page(site: Served, browse: Browse) -> Page:
    """The page of the urban campaign, with its map drawn and its table filled."""
    page = browse(loose(site.urban))
    shown(page.get_by_text(re.compile(r"\d+ solutions\. Similar"))).to_be_visible()
    return page


@pytest.fixture
def results(site: Served, browse: Browse) -> Page:
    """The results of the urban campaign, with its table filled."""
    page = browse(loose(site.urban, "results"))
    shown(page.locator("section[aria-label='The boundary'] tbody tr").first).to_be_visible()
    return page


@pytest.fixture
def chart(page: Page) -> Locator:
    """The map, in sight."""
    chart = page.get_by_role("application", name="Map of the solutions")
    chart.scroll_into_view_if_needed()
    page.wait_for_function("canvas => canvas.frames.length > 0", arg=chart.element_handle())
    return chart


def boundary(site: Served, **more: Any) -> Any:
    answer = site.client.get(f"{API}/campaigns/{site.urban}/boundary", params={**LOOSE, **more})
    return answer.text if more else expect(answer)


def test_the_map_is_coloured_by_a_parameter_and_remembers_it(page: Page, chart: Locator) -> None:
    by_verdict = picture(chart)
    colour = page.get_by_label("Colour", exact=True)
    colour.select_option("scenario.weather")
    changes(chart, by_verdict)
    shown(page.get_by_role("list", name="Colours")).to_contain_text("rain")
    page.reload()
    shown(colour).to_have_value("scenario.weather")
    shown(page.get_by_role("list", name="Colours")).to_contain_text("rain")
    colour.select_option("verdict")
    shown(page.get_by_role("list", name="Colours")).to_contain_text("violated the front gap")
    colour.select_option("scenario.weather")
    shown(page.get_by_role("list", name="Colours")).to_contain_text("rain")


def test_the_table_of_boundary_solutions_is_filtered_and_sorted(site: Served, results: Page) -> None:
    solutions = boundary(site)["solutions"]
    region = results.get_by_role("region", name="The boundary", exact=True)
    rows = region.get_by_role("region", name="Distinct boundary solutions").locator("tbody tr")
    shown(region).to_contain_text(f"{len(solutions)} distinct boundary solutions")

    unsafe = [one for one in solutions if one["verdict"] == "unsafe"]
    assert 0 < len(unsafe) < len(solutions)
    region.get_by_role("searchbox", name="Find").fill("unsafe")
    shown(region.get_by_text(f"{len(unsafe)} of {len(solutions)} rows match.")).to_be_visible()
    shown(rows).to_have_count(min(len(unsafe), 12))  # one page of the table
    region.get_by_role("searchbox", name="Find").fill("safe")
    shown(region.get_by_text(f"{len(solutions) - len(unsafe)} of {len(solutions)} rows")).to_be_visible()

    number = max(one["number"] for one in solutions)
    region.get_by_role("searchbox", name="Find").fill(str(number))
    shown(rows.get_by_role("link", name=str(number), exact=True)).to_be_visible()
    region.get_by_role("searchbox", name="Find").fill("")

    region.get_by_role("button", name="Robustness").click()
    shown(region.get_by_role("columnheader", name="Robustness")).to_have_attribute("aria-sort", "ascending")
    least = min(solutions, key=lambda one: (one["robustness"], one["number"]))
    shown(rows.first.get_by_role("link")).to_have_text(str(least["number"]))
    region.get_by_role("button", name=f"Show all {len(solutions)} rows").click()
    shown(rows).to_have_count(len(solutions))


def test_the_boundary_is_saved_as_csv_as_the_api_tells_it(site: Served, results: Page) -> None:
    with results.expect_download() as coming:
        results.get_by_role("region", name="The boundary", exact=True).get_by_role(
            "button", name="CSV"
        ).first.click()
    assert coming.value.suggested_filename == f"boundary-{site.urban}.csv"
    saved = Path(coming.value.path()).read_text(encoding="utf-8")
    assert (
        saved
        == site.client.get(f"{API}/campaigns/{site.urban}/boundary", params={**LOOSE, "format": "csv"}).text
    )
    numbers = {row["number"] for row in csv.DictReader(io.StringIO(saved))}
    assert numbers == {str(one["number"]) for one in boundary(site)["solutions"]}


def test_new_thresholds_change_curve_and_table_and_are_kept_in_the_url(site: Served, browse: Browse) -> None:
    page = browse(f"#/campaigns/{site.urban}?tab=search")
    curve = page.get_by_role("region", name="Boundary solutions against the number of simulations")
    shown(curve.get_by_text("a fitness of at most t_b")).to_be_visible()
    curve.get_by_label("t_b").fill("1")
    curve.get_by_label("t_b").press("Enter")
    curve.get_by_label("d_th").fill("0")
    curve.get_by_label("d_th").press("Enter")
    page.get_by_role("tab", name="Results").click()
    table = page.get_by_role("region", name="The boundary", exact=True)
    shown(table).to_contain_text(f"{boundary(site)['dbs']} distinct boundary solutions")
    table.get_by_text("How to read it").click()
    shown(table.get_by_text("neighbourhoods without a single unsafe solution")).to_be_visible()
    assert page.url.endswith("?tab=results&t_b=1&d_th=0")
    page.get_by_role("tab", name="Results").press("ArrowRight")
    page.get_by_role("tab", name="Parameters").press("ArrowRight")
    curve.get_by_role("button", name="Defaults").click()
    shown(table).to_have_count(0)
    page.get_by_role("tab", name="Search").press("Home")
    shown(page.get_by_role("region", name="Finding")).to_contain_text("0 distinct boundary solutions")


SLOW = """part => {
  const ask = window.fetch;
  window.fetch = async (...given) => {
    const answer = await ask(...given);
    if (String(given[0]?.url ?? given[0]).includes(part)) await new Promise((done) => setTimeout(done, 1500));
    return answer;
  };
}"""


def test_a_threshold_that_changes_while_the_last_one_is_loading_does_not_wait(
    site: Served, browse: Browse
) -> None:
    page = browse(f"#/campaigns/{site.urban}?tab=search")
    curve = page.get_by_role("region", name="Boundary solutions against the number of simulations")
    shown(curve.get_by_text("a fitness of at most t_b")).to_be_visible()
    page.evaluate(SLOW, "/findings/boundary?t_b=1&d_th=0.2")
    for name, value in (("t_b", "1"), ("d_th", "0")):
        curve.get_by_label(name).fill(value)
        curve.get_by_label(name).press("Enter")
    page.get_by_role("tab", name="Results").click()
    card = page.get_by_role("region", name="The boundary", exact=True)
    shown(card).to_contain_text("fitness at most 1, at least 0 apart", timeout=12_000)
    page.get_by_role("tab", name="Search").click()
    curve.get_by_role("button", name="Defaults").click()
    shown(card).to_have_count(0)


def test_a_campaign_is_paused_resumed_and_cancelled(site: Served, browse: Browse) -> None:
    campaign = submit(site.client, ball(name="steered", problem=NOBODYS))
    page = browse(f"#/campaigns/{campaign}")
    state = page.locator(".head .badge")
    shown(page.get_by_text("a worker with the plug-in that provides nobody-has-it@1")).to_be_visible()
    for button, then in (
        ("Pause steered", "paused"),
        ("Resume steered", "running"),
        ("Pause steered", "paused"),
    ):
        page.get_by_role("button", name=button).click()
        shown(state).to_have_text(then)
        assert progress(site.client, campaign)["status"] == then
    page.get_by_role("button", name="Cancel steered").click()
    dialog = page.get_by_role("dialog", name="Cancel steered?")
    dialog.get_by_role("button", name="No").click()
    shown(dialog).to_be_hidden()
    shown(state).to_have_text("paused")
    page.get_by_role("button", name="Cancel steered").click()
    page.get_by_role("button", name="Cancel campaign").click()
    shown(state).to_have_text("cancelled")
    assert progress(site.client, campaign)["status"] == "cancelled"
    shown(page.get_by_role("button", name="Resume steered")).to_have_count(0)


def test_a_campaign_is_deleted_only_when_that_is_confirmed(site: Served, browse: Browse) -> None:
    campaign = submit(site.client, ball(name="unwanted", problem=NOBODYS))
    expect(site.client.post(f"{API}/campaigns/{campaign}/cancel"))
    page = browse(f"#/campaigns/{campaign}?tab=settings")
    page.get_by_role("button", name="Delete").click()
    page.get_by_role("dialog").get_by_role("button", name="Delete").click()
    shown(page.get_by_role("heading", name="Campaigns")).to_be_visible()
    shown(page.get_by_text("unwanted has been deleted.")).to_be_visible()
    shown(page.get_by_role("row", name=re.compile("unwanted"))).to_have_count(0)
    assert site.client.get(f"{API}/campaigns/{campaign}").status_code == 404
