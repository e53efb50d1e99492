"""Commands that talk to a coordinator about campaigns: submit, status, results, tag, note, pause, resume, and others.

They load neither the search nor the server, so they start fast with ``--server``.
"""

from contextlib import nullcontext
from datetime import datetime
from pathlib import Path
from shlex import quote
from typing import Annotated, Any

import typer
from rich.text import Text

from brink.api.client import Api, Refused
from brink.api.following import Silent, follow
from brink.api.live import CampaignDisplay, failures_of, spark, waits_words
from brink.api.terminal import echo
from brink.cli.options import (
    AsJson,
    CampaignFile,
    CampaignId,
    Confirmed,
    Database,
    DistanceThreshold,
    FitnessThreshold,
    Odd,
    Server,
    about_file,
    check_ids,
    check_out,
    console,
    delete_confirmed,
    place_option,
    plain_table,
    print_json,
    print_line,
    program,
    read_odd,
    with_api,
    write_json,
)
from brink.server.api.schemas import CampaignView, JobList, JobViewModel, Progress, WorkerView
from brink.server.campaigns.body import DEFAULT_D_TH, DEFAULT_T_B, read_campaign_file
from brink.server.errors import InvalidInput
from brink.server.findings.boundary.views import Boundary
from brink.server.states import CampaignStatus
from brink.sim.catalogue import start_words

ERRORS_SHOWN = 5
SOLUTIONS_SHOWN = 50
MOST_LISTED = 200
"""Campaigns that the coordinator lists at once."""
ALL_GENERATIONS = 10**9
"""Cursor beyond the last generation of every campaign, for progress without its series of generations."""
RETRY_PAGE = 1000
"""Quarantined jobs to fetch at a time."""


def submit(
    file: CampaignFile,
    server: Annotated[
        str, typer.Option("--server", envvar="BRINK_SERVER", help="URL of the coordinator.")
    ] = "http://127.0.0.1:8700",
    watch: Annotated[bool, typer.Option("--watch", help="Show progress until the campaign ends.")] = False,
    key: Annotated[
        str | None, typer.Option(help="Idempotency key: a second submission with the same key has no effect.")
    ] = None,
    odd: Odd = None,
    as_json: AsJson = False,
) -> None:
    """Submit a campaign to a coordinator.

    Example: brink submit examples/paper-mlcshe.yaml --server http://coordinator:8700 --watch
    """
    body = read_campaign_file(file).within_odd(read_odd(odd))

    async def work(api: Api) -> bool:
        headers = {"Idempotency-Key": key} if key else {}
        with about_file(file):
            response = await api.request(
                "POST", "/campaigns", json=body.model_dump(mode="json"), headers=headers
            )
        campaign = CampaignView.model_validate_json(response.content)
        if as_json and not watch:
            print_json(response.json())
        elif not as_json:
            known = "" if response.status_code == 201 else " (submitted before with this key)"
            console().print(f"campaign {campaign.id}{known}")
            if not watch:
                print_line(
                    f"show its progress with: {program()} status {campaign.id} --server {quote(server)}"
                )
                found = await api.read(Progress, f"/campaigns/{campaign.id}/progress")
                if words := waiting_words(found, server):
                    console().print(words, soft_wrap=True, style="yellow")
        return await watch_campaign(api, campaign.id, as_json=as_json) if watch else True

    if not with_api(server, None, work):
        raise typer.Exit(1)


async def watch_campaign(api: Api, campaign: str, *, as_json: bool) -> bool:
    """Show the progress of a campaign until it ends or is paused.

    Args:
        api: Coordinator of the campaign.
        campaign: Id of the campaign.
        as_json: Print only the last progress, as JSON.

    Returns:
        Whether the campaign finished.
    """
    screen = console(stderr=as_json)
    waiting = ""

    def say_what_is_missing(progress: Progress) -> None:
        nonlocal waiting
        words = waiting_words(progress, api.where)
        if words and words != waiting:
            screen.print(words, soft_wrap=True, style="yellow")
        waiting = words

    with nullcontext(Silent()) if as_json else CampaignDisplay(screen) as display:
        progress = await follow(api, campaign, display, check=say_what_is_missing)
    if as_json:
        print_json(progress.model_dump(mode="json"))
    else:
        screen.print(
            f"campaign {campaign} is {progress.status}: {progress.simulations} simulations, "
            f"{progress.unsafe} unsafe {progress.status_reason}"
        )
        screen.print(f"archive sha256 {progress.digest}", soft_wrap=True)
    return progress.status is CampaignStatus.FINISHED


def waiting_words(progress: Progress, server: str) -> str:
    """Explain why no worker simulates a running campaign, and what to do; empty if nothing is wrong.

    Args:
        progress: Progress of the campaign.
        server: URL of its coordinator.
    """
    if progress.status is not CampaignStatus.RUNNING or not progress.queued or progress.leased:
        return ""
    todo = "; ".join(start_words(needs, server, program()) for needs in progress.unrunnable)
    if not progress.workers:
        todo = todo or f"start one with: {program()} worker --server {quote(server)}"
        return f"waiting: no worker is connected; {todo}"
    if sum(progress.unrunnable.values()) == progress.queued:
        return f"waiting: no connected worker provides {', '.join(progress.unrunnable)}; {todo}"
    return ""


def status(
    campaign: Annotated[
        str | None,
        typer.Argument(metavar="ID", help="Campaign id (default: all campaigns).", callback=check_ids),
    ] = None,
    tags: Annotated[
        list[str] | None,
        typer.Option(
            "--tag",
            metavar="TAG",
            show_default=False,
            help="List only campaigns with this tag; with all of them, if repeated.",
        ),
    ] = None,
    search: Annotated[
        str,
        typer.Option(
            metavar="WORDS",
            show_default=False,
            help="List only campaigns with all of these words in name, notes or tags.",
        ),
    ] = "",
    everything: Annotated[
        bool,
        typer.Option("--all", help="List follow-ups, too, below their campaigns. --json always lists them."),
    ] = False,
    database: Database = None,
    server: Server = None,
    as_json: AsJson = False,
) -> None:
    """Show the progress of all campaigns, or of one with its failures and workers.

    Example: brink status 3f2a

    Example: brink status --tag night --search rain
    """
    if campaign is not None and (tags or search):
        raise InvalidInput.at(
            "--tag" if tags else "--search", "cannot be combined with ID: it lists campaigns"
        )
    asked = {
        "limit": MOST_LISTED,
        **({"tag": tags} if tags else {}),
        **({"search": search} if search else {}),
    }
    place = place_option(server, database)

    async def work(api: Api) -> None:
        if campaign:
            await _show_campaign(api, campaign, as_json, place)
        elif as_json:
            print_json(await api.get("/campaigns", asked))
        else:
            await _list_campaigns(api, asked, place, follow_ups=everything)

    with_api(server, database, work)


async def _show_campaign(api: Api, campaign: str, as_json: bool, place: str) -> None:
    document = await api.get(f"/campaigns/{campaign}/progress")
    progress = Progress.model_validate(document)
    failed = {"campaign": progress.id, "status": "quarantined", "limit": 1000}
    if as_json:
        jobs, workers = (await api.get("/jobs", failed))["jobs"], await api.get("/workers")
        print_json({**document, "quarantined_jobs": jobs, "live_workers": workers})
        return
    quarantined = (await api.read(JobList, "/jobs", failed)).jobs
    live = [one for one in await api.read(list[WorkerView], "/workers") if one.live]
    _print_status(progress, quarantined, len(live), place)


_LISTED = (
    "id",
    "name",
    "status",
    "simulations",
    "budget",
    "unsafe",
    "failed",
    "created_at",
    "follow_up_of",
    "tags",
    "follow_ups",
)
"""The columns of the overview that the list of campaigns shows."""


async def _list_campaigns(api: Api, asked: dict[str, Any], place: str, *, follow_ups: bool) -> None:
    found = await api.get("/overview", {**asked, "follow_ups": "nested" if follow_ups else "hidden"})
    campaigns = [
        dict(zip(_LISTED, row, strict=True)) for row in zip(*(found[name] for name in _LISTED), strict=True)
    ]
    tagged = any(found["tags"])
    table = plain_table(
        "id", "name", "status", "simulations", "unsafe", "failed", "submitted", *(["tags"] if tagged else [])
    )
    depth: dict[str | None, int] = {}
    for one in campaigns:
        depth[one["id"]] = depth.get(one["follow_up_of"], -1) + 1
        table.add_row(
            one["id"],
            "  " * depth[one["id"]] + one["name"],
            one["status"],
            f"{one['simulations']} of {one['budget']}",
            str(one["unsafe"]),
            str(one["failed"]),
            f"{datetime.fromisoformat(one['created_at']):%Y-%m-%d %H:%M}",
            *([" ".join(one["tags"])] if tagged else []),
        )
    if not campaigns:
        none = f"no campaigns yet; start one with: {program()} run FILE"
        console().print(none if len(asked) == 1 else "no such campaign")
        return
    console().print(table)
    if found["next"]:
        hint = "the newest ones; narrow the list with --search WORDS or --tag TAG"
        console().print(f"{asked['limit']} of {found['total']:,} campaigns, {hint}", soft_wrap=True)
    if not follow_ups and (hidden := sum(found["follow_ups"])):
        noun = "follow-up" if hidden == 1 else "follow-ups"
        console().print(
            f"without {hidden} {noun}; list them with: {program()} status --all{place}", soft_wrap=True
        )


def _attempts(job: JobViewModel) -> str:
    """Describe how often a quarantined job was tried."""
    lost = f" and {job.losses} lost workers" if job.losses else ""
    return f"{job.counted_attempts} attempts{lost}"


def _print_status(progress: Progress, quarantined: list[JobViewModel], workers: int, place: str) -> None:
    screen = console()
    series = progress.generations
    reason = f": {progress.status_reason}" if progress.status_reason else ""
    screen.print(Text.assemble((progress.name, "bold"), f" ({progress.id}) is {progress.status}{reason}"))
    if progress.tags:
        screen.print(f"tags: {' '.join(progress.tags)}", soft_wrap=True)
    if progress.notes:
        screen.print(f"notes: {progress.notes}", soft_wrap=True)
    screen.print(
        f"{progress.simulations} of {progress.budget} simulations in {progress.elapsed_s:.0f} s, "
        f"{progress.unsafe} unsafe, {failures_of(progress)} failed, {progress.measured} measured on data, "
        f"generation {progress.generation}"
    )
    if progress.evaluated:
        screen.print(f"show what it found with: {program()} findings {progress.id}{place}", soft_wrap=True)
    if series and progress.is_for("boundary"):
        screen.print(
            f"boundary: {series[-1].dbs} distinct, {series[-1].strict_dbs} strict (fitness at most "
            f"{progress.t_b:g}, {progress.d_th:g} apart) {spark([one.dbs or 0 for one in series])}"
        )
    screen.print(
        f"jobs: {progress.queued} queued, {progress.leased} leased, {progress.quarantined} quarantined; "
        f"live workers: {workers}"
    )
    for words in waits_words(progress):
        screen.print(words, soft_wrap=True, style="yellow")
    for job in quarantined[:ERRORS_SHOWN]:
        error = (job.last_error or "").strip().splitlines()
        screen.print(
            f"  quarantined: job {job.id}, solution {job.number}, {_attempts(job)}: "
            f"{error[0] if error else ''}"
        )
    if len(quarantined) > ERRORS_SHOWN:
        more = len(quarantined) - ERRORS_SHOWN
        screen.print(f"  and {more} more: {program()} status {progress.id} --json{place}", soft_wrap=True)
    if progress.digest:
        screen.print(f"archive sha256 {progress.digest}", soft_wrap=True)


def results(
    campaign: CampaignId,
    t_b: FitnessThreshold = DEFAULT_T_B,
    d_th: DistanceThreshold = DEFAULT_D_TH,
    out: Annotated[Path | None, typer.Option(help="File to write: .csv, .jsonl, .parquet or .json.")] = None,
    database: Database = None,
    server: Server = None,
    as_json: AsJson = False,
) -> None:
    """Show the distinct boundary solutions of a campaign, or write them to a file: the best 1,000, if there are more.

    Example: brink results 3f2a --t-b 0.1 --d-th 0.2 --out boundary.csv
    """
    if out is not None:
        check_out(out, ".csv", ".jsonl", ".parquet", ".json")

    async def work(api: Api) -> None:
        path, params = f"/campaigns/{campaign}/boundary", {"t_b": t_b, "d_th": d_th}
        document: dict[str, Any] = await api.get(path, params)
        if out is not None:
            form = {**params, "format": out.suffix.lower().removeprefix(".")}
            if form["format"] == "json":
                write_json(out, document)
            else:
                out.write_bytes((await api.request("GET", path, params=form)).content)
            echo(f"{out}: {Boundary.model_validate(document).words}", err=as_json)
        if as_json:
            print_json(document)
        elif out is None:
            from brink.cli.findings import show_kind  # not before the coordinator has answered

            settings = {**params, "thresholds": True, "rows": SOLUTIONS_SHOWN}
            await show_kind(api, campaign, "boundary", settings, more="--out FILE")

    with_api(server, database, work)


def tag(
    campaign: CampaignId,
    tags: Annotated[
        list[str] | None, typer.Argument(metavar="TAG...", help="Tags to add.", show_default=False)
    ] = None,
    remove: Annotated[
        list[str] | None,
        typer.Option("--remove", metavar="TAG", help="Tag to remove; may be repeated.", show_default=False),
    ] = None,
    database: Database = None,
    server: Server = None,
    as_json: AsJson = False,
) -> None:
    """Add tags to a campaign, or remove some. Tags are short words; case does not matter.

    Example: brink tag 3f2a night release-4 --remove draft
    """
    change = {"add_tags": tags or [], "remove_tags": remove or []}
    found = _change(campaign, change if tags or remove else None, server, database)
    if as_json:
        print_json(found.tags)
    else:
        print_line(f"campaign {found.id}: {' '.join(found.tags) or 'no tags'}")


def note(
    campaign: CampaignId,
    text: Annotated[
        str | None,
        typer.Argument(metavar="[TEXT]", help="The new notes; empty for none.", show_default=False),
    ] = None,
    database: Database = None,
    server: Server = None,
    as_json: AsJson = False,
) -> None:
    """Write notes on a campaign, in place of earlier ones; without a text, show them.

    Example: brink note 3f2a "Detector of release 4. The rain looks too dark."
    """
    found = _change(campaign, None if text is None else {"notes": text}, server, database)
    if as_json:
        print_json(found.notes)
    elif text is None:
        print_line(found.notes or f"campaign {found.id} has no notes")
    else:
        print_line(f"campaign {found.id} {'has notes now' if found.notes else 'has no notes now'}")


def _change(
    campaign: str, change: dict[str, Any] | None, server: str | None, database: str | None
) -> CampaignView:
    """Change tags or notes of a campaign and return it; None changes nothing."""
    path = f"/campaigns/{campaign}"

    async def work(api: Api) -> CampaignView:
        if change is None:
            return await api.read(CampaignView, path)
        return await api.send(CampaignView, path, change, method="PATCH")

    return with_api(server, database, work)


def _control(campaign: str, verb: str, server: str | None, database: str | None) -> CampaignView:
    return with_api(server, database, lambda api: api.send(CampaignView, f"/campaigns/{campaign}/{verb}"))


def pause(campaign: CampaignId, database: Database = None, server: Server = None) -> None:
    """Pause a campaign. Its queued jobs wait; running ones still report their results.

    Example: brink pause 3f2a --server http://coordinator:8700
    """
    found = _control(campaign, "pause", server, database)
    place = place_option(server, database)
    print_line(f"campaign {found.id} is paused; continue it with: {program()} resume {found.id}{place}")


def resume(campaign: CampaignId, database: Database = None, server: Server = None) -> None:
    """Resume a paused campaign. Candidates that have failed are not simulated again.

    Example: brink resume 3f2a --server http://coordinator:8700
    """
    found = _control(campaign, "resume", server, database)
    print_line(f"campaign {found.id} is {found.status}: a coordinator with workers will continue it")


def cancel(campaign: CampaignId, database: Database = None, server: Server = None) -> None:
    """Cancel a campaign for good. Its results are kept.

    Example: brink cancel 3f2a --server http://coordinator:8700
    """
    found = _control(campaign, "cancel", server, database)
    print_line(f"campaign {found.id} is cancelled; its results are kept")


def retry(campaign: CampaignId, database: Database = None, server: Server = None) -> None:
    """Put the quarantined jobs of a campaign back into the queue, with all their attempts and losses restored.

    Jobs of earlier generations stay quarantined: the search has moved on without them. So do those of a campaign that
    has ended. The exit code is 1 if no job could be retried.

    Example: brink retry 3f2a
    """

    async def work(api: Api) -> tuple[int, str]:
        found = await api.read(Progress, f"/campaigns/{campaign}/progress")
        queued, refused, reason = 0, 0, ""
        asked = {"campaign": found.id, "status": "quarantined", "limit": RETRY_PAGE}
        async for page in api.pages(JobList, "/jobs", asked):
            for job in page.jobs:
                try:
                    await api.post(f"/jobs/{job.id}/retry")
                    queued += 1
                except Refused as error:
                    refused, reason = refused + 1, str(error)
        return queued, f"; {refused} stay quarantined: {reason}" if refused else ""

    queued, rest = with_api(server, database, work)
    print_line(f"{queued} jobs are back in the queue{rest}")
    if rest and not queued:
        raise typer.Exit(1)


def delete(
    campaign: CampaignId, confirmed: Confirmed = False, database: Database = None, server: Server = None
) -> None:
    """Delete a campaign that has ended, with all its results.

    Example: brink delete 3f2a --yes
    """
    path = f"/campaigns/{campaign}/progress"
    found = with_api(server, database, lambda api: api.read(Progress, path))
    what = f"campaign {found.id} ({found.name}) with {found.simulations} simulations"
    delete_confirmed(f"/campaigns/{found.id}", what, confirmed=confirmed, server=server, database=database)
