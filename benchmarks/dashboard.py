"""Cost of the dashboard: its first view, a poll, dragging a large map, and the growth of a page left open for a day.

A real coordinator serves an archive of instantaneous simulations to headless Chromium on the same machine.
"""

import asyncio
import tempfile
import time
from pathlib import Path
from statistics import median
from typing import Any, Final

import httpx
from playwright.sync_api import Browser, CDPSession, Page

from benchmarks.chromium import chromium, executable
from benchmarks.endurance import fill_archive
from benchmarks.load import MODULE
from benchmarks.measurement import Progress, Row, at_least, counted, under
from benchmarks.processes import CoordinatorProcess, running_coordinator

FIRST_VIEW_S: Final = 1.0
FIRST_VIEW_KB: Final = 500.0
POLL_MS: Final = 2.0
POLL_BYTES: Final = 500.0
FRAMES_PER_S: Final = 30.0
GROWTH_MIB: Final = 2.0
DRAG_S: Final = 4.0
POLL_INTERVAL_MS: Final = 10_000
"""Interval at which a page polls an idle campaign."""
POLLS_PER_DAY: Final = 24 * 3600 * 1000 // POLL_INTERVAL_MS
_MAPPED: Final = "canvas.map[data-points]"
_PROGRESS: Final = "/campaigns/{campaign_id}/progress"


def measure_dashboard(
    progress: Progress, *, solutions: int, views: int = 7, polls: int = POLLS_PER_DAY
) -> list[Row]:
    """Measure the dashboard.

    Args:
        progress: Progress callback.
        solutions: Size of the archive.
        views: Number of first views, whose median is taken.
        polls: Number of polls of a page that is left open.

    Raises:
        NoChromium: Chromium is not installed.
        MeasurementFailed: The coordinator did not start.
    """
    executable()  # fails before an archive is filled
    with (
        tempfile.TemporaryDirectory(prefix="brink-dashboard-") as name,
        running_coordinator(Path(name), MODULE) as coordinator,
    ):
        campaign, _ = asyncio.run(fill_archive(coordinator, solutions, progress))
        with chromium() as browser:
            found = [_first_view(browser, coordinator.url) for _ in counted(progress, "first views", views)]
            poll_ms, poll_bytes = _poll(coordinator, campaign)
            frames, paint_ms, drawn = _drag(browser, coordinator.url, campaign)
            growth = _left_open(browser, coordinator.url, campaign, polls, progress)
    seconds, kilobytes = (median(values) for values in zip(*found, strict=True))
    painting = f"{drawn:,} points; painting takes {paint_ms:.1f} ms (median)"
    return [
        under("first view, s", seconds, FIRST_VIEW_S, f"median of {views}, empty cache"),
        under("first view, kB", kilobytes, FIRST_VIEW_KB, "including headers"),
        under("poll of an idle campaign, ms of server time", poll_ms, POLL_MS, "mean of 500, answered 304"),
        under("poll of an idle campaign, bytes", poll_bytes, POLL_BYTES, "including headers"),
        at_least("frames per second while dragging", frames, FRAMES_PER_S, painting),
        under("growth of a page left open, MiB", growth, GROWTH_MIB, f"{polls:,} polls of an idle campaign"),
    ]


def _first_view(browser: Browser, url: str) -> tuple[float, float]:
    """Return the time in s until the campaigns are listed, with an empty cache, and the kB transferred."""
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
    return seconds, sum(received) / 1000


def _poll(coordinator: CoordinatorProcess, campaign: str, times: int = 500) -> tuple[float, float]:
    """Return the coordinator's mean time in ms for a poll without changes, and the size of its response."""
    with httpx.Client(base_url=f"{coordinator.url}/api/v1", timeout=60.0) as api:
        path = f"/campaigns/{campaign}/progress?since=1000000"
        headers = {"If-None-Match": api.get(path).raise_for_status().headers["etag"]}
        before = _unchanged_polls(coordinator)
        for _ in range(times):
            answer = api.get(path, headers=headers)
            assert answer.status_code == httpx.codes.NOT_MODIFIED
        after = _unchanged_polls(coordinator)
    heads = sum(len(name) + len(value) + 4 for name, value in answer.headers.raw)
    size = len("HTTP/1.1 304 Not Modified\r\n\r\n") + heads + len(answer.content)
    return 1000 * (after[0] - before[0]) / (after[1] - before[1]), float(size)


def _unchanged_polls(coordinator: CoordinatorProcess) -> tuple[float, float]:
    """Return the total time in s of the polls answered with 304, and their number."""
    found = {"_sum": 0.0, "_count": 0.0}
    for family in coordinator.metric_families():
        for sample in family.samples:
            if sample.labels.get("route") == _PROGRESS and sample.labels.get("status") == "3xx":
                for end in found:
                    if sample.name.endswith(end):
                        found[end] = sample.value
    return found["_sum"], found["_count"]


def _drag(browser: Browser, url: str, campaign: str) -> tuple[float, float, int]:
    """Return frames per second while the map is dragged, the median painting time in ms, and the number of points."""
    context = browser.new_context(viewport={"width": 1280, "height": 900})
    page = context.new_page()
    page.goto(f"{url}/#/campaigns/{campaign}?tab=map")
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


def _left_open(browser: Browser, url: str, campaign: str, polls: int, progress: Progress) -> float:
    """Return by how many MiB a page's heap grows after the first tenth of the polls."""
    context = browser.new_context(viewport={"width": 1280, "height": 900})
    page = context.new_page()
    page.clock.install()
    page.goto(f"{url}/#/campaigns/{campaign}?tab=map")
    page.wait_for_selector(_MAPPED, timeout=120_000)
    devtools = context.new_cdp_session(page)
    devtools.send("Performance.enable")
    before = 0.0
    for number in counted(progress, "polls of a page left open", polls):
        if number == polls // 10:
            before = _heap_mib(devtools)
        _next_poll(page)
    after = _heap_mib(devtools)
    context.close()
    return after - before


def _next_poll(page: Page) -> None:
    with page.expect_response(lambda answer: "/progress" in answer.url):
        page.clock.run_for(POLL_INTERVAL_MS)


def _heap_mib(devtools: CDPSession) -> float:
    devtools.send("HeapProfiler.collectGarbage")
    metrics: list[dict[str, Any]] = devtools.send("Performance.getMetrics")["metrics"]
    return float(next(one["value"] for one in metrics if one["name"] == "JSHeapUsedSize")) / 2**20
