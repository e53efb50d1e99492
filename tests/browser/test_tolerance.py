"""The tolerances of a campaign on its page: curves, requirements with examples, drives without any error."""

import csv
import io
import re
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Locator, Page
from playwright.sync_api import expect as shown
from support.api import eventually, expect, progress, submit

from browser.served import API, PATIENCE_S, Served
from browser.test_browser_accessibility import RULES, faults
from browser.visits import Browse, Theme

pytestmark = pytest.mark.long("the dashboard beyond a walk through it")

PHONE_PX = 390

TOLERANCE: dict[str, Any] = {
    "name": "how wrong it may be",
    "problem": {"id": "urban-errors@1", "params": {"errors": 1, "duration_s": 8.0}},
    "algorithm": {
        "id": "tolerance@1",
        "params": {
            "cells": {"type": ["miss", "left"], "target": ["lead"]},
            "conditions": [{"name": "by night", "time_of_day": "night"}],
            "without_error": 8,
            "generation_size": 20,
            "grossest": {},
        },
    },
    "budget": {"simulations": 60},
    "seed": 1,
}


CAMERA: dict[str, Any] = {
    "name": "a detector by night",
    "problem": {
        "id": "urban-camera@1",
        "params": {"duration_s": 6.0, "odd": {"scenario.time_of_day": "night", "scenario.pedestrians": 0}},
    },
    "algorithm": {"id": "random@1"},
    "budget": {"simulations": 3},
    "seed": 5,
}
"""Drives with a detector in the loop, under the condition of the tolerances."""


def finished(site: Served, document: dict[str, Any]) -> str:
    made = submit(site.client, document)
    eventually(
        lambda: progress(site.client, made)["status"] == "finished", f"{document['name']} ends", PATIENCE_S
    )
    return made


@pytest.fixture(scope="module")
def campaign(site: Served) -> str:
    """A finished search for tolerances."""
    return finished(site, TOLERANCE)


@pytest.fixture(scope="module")
def camera(site: Served) -> str:
    """A finished campaign with a detector in the loop."""
    return finished(site, CAMERA)


@pytest.fixture
def told(site: Served, campaign: str) -> Any:
    """What the coordinator says of the tolerances."""
    return expect(site.client.get(f"{API}/campaigns/{campaign}/tolerance"))


@pytest.fixture
def page(browse: Browse, campaign: str) -> Page:
    """The page of the campaign, with its tolerances drawn."""
    page = browse(f"#/campaigns/{campaign}")
    shown(
        page.get_by_role("region", name="Tolerances", exact=True).locator(".curves figure").first
    ).to_be_visible()
    return page


def card_of(page: Page) -> Locator:
    return page.get_by_role("region", name="Tolerances", exact=True)


def test_the_card_shows_a_curve_for_each_error_and_says_each_requirement(
    page: Page, campaign: str, told: Any
) -> None:
    card = card_of(page)
    shown(page.get_by_role("region", name="Finding", exact=True)).to_contain_text(told["note"][1:])
    shown(
        card.get_by_role("img", name=re.compile("^Not reporting the lead for …: share of drives"))
    ).to_be_visible()
    shown(card.locator(".curves figure")).to_have_count(2)
    shown(card.get_by_role("list", name="Conditions")).to_contain_text("by night")
    rows = card.get_by_role("region", name="Tolerated magnitude of each error").locator("tbody tr")
    shown(rows).to_have_count(len(told["cells"]))
    for row, cell in zip(rows.all(), told["cells"], strict=True):
        shown(row).to_contain_text(cell["tolerated_words"])
        for example in cell["examples"][:1]:
            shown(row.get_by_role("link")).to_have_attribute(
                "href", f"#/campaigns/{campaign}/solutions/{example['number']}"
            )
    share = told["baseline"][0]["share"]
    shown(card.get_by_role("region", name="Drives without any error")).to_contain_text(
        f"{share['evaluated']}"
    )


def test_tolerances_are_saved_as_csv(page: Page, campaign: str, told: Any) -> None:
    with page.expect_download() as saved:
        card_of(page).get_by_role("button", name="CSV").first.click()
    assert saved.value.suggested_filename == f"tolerances-{campaign}.csv"
    rows = list(csv.DictReader(io.StringIO(Path(saved.value.path()).read_text())))
    assert [row["sentence"] for row in rows] == [cell["sentence"] for cell in told["cells"]]


def check_detector(page: Page, camera: str) -> Locator:
    """Check the detector of a campaign on the page; return the table of results."""
    card = card_of(page)
    card.get_by_text("Does a detector meet it?").click()
    chosen = card.get_by_label("Detector of the campaign")
    shown(chosen.locator("option")).to_have_count(
        2
    )  # of campaigns without a detector in the loop, none is offered
    chosen.select_option(camera)
    results = card.get_by_role("region", name="Results of the detector")
    shown(results).to_be_visible()
    return results


def test_the_detector_of_another_campaign_is_checked(
    page: Page, site: Served, campaign: str, camera: str
) -> None:
    check = expect(
        site.client.get(f"{API}/campaigns/{campaign}/tolerance/detector", params={"episodes": camera})
    )
    results = check_detector(page, camera)
    card = card_of(page)
    shown(card).to_contain_text(check["note"])
    shown(card).to_contain_text(check["meaning"])
    shown(card).to_contain_text(check["no_data"])
    for words in check["next"]:
        shown(card.get_by_role("list", name="What to record next")).to_contain_text(words)
    cells = [cell for cell in check["cells"] if cell["share"] is not None]
    rows = results.locator("tbody tr")
    shown(rows).to_have_count(len(cells))
    assert cells
    for place, cell in enumerate(cells):  # in the order of the answer: what is not met first
        row = rows.nth(place)
        shown(row).to_have_attribute("title", cell["sentence"])
        shown(row).to_contain_text(cell["result"])
        shown(row.locator("svg.bar")).to_have_count(1)
        for drive in cell["worst"][:1]:
            shown(row.get_by_role("link").first).to_have_attribute(
                "href", f"#/campaigns/{camera}/solutions/{drive}"
            )


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_the_check_of_a_detector_is_accessible(page: Page, camera: str, theme: Theme) -> None:
    page.emulate_media(color_scheme=theme)
    check_detector(page, camera)
    assert faults(page, RULES[theme]) == []
    page.set_viewport_size({"width": PHONE_PX, "height": 844})
    eventually(  # the charts follow it later
        lambda: page.evaluate("document.scrollingElement.scrollWidth") <= PHONE_PX, "it fits", PATIENCE_S
    )
