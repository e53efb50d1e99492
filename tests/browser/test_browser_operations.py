"""Workers and jobs: what is in quarantine and why, a job that is retried, and a worker that is drained."""

import httpx
import pytest
from playwright.sync_api import expect as shown
from support.api import FakeWorker, ball, expect, submit

from brink.server.states import Scope
from brink.worker.wire import Completed, JobFailed, LeasedJob
from browser.served import API, origin
from browser.test_browser_tokens import token_of
from browser.visits import Visits

pytestmark = pytest.mark.long("the dashboard beyond a walk through it")


def gives_up(job: LeasedJob) -> Completed | JobFailed:
    return JobFailed(reason="crashed", message="the engine gave up\nin the second line")


@pytest.fixture
def unlucky(own: httpx.Client) -> tuple[str, int]:
    """A campaign that waits for its jobs, three of which are in quarantine; one of those."""
    campaign = submit(own, ball(name="unlucky", execution={"max_attempts": 1, "max_failed_share": 1.0}))
    breaking = FakeWorker(own, id="breaking", judge=gives_up)
    jobs = breaking.lease(3)
    breaking.report(jobs)
    return campaign, jobs[0].job


def test_quarantined_job_is_retried_and_done(
    own: httpx.Client, unlucky: tuple[str, int], visit: Visits
) -> None:
    campaign, job = unlucky
    page = visit(origin(own), f"#/campaigns/{campaign}")
    shown(page.get_by_text("First error: ")).to_contain_text("Crashed: the engine gave up.")
    shown(page.get_by_role("region", name="Finding")).to_contain_text("Failed3")
    page.get_by_text("3 jobs in quarantine.").get_by_role("link", name="Inspect and retry").click()
    row = page.get_by_role("row").filter(has=page.get_by_role("rowheader", name=str(job), exact=True))
    row.locator("summary").filter(has_text="the engine gave up").click()
    shown(row.get_by_text("in the second line")).to_be_visible()
    row.get_by_role("button", name=f"Retry job {job}").click()
    shown(page.get_by_text(f"Job {job} is back in the queue.")).to_be_visible()
    shown(row).to_have_count(0)
    shown(page.get_by_role("button", name="In quarantine 2")).to_be_visible()

    FakeWorker(own, id="working").work(campaign, until=lambda stands: stands["generation"] > 0)
    page.goto(f"{origin(own)}/#/campaigns/{campaign}")
    shown(page.get_by_role("region", name="Finding")).to_contain_text("In quarantine2")
    numbers = expect(own.get(f"{API}/campaigns/{campaign}/solutions"))["solutions"]
    assert len([one for one in numbers if one["verdict"] in ("safe", "unsafe")]) == 18


def test_a_worker_is_drained_from_the_page_once_that_is_confirmed(own: httpx.Client, visit: Visits) -> None:
    submit(own, ball())
    worker = FakeWorker(own)
    assert worker.lease(max_jobs=1)
    page = visit(origin(own), "#/workers")
    row = page.locator("table.workers tbody tr")
    row.get_by_role("button", name="Drain worker-1").click()
    dialog = page.get_by_role("dialog", name="Drain worker-1?")
    dialog.get_by_role("button", name="No").click()
    assert worker.lease(max_jobs=1)
    row.get_by_role("button", name="Drain worker-1").click()
    dialog.get_by_role("button", name="Drain").click()
    shown(row.locator(".badge")).to_have_text("draining")
    shown(row.get_by_role("button")).to_have_count(0)
    assert worker.lease() == []


@pytest.mark.parametrize(("scope", "buttons"), [(Scope.USER, 0), (Scope.ADMIN, 1)])
def test_only_an_admin_sees_the_button_that_drains_a_worker(
    guarded: httpx.Client, own_database: str, visit: Visits, scope: Scope, buttons: int
) -> None:
    served = FakeWorker(guarded, id="theirs")
    guarded.headers["Authorization"] = f"Bearer {token_of(own_database, 'worker')}"
    served.lease()
    page = visit(origin(guarded), "#/workers", token=token_of(own_database, scope))
    row = page.locator("table.workers tbody tr")
    shown(row).to_contain_text("theirs")
    shown(row.get_by_role("button", name="Drain theirs")).to_have_count(buttons)
