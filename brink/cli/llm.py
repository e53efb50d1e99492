"""`brink llm`: check an endpoint, preview the prompts of a campaign, list the calls of a campaign."""

import asyncio
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from brink.api.client import Api
from brink.api.live import Steps
from brink.cli.options import (
    AsJson,
    CampaignFile,
    CampaignId,
    Database,
    Server,
    about_file,
    console,
    plain_table,
    print_json,
    settings_with,
    with_api,
)
from brink.server.campaigns.body import CampaignBody, read_campaign_file
from brink.server.errors import InvalidInput
from brink.server.llm.access import LlmAccess
from brink.server.llm.seeder import EXPECTED
from brink.server.llm.settings import LlmSettings
from brink.server.seeding import LlmCalls

if TYPE_CHECKING:
    from brink.server.llm.preflight import EndpointReport

llm = typer.Typer(help="Check and preview language models that seed searches.", no_args_is_help=True)

ASSUMED_REQUESTS: Final = 5
"""Differential requests that an estimate assumes: one every four generations, for a thousand simulations."""


@llm.command()
def check(file: CampaignFile, as_json: AsJson = False) -> None:
    """Check that a campaign file's language model works, and what it supports, with up to four small prompts.

    Example: brink llm check examples/traffic-llm.yaml
    """
    from brink.server.llm.preflight import check_endpoint

    with about_file(file):
        settings = _settings(read_campaign_file(file))
    access = LlmAccess.parse(settings_with().allowing([settings.endpoint]).llm_endpoints)
    with Steps(console(stderr=True), f"querying {settings.model}"):
        report = asyncio.run(check_endpoint(settings, access=access))
    if as_json:
        print_json({"works": report.works, "mode": report.mode, **asdict(report)})
    else:
        _print_report(settings, report)
    if not report.works:
        raise typer.Exit(1)


def _print_report(settings: LlmSettings, report: "EndpointReport") -> None:
    screen = console()
    if report.trouble:
        screen.print(report.trouble, soft_wrap=True, style="red")
        return
    if report.model_listed is False:
        known = ", ".join((report.models or ())[:10])
        screen.print(
            f"{settings.model} is not among the models that the endpoint lists: {known}", style="yellow"
        )
    table = plain_table(
        "reply format", "accepted", "usable", "reports tokens", "finish reason", "seconds", "trouble"
    )
    for one in report.modes:
        table.add_row(
            one.mode,
            _yes(one.accepted),
            _yes(one.usable),
            _yes(one.usage_stated),
            one.finish_reason or "–",
            "–" if one.latency_s is None else f"{one.latency_s:.1f}",
            one.trouble or "",
        )
    screen.print(table)
    works = f"works; reply format: {report.mode}" if report.works else "gives no usable reply"
    screen.print(f"{settings.model} at {settings.endpoint} {works}")


def _yes(value: bool) -> str:
    return "yes" if value else "no"


@llm.command("dry-run")
def dry_run(
    file: CampaignFile,
    requests: Annotated[
        int, typer.Option(min=0, help="Number of differential requests that the estimate assumes.")
    ] = ASSUMED_REQUESTS,
    as_json: AsJson = False,
) -> None:
    """Print the prompts of a campaign and estimate the cost of its calls, without calling the model.

    In the differential prompt, example solutions take the place of those that the search will have found by then.

    Example: brink llm dry-run examples/traffic-llm.yaml
    """
    from brink.search.algorithm import SeedRequest
    from brink.server.campaigns.plan import make_checked_plan
    from brink.server.llm.preflight import estimate
    from brink.server.llm.prompts import example, question
    from brink.server.problems.base import SupportsSeeds

    body = read_campaign_file(file)
    with about_file(file):
        settings = _settings(body)
        plan = make_checked_plan(body)
    problem = plan.problem
    assert isinstance(problem, SupportsSeeds)  # checked with the plan
    config: Any = plan.config
    initial = config.population_size if getattr(config, "initial", "") == "seeds" else 0
    request = SeedRequest(number=0, count=initial or config.seeds)
    messages = question(request, problem.road, problem.max_participants, problem.system)
    known = (example(problem.road, problem.max_participants),)
    later = SeedRequest(number=1, count=config.seeds, exposed=known, silent=known)
    asks_later = getattr(config, "differential", "never") != "never"
    differential = (
        question(later, problem.road, problem.max_participants, problem.system) if asks_later else ()
    )
    requests = requests if asks_later else 0
    found = estimate(
        settings, problem, initial=initial, differential=config.seeds, differential_calls=requests
    )
    if as_json:
        print_json(
            {
                "messages": [asdict(one) for one in messages],
                "differential": [asdict(one) for one in differential],
                "calls": found.expected.total_calls,
                "most_calls": found.most.total_calls,
                "tokens": found.expected.total_tokens,
                "most_tokens": found.most.total_tokens,
                "cost": found.expected.cost,
                "most_cost": found.most.cost,
            }
        )
        return
    screen = console()
    for title, prompt in (("first", messages), ("differential", differential)):
        for one in prompt:
            screen.print(f"{title} request, {one.role}", style="bold")
            screen.print(one.content, soft_wrap=True)
            screen.print()
    screen.print(f"with {requests} differential requests: {found.words}", soft_wrap=True)
    if asks_later:
        screen.print(
            f"seeds that do not differ enough are requested again up to {config.rounds} times, one request each; "
            f"max_calls {settings.max_calls} limits the total of all HTTP requests",
            soft_wrap=True,
        )
    screen.print(
        f"waiting for the seeds of one request delays the campaign by at most {settings.delay_limit_s:g} s "
        "(max_delay_s)",
        soft_wrap=True,
    )


@llm.command()
def log(
    campaign: CampaignId,
    out: Annotated[
        Path | None, typer.Option(help="Folder for the raw replies, one file each.", file_okay=False)
    ] = None,
    database: Database = None,
    server: Server = None,
    as_json: AsJson = False,
) -> None:
    """List the language model calls of a campaign, with their outcomes, HTTP requests and costs.

    Example: brink llm log 3f2a --out replies
    """

    async def work(api: Api) -> None:
        params = {"replies": out is not None or as_json}
        document = await api.get(f"/campaigns/{campaign}/llm-calls", params)
        found = LlmCalls.model_validate(document)
        if out is not None:
            out.mkdir(parents=True, exist_ok=True)
            for call in found.calls:
                path = out / f"reply-{call.request}-{call.turn}.json"
                path.write_text(call.reply or "", encoding="utf-8")
        if as_json:
            print_json(document)
        else:
            _print_calls(found)

    with_api(server, database, work)


def _print_calls(found: LlmCalls) -> None:
    table = plain_table("request", "turn", "outcome", "HTTP requests", "tokens", "cost", "seconds")
    for call in found.calls:
        tokens = "–" if call.prompt_tokens is None else str(call.tokens)
        table.add_row(
            str(call.request),
            str(call.turn),
            call.outcome,
            str(call.calls),
            f"{tokens} (estimate)" if call.estimated else tokens,
            _money(call.cost),
            f"{call.latency_s:.1f}",
        )
    screen = console()
    screen.print(table)
    for call in found.calls:
        if call.error:
            screen.print(f"request {call.request}, turn {call.turn}: {call.error}", soft_wrap=True)
    most = "" if found.max_calls is None else f" of at most {found.max_calls} (max_calls)"
    screen.print(
        f"{found.total_calls} HTTP requests{most}, {found.total_tokens} tokens "
        f"({found.estimated_tokens} of them estimated), cost {_money(found.cost)}"
    )


def _money(cost: float | None) -> str:
    return "unknown" if cost is None else f"{cost:.4g}"


def _settings(body: CampaignBody) -> LlmSettings:
    """Return the language model of a campaign file.

    Raises:
        InvalidInput: The file names none.
    """
    if not isinstance(body.llm, LlmSettings):
        raise InvalidInput.at("/llm", EXPECTED)
    return body.llm
