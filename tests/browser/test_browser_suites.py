"""Suites on the dashboard: the commands that add drives, and the drives of a suite by versions."""

import re
from typing import Any

import pytest
from playwright.sync_api import expect as shown
from support.api import eventually, expect, progress

from browser.served import API, PATIENCE_S, Served, unsafe_one
from browser.visits import Browse

pytestmark = pytest.mark.long("the dashboard beyond a walk through it")

PLACES = {"inside": ("unsafe", 0.1), "edge": ("unsafe", 0.7), "outside": ("safe", 1.9)}


def simulated(site: Served, limit: float, label: str) -> str:
    """Simulate a suite on the ball, which is unsafe within a limit, and return the campaign."""
    entries = [
        {"name": name, "system": "ball", "seed": 1}
        | {side: {"expect": side, "values": {"where.x": x, "what.y": 0.0}}}
        for name, (side, x) in PLACES.items()
    ]
    suite = {"suite": 1, "systems": {"ball": {"problem": "ball@1"}}, "entries": entries}
    body: dict[str, Any] = {"name": "edges", "suite": suite, "changes": {"limit": limit}, "label": label}
    campaign: str = expect(site.client.post(f"{API}/suites/runs", json=body), 201)[0]["campaign"]
    eventually(lambda: progress(site.client, campaign)["status"] == "finished", "it is simulated", PATIENCE_S)
    return campaign


def test_a_drive_is_added_to_a_suite_by_a_command(site: Served, browse: Browse) -> None:
    number = unsafe_one(site)["number"]
    page = browse(f"#/campaigns/{site.urban}/solutions/{number}")
    page.get_by_role("button", name="Add to suite").click()
    dialog = page.get_by_role("dialog", name="Add to suite")
    command = f"brink suite add hazards.yaml {site.urban} --solutions {number} --server {site.url}"
    shown(dialog.get_by_text(command)).to_be_visible()
    page.keyboard.press("Escape")
    shown(dialog).to_have_count(0)
    shown(page.get_by_role("button", name="Add to suite")).to_be_focused()


def test_the_drives_of_a_suite_are_shown_by_versions(site: Served, browse: Browse) -> None:
    simulated(site, 0.5, "1.0")
    newest = simulated(site, 2.5, "1.1")
    page = browse(f"#/campaigns/{newest}")
    page.get_by_role("link", name="Compare versions").click()
    table = page.get_by_role("table", name="Drives by versions")
    heads = table.get_by_role("columnheader").get_by_role("link")
    shown(heads).to_have_text(["1.1", "1.0"])
    first = table.get_by_role("row").nth(1)
    shown(first.get_by_role("rowheader")).to_contain_text("turned unsafe")
    shown(first.get_by_role("cell").first).to_contain_text("✗ 5 of 5")
    shown(table.get_by_role("row").last).to_contain_text("inside")
    shown(first.get_by_role("cell").first.get_by_role("link")).to_have_attribute(
        "href", re.compile(rf"#/campaigns/{newest}/solutions/\d+$")
    )
