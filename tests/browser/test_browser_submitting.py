"""Submitting a campaign: by the form, as a file, as a clone; what is wrong is said where it is wrong."""

import json
import re
from typing import Any

import httpx
import pytest
from playwright.sync_api import Page
from playwright.sync_api import expect as shown
from support.api import expect

from browser.console import Console
from browser.served import API, Served
from browser.visits import Browse

pytestmark = pytest.mark.long("the dashboard beyond a walk through it")

FILE = """\
name: from a file
problem: {id: ball@1, params: {limit: 1.5}}
algorithm: {id: random@1}
budget: {simulations: 20}
seed: 5
"""


def fill(page: Page, name: str, simulations: int) -> None:
    page.get_by_label("Name", exact=True).fill(name)
    page.get_by_label("Simulations", exact=True).fill(str(simulations))
    page.get_by_label("Problem", exact=True).select_option("ball@1")
    page.get_by_label("Algorithm", exact=True).select_option("random@1")


def names(client: httpx.Client) -> list[str]:
    found: list[str] = expect(client.get(f"{API}/overview", params={"limit": 200}))["name"]
    return found


def body_of(page: Page, client: httpx.Client) -> dict[str, Any]:
    """Return what was submitted as the campaign that is shown."""
    page.wait_for_url(re.compile(r"#/campaigns/[0-9a-f]+"))
    campaign = page.url.rpartition("/")[2]
    found: dict[str, Any] = expect(client.get(f"{API}/campaigns/{campaign}"))["body"]
    return found


@pytest.mark.parametrize(
    ("label", "wrong", "words", "right"),
    [
        ("Simulations", "0", "greater than or equal to 1", "20"),
        ("Limit", "9", "less than or equal to 4", "1.5"),
    ],
)
def test_what_is_wrong_is_said_beside_its_field_and_nothing_is_stored(
    site: Served, browse: Browse, console: Console, label: str, wrong: str, words: str, right: str
) -> None:
    name = f"wrong at first: {label}"
    page = browse("#/new")
    fill(page, name, 20)
    field = page.get_by_label(label, exact=True)
    if label == "Limit":
        page.get_by_text("Parameters of the problem").click()
    field.fill(wrong)
    console.expect_status(422)
    page.get_by_role("button", name="Submit campaign").click()
    shown(page.get_by_text("Some fields are invalid; see the messages next to them.")).to_be_visible()
    shown(field).to_have_attribute("aria-invalid", "true")
    shown(field).to_have_accessible_description(re.compile(words))
    shown(field).to_be_focused()
    assert name not in names(site.client)

    field.fill(right)
    page.get_by_role("button", name="Submit campaign").click()
    shown(page.get_by_role("heading", name=name)).to_be_visible()


def test_a_campaign_can_be_checked_without_being_stored(site: Served, browse: Browse) -> None:
    page = browse("#/new")
    fill(page, "only checked", 20)
    page.get_by_role("button", name="Check only").click()
    shown(page.get_by_text("only checked is valid: ball@1, random@1, 20 simulations.")).to_be_visible()
    assert "only checked" not in names(site.client)


def test_a_campaign_file_is_pasted_and_submitted(site: Served, browse: Browse, console: Console) -> None:
    page = browse("#/new")
    page.get_by_role("button", name="Campaign file").click()
    page.get_by_label("Campaign file").fill(FILE.replace("random@1", "randm@1"))
    console.expect_status(422)
    page.get_by_role("button", name="Submit campaign").click()
    shown(page.get_by_role("alert").filter(has_text="Did you mean random@1?")).to_contain_text("algorithm.id")
    page.get_by_label("Campaign file").fill(FILE)
    page.get_by_role("button", name="Submit campaign").click()
    shown(page.get_by_role("heading", name="from a file")).to_be_visible()
    submitted = body_of(page, site.client)
    assert (submitted["seed"], submitted["problem"]["params"]["limit"]) == (5, 1.5)


def test_a_clone_is_the_same_campaign_with_the_next_seed(site: Served, browse: Browse) -> None:
    page = browse()
    page.get_by_role("button", name="Clone night rain").click()
    shown(page.get_by_role("heading", name="Clone of night rain")).to_be_visible()
    page.get_by_label("Name", exact=True).fill("clone")  # other tests look for the original by its name
    page.get_by_role("button", name="Submit campaign").click()
    original = expect(site.client.get(f"{API}/campaigns/{site.urban}"))["body"]
    assert body_of(page, site.client) == {**original, "name": "clone", "seed": original["seed"] + 1}
    expect(site.client.post(f"{API}/campaigns/{page.url.rpartition('/')[2]}/cancel"))  # it simulates for real


def test_the_odd_and_the_distribution_are_entered_in_fields(site: Served, browse: Browse) -> None:
    page = browse("#/new")
    page.get_by_label("Name", exact=True).fill("within limits")
    page.get_by_label("Simulations", exact=True).fill("20")
    page.get_by_label("Problem", exact=True).select_option("urban-errors@1")
    page.get_by_text("Parameters of the problem").click()
    odd, distribution = (page.get_by_role("group", name=name) for name in ("ODD", "Operational distribution"))
    for group, parameters in (
        (odd, ("scenario.weather", "behaviour.error_1.onset_s")),
        (distribution, ("scenario.time_of_day", "behaviour.error_1.duration_s")),
    ):
        for parameter in parameters:
            group.get_by_role("button", name=re.compile("a parameter$")).click()
            group.get_by_role("combobox", name=re.compile("^Parameter")).last.select_option(parameter)
    odd.get_by_label("clear").check()
    odd.get_by_label("wet cloudy").check()
    odd.get_by_label("Maximum").fill("6")
    distribution.get_by_label("Weight of noon").fill("3")
    distribution.get_by_label("Weight of night").fill("1")
    distribution.get_by_label("Kind of distribution").select_option("exponential")
    distribution.get_by_label("mean of the distribution").fill("2.5")
    for _ in range(2):  # the form holds what it makes of its own file
        page.get_by_role("button", name="Campaign file").click()
        written = page.get_by_label("Campaign file").input_value()
        params = json.loads(written.partition("\n")[2])["problem"]["params"]
        assert params["odd"] == {
            "scenario.weather": ["clear", "wet_cloudy"],
            "behaviour.error_1.onset_s": {"max": 6},
        }
        assert params["distribution"] == {
            "scenario.time_of_day": {"weights": {"noon": 3, "night": 1}},
            "behaviour.error_1.duration_s": {"exponential": {"mean": 2.5}},
        }
        page.get_by_role("button", name="Form").click()
        shown(odd.get_by_label("Maximum")).to_have_value("6")
