"""What the dashboard costs: its first view, a poll, a drag of a large map, a day of being left open.

A real coordinator and a real headless Chromium on one machine, on an archive of simulations that took no time.
"""

import asyncio
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any, Final

import httpx
from playwright.sync_api import Browser, CDPSession, Page
from prometheus_client.parser import text_string_to_metric_families

from brink.bench.endurance.archive import filled
from brink.bench.figures import Row
from brink.bench.load.problem import MODULE
from brink.bench.telling import Told
from brink.bench.temporary.chromium import chromium, executable
from brink.bench.temporary.coordinator import CoordinatorProcess
from brink.sim.catalogue import PLUGINS_VARIABLE

FIRST_VIEW_S: Final = 1.0
FIRST_VIEW_KB: Final = 500.0
POLL_MS: Final = 2.0
POLL_BYTES: Final = 500.0
FRAMES_PER_S: Final = 30.0
GROWTH_MIB: Final = 2.0
DRAG_S: Final = 4.0
IDLE_MS: Final = 10_000
DAY_POLLS: Final = 24 * 3600 * 1000 // IDLE_MS
_MAPPED: Final = "canvas.map[data-points]"
_PROGRESS: Final = "/campaigns/{campaign_id}/progress"


@dataclass(frozen=True, slots=True, kw_only=True)
class FirstView:
    """What a first view cost, with an empty cache.

    Attributes:
        seconds: Until the campaigns were listed.
        kilobytes: That were fetched for it.
    """

    seconds: float
    kilobytes: float


def measure_dashboard(told: Told, *, solutions: int, views: int = 7, polls: int = DAY_POLLS) -> list[Row]:
    """Return the figures of the dashboard beside their targets.

    Args:
        told: Hears how far it is.
        solutions: Of the archive.
        views: First views; the median is taken.
        polls: Of a page that is left open; as many as in a day, unless somebody is in a hurry.

    Raises:
        NoChromium: There is no Chromium.
        DidNotStart: The coordinator did not come up.
    """
    executable()  # before an archive is filled
    with tempfile.TemporaryDirectory(prefix="brink-dashboard-") as name:
        folder = Path(name)
        database = f"sqlite:///{folder}/archive.db"
        coordinator = CoordinatorProcess(database, folder / "coordinator.log", {PLUGINS_VARIABLE: MODULE})
        try:
            coordinator.start_ready()
            campaign, _ = asyncio.run(filled(coordinator, solutions, told))
            with chromium() as browser:
                seen = [_first_view(browser, coordinator.url) for _ in _counted(told, "first views", views)]
                poll_ms, poll_bytes = _poll(coordinator.url, campaign)
                frames, paint_ms, drawn = _drag(browser, coordinator.url, campaign)
                growth = _left_open(browser, coordinator.url, campaign, polls, told)
        finally:
            coordinator.kill()
    return [
        _row("first view, s", median(one.seconds for one in seen), FIRST_VIEW_S, f"median of {views}, empty cache"),
        _row("first view, kB", median(one.kilobytes for one in seen), FIRST_VIEW_KB, "headers included"),
        _row("poll of an idle campaign, ms of server time", poll_ms, POLL_MS, "mean of 500, answered 304"),
        _row("poll of an idle campaign, bytes", poll_bytes, POLL_BYTES, "headers included"),
        Row(
            what="frames a second while dragging", value=frames, target=f"at least {FRAMES_PER_S:g}",
            met=frames >= FRAMES_PER_S, note=f"{drawn:,} points; painting takes {paint_ms:.1f} ms (median)",
        ),
        _row("growth of a page left open, MiB", growth, GROWTH_MIB, f"{polls:,} polls of an idle campaign"),
    ]  # fmt: skip


def _row(what: str, value: float, most: float, note: str) -> Row:
    return Row(what=what, value=value, target=f"under {most:g}", met=value < most, note=note)


def _counted(told: Told, part: str, total: int) -> Iterator[int]:
    for number in range(total):
        told(part, number, total)
        yield number
    told(part, total, total)


def _first_view(browser: Browser, url: str) -> FirstView:
    context = browser.new_context(viewport={"width": 1280, "height": 900})
    page = context.new_page()
    devtools = context.new_cdp_session(page)
    devtools.send("Network.enable")
    received: list[float] = []
    devtools.on("Network.loadingFinished", lambda event: received.append(event["encodedDataLength"]))
    began = time.perf_counter()
    page.goto(f"{url}/", wait_until="commit")
    page.wait_for_selector("table.campaigns tbody tr")
    seconds = time.perf_counter() - began
    page.wait_for_load_state("networkidle")
    context.close()
    return FirstView(seconds=seconds, kilobytes=sum(received) / 1000)


def _poll(url: str, campaign: str, times: int = 500) -> tuple[float, float]:
    """Return the mean time that the coordinator takes for a poll that brings nothing, and the size of its answer."""
    with httpx.Client(base_url=f"{url}/api/v1", timeout=60.0) as api:
        path = f"/campaigns/{campaign}/progress?since=1000000"
        headers = {"If-None-Match": api.get(path).raise_for_status().headers["etag"]}
        before = _served(url)
        for _ in range(times):
            answer = api.get(path, headers=headers)
            assert answer.status_code == httpx.codes.NOT_MODIFIED
        after = _served(url)
    heads = sum(len(name) + len(value) + 4 for name, value in answer.headers.raw)
    size = len("HTTP/1.1 304 Not Modified\r\n\r\n") + heads + len(answer.content)
    return 1000 * (after[0] - before[0]) / (after[1] - before[1]), float(size)


def _served(url: str) -> tuple[float, float]:
    """Return how long answers of 304 to polls took altogether, and how many there were."""
    found = {"_sum": 0.0, "_count": 0.0}
    text = httpx.get(f"{url}/metrics", timeout=60.0).raise_for_status().text
    for family in text_string_to_metric_families(text):
        for sample in family.samples:
            if sample.labels.get("route") == _PROGRESS and sample.labels.get("status") == "3xx":
                for end in found:
                    if sample.name.endswith(end):
                        found[end] = sample.value
    return found["_sum"], found["_count"]


def _drag(browser: Browser, url: str, campaign: str) -> tuple[float, float, int]:
    """Return frames a second while the map is dragged, the median time of painting one, and its points."""
    context = browser.new_context(viewport={"width": 1280, "height": 900})
    page = context.new_page()
    page.goto(f"{url}/#/campaigns/{campaign}")
    canvas = page.locator("canvas.map")
    page.wait_for_selector(_MAPPED, timeout=120_000)
    canvas.scroll_into_view_if_needed()
    box = canvas.bounding_box()
    assert box is not None
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.evaluate("document.querySelector('canvas.map').frames.length = 0")
    began = time.perf_counter()
    step = 0
    while time.perf_counter() - began < DRAG_S:
        step += 1
        page.mouse.move(x + 60 * (step % 9 - 4), y + 30 * (step % 7 - 3))
    frames: list[list[float]] = page.evaluate("document.querySelector('canvas.map').frames")
    page.mouse.up()
    drawn = int(canvas.get_attribute("data-points") or 0)
    context.close()
    span_s = (frames[-1][0] - frames[0][0]) / 1000
    return (len(frames) - 1) / span_s, median(frame[1] for frame in frames), drawn


def _left_open(browser: Browser, url: str, campaign: str, polls: int, told: Told) -> float:
    """Return by how many MiB the heap of a page grows over so many polls, after the first tenth of them."""
    context = browser.new_context(viewport={"width": 1280, "height": 900})
    page = context.new_page()
    page.clock.install()
    page.goto(f"{url}/#/campaigns/{campaign}")
    page.wait_for_selector(_MAPPED, timeout=120_000)
    devtools = context.new_cdp_session(page)
    devtools.send("Performance.enable")
    before = 0.0
    for number in _counted(told, "polls of a page left open", polls):
        if number == polls // 10:
            before = _heap_mib(devtools)
        _next_poll(page)
    after = _heap_mib(devtools)
    context.close()
    return after - before


def _next_poll(page: Page) -> None:
    with page.expect_response(lambda answer: "/progress" in answer.url):
        page.clock.run_for(IDLE_MS)


def _heap_mib(devtools: CDPSession) -> float:
    devtools.send("HeapProfiler.collectGarbage")
    metrics: list[dict[str, Any]] = devtools.send("Performance.getMetrics")["metrics"]
    return float(next(one["value"] for one in metrics if one["name"] == "JSHeapUsedSize")) / 2**20
