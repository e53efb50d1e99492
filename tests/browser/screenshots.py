"""Pictures of every view, and of a report, for the documentation: ``make screenshots``.

It serves a demonstration of its own, simulated for real by two workers with fixed seeds: a campaign in urban traffic,
the quickstart, an experiment, a campaign that goes on, one of other drivers, and one whose jobs are in quarantine. At
the end, all questions about the pairs of the quickstart are asked, and its report is opened.
"""

import io
import logging
import socket
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import Any, Final

import httpx
from PIL import Image
from playwright.sync_api import Browser, Page
from playwright.sync_api import expect as shown
from support.api import eventually, expect, listening_coordinator, progress, submit
from support.databases import sqlite_template

from benchmarks.chromium import chromium
from brink.cli.options import with_api
from brink.report.campaign import campaign_report, write_page
from browser.console import Console, silence
from browser.served import API, SECRET, a_pair, origin, worker
from browser.views import View, open_view, views_of
from browser.visits import Theme, visiting

FOLDER: Final = Path(__file__).resolve().parents[2] / "docs" / "images" / "dashboard"
SIZES: Final = {"wide": (1280, 900), "narrow": (390, 844)}
REPORT_SIZE: Final = (1040, 1720)
LABELS: Final[dict[str, dict[str, Any]]] = {
    "front gap": {"tags": ["release-3"]},
    "quickstart": {
        "tags": ["night", "release-4"],
        "notes": "For the review of release 4: do the hazards of release 3 still exist?",
    },
    "other drivers": {"tags": ["traffic"]},
}
"""Tags and notes by the name of the campaign."""
THEMES: Final[tuple[Theme, ...]] = ("light", "dark")
COLOURS: Final = 256
PATIENCE_S: Final = 240.0
WORKERS: Final = 2
USUAL_PORT: Final = 8700

URBAN: Final = {"id": "urban-injected@1"}
MLCSHE: Final = {"id": "mlcshe@1"}
SEARCH: Final[dict[str, Any]] = {
    "name": "front gap",
    "problem": URBAN,
    "algorithm": MLCSHE,
    "budget": {"simulations": 400},
    "seed": 5,
}
PAIRS: Final[dict[str, Any]] = {
    **SEARCH,
    "name": "quickstart",
    "algorithm": {"id": "edge@1"},
    "budget": {"simulations": 300},
    "seed": 1,
}
TRAFFIC: Final[dict[str, Any]] = {
    "name": "other drivers",
    "problem": {"id": "npc-actions@1"},
    "algorithm": {"id": "random@1"},
    "budget": {"simulations": 60},
    "seed": 1,
}
HURRIED: Final[dict[str, Any]] = {
    **SEARCH,
    "name": "hurried",
    "problem": {"id": "urban-injected@1", "params": {"timeout_s": 0.01}},
    "budget": {"simulations": 8},
    "algorithm": {"id": "random@1", "params": {"generation_size": 4}},
    "execution": {"max_attempts": 1, "cache": False},
}
RUNNING: Final = {
    **SEARCH,
    "name": "collisions",
    "budget": {"simulations": 20_000},
    "priority": -10,
    "problem": {"id": "urban-injected@1", "params": {"requirement": "no-collision@1"}},
}
EXPERIMENT: Final = {
    "name": "which search finds more",
    "problems": [URBAN],
    "algorithms": [
        {**MLCSHE, "name": "MLCSHE"},
        {"id": "ga@1", "name": "GA"},
        {"id": "random@1", "name": "random"},
    ],
    "seeds": {"first": 1, "count": 2},
    "budget": {"simulations": 200},
}


@contextmanager
def demonstration(folder: Path) -> Iterator[tuple[httpx.Client, list[View], str]]:
    """Serve campaigns that have run, and one that runs, until the end of the block.

    Args:
        folder: For the database.

    Yields:
        A client of the coordinator, all views, and the id of the quickstart.
    """
    database = f"sqlite:///{sqlite_template(folder)}"
    with ExitStack() as stack:
        client = stack.enter_context(listening_coordinator(database, port=_port()))
        for number in range(1, WORKERS + 1):
            stack.enter_context(worker(origin(client), folder, "--id", f"worker-{number}"))
        experiment = str(expect(client.post(f"{API}/experiments", json=EXPERIMENT), 201)["id"])
        hurried, traffic, search, pairs, running = (
            submit(client, {**body, **LABELS.get(body["name"], {})})
            for body in (HURRIED, TRAFFIC, SEARCH, PAIRS, RUNNING)
        )
        wanted = {
            search: "finished",
            pairs: "finished",
            traffic: "finished",
            hurried: "paused",
            running: "running",
        }

        def ready() -> bool:
            stands = {one: progress(client, one) for one in wanted}
            there = all(stands[one]["status"] == status for one, status in wanted.items())
            done = expect(client.get(f"{API}/experiments/{experiment}"))["status"] == "finished"
            return there and done and bool(stands[running]["generation"] > 3)

        eventually(ready, "the campaigns finish, and one goes on", PATIENCE_S)
        again = expect(client.post(f"{API}/campaigns/{search}/repeats", json={"repeats": 10}), 201)[
            "campaign"
        ]
        eventually(partial(_has_finished, client, again), "its boundary is simulated again", PATIENCE_S)
        members = expect(client.get(f"{API}/experiments/{experiment}"))["members"]
        compared = [one["campaign"] for one in members if one["seed"] == 1]
        views = views_of(
            search,
            _telling(client, search),
            compared,
            experiment,
            f"#/campaigns/{pairs}/pairs",
            a_pair(client, pairs, "")[1],
        )
        found = View(
            name="finding",
            place=f"#/campaigns/{pairs}",
            ready=("role=button[name='Confirm the pairs']", ".best-pairs figure:last-child .sides.drawn"),
        )
        goes_on = View(name="running", place=f"#/campaigns/{running}", ready=("canvas.map", ".legend li"))
        yield client, [*views, found, goes_on], pairs


def photograph(browser: Browser, console: Console, client: httpx.Client, views: list[View]) -> Iterator[Path]:
    """Take all pictures of views; give the files one by one."""
    for theme in THEMES:
        for size, (width, height) in SIZES.items():
            with visiting(browser, console) as visit:
                page = visit(origin(client), width=width, height=height, theme=theme)
                for view in views:
                    if view.name.startswith("campaign, "):
                        continue  # the documentation shows the overview of a campaign alone
                    open_view(page, origin(client), view)
                    _compose(page, view.name)
                    yield save(page, f"{view.name}-{theme}-{size}")


def photograph_signing_in(browser: Browser, console: Console, client: httpx.Client) -> Iterator[Path]:
    """Take all pictures of the page that asks for a token; give the files one by one."""
    console.expect_status(401)
    for theme in THEMES:
        for size, (width, height) in SIZES.items():
            with visiting(browser, console) as visit:
                page = visit(origin(client), width=width, height=height, theme=theme)
                shown(page.get_by_role("heading", name="Sign in")).to_be_visible()
                yield save(page, f"sign-in-{theme}-{size}")


def photograph_report(
    browser: Browser, console: Console, client: httpx.Client, campaign: str, folder: Path
) -> Path:
    """Ask everything about the pairs of a campaign, and take a picture of the beginning of its report."""
    for kind in ("confirm", "component", "minimise"):
        asked = expect(client.post(f"{API}/campaigns/{campaign}/pairs/follow-ups", json={"kind": kind}), 201)
        eventually(partial(_has_finished, client, asked["campaign"]), f"the answer to {kind}", PATIENCE_S)
    with ThreadPoolExecutor(1) as other:  # in this thread the browser has an event loop of its own
        report = other.submit(
            with_api, origin(client), None, lambda api: campaign_report(api, campaign, workers=True)
        ).result()
    write_page(folder / "report.html", report)
    width, height = REPORT_SIZE
    context = browser.new_context(viewport={"width": width, "height": height}, color_scheme="light")
    page = context.new_page()
    console.watch(page)
    page.goto((folder / "report.html").as_uri())
    file = save(page, "../report")
    context.close()
    return file


def save(page: Page, name: str) -> Path:
    """Save what a page shows as a picture with a palette."""
    file = (FOLDER / f"{name}.png").resolve()
    with Image.open(io.BytesIO(page.screenshot(animations="disabled"))) as taken:
        few = taken.convert("RGB").quantize(
            COLOURS, method=Image.Quantize.MAXCOVERAGE, kmeans=8, dither=Image.Dither.NONE
        )
    few.save(file, optimize=True)
    return file


def _has_finished(client: httpx.Client, campaign: str) -> bool:
    return bool(progress(client, campaign)["status"] == "finished")


def _compose(page: Page, name: str) -> None:
    """Have a view show what is worth a picture."""
    if name == "solution":
        page.get_by_role("button", name="Go to").click()
        _scroll_to(page, "Replay")
    if name == "pair":
        _scroll_to(page, "The change")
    if name == "campaigns":
        shown(page.get_by_text("being worked out", exact=True)).to_have_count(0, timeout=PATIENCE_S * 1000)
    if name == "jobs":  # where files lie on the machine that simulated says nothing
        for told in page.locator("details[open] > summary").all():
            told.click()
    if name in ("compare", "experiment"):
        shown(page.get_by_text("being scored")).to_have_count(0, timeout=PATIENCE_S * 1000)


def _scroll_to(page: Page, region: str) -> None:
    """Scroll a part of a view to the top, below the header."""
    below = page.locator("header").bounding_box() or {"height": 0}
    page.get_by_role("region", name=region, exact=True).evaluate(
        "(node, below) => scrollBy(0, node.getBoundingClientRect().top - below - 16)", below["height"]
    )


def _telling(client: httpx.Client, campaign: str) -> int:
    """Return the unsafe solution that is nearest to the boundary."""
    told = expect(client.get(f"{API}/campaigns/{campaign}/solutions", params={"unsafe": True, "limit": 500}))
    return int(min(told["solutions"], key=lambda one: (one["fitness"], one["number"]))["number"])


def _port() -> int:
    """Return the usual port, for the addresses on the pictures, if nobody listens there; else any."""
    with socket.socket() as trial:
        return 0 if trial.connect_ex(("127.0.0.1", USUAL_PORT)) == 0 else USUAL_PORT


def main() -> None:
    """Take all pictures."""
    logging.getLogger("brink.server").setLevel(
        logging.ERROR
    )  # workers that are killed at the end leave leases behind
    FOLDER.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder, chromium() as browser, silence() as console:
        began = time.monotonic()
        with demonstration(Path(folder)) as (client, views, quickstart):
            print(f"the demonstration is ready after {time.monotonic() - began:.0f} s")
            for file in photograph(browser, console, client, views):
                print(f"{file.relative_to(FOLDER.parents[2])}: {file.stat().st_size / 1000:.0f} kB")
            file = photograph_report(browser, console, client, quickstart, Path(folder))
            print(f"{file.relative_to(FOLDER.parents[2])}: {file.stat().st_size / 1000:.0f} kB")
        guarded = Path(folder) / "guarded"
        guarded.mkdir()
        with listening_coordinator(f"sqlite:///{sqlite_template(guarded)}", token=SECRET) as client:
            for file in photograph_signing_in(browser, console, client):
                print(f"{file.relative_to(FOLDER.parents[2])}: {file.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
