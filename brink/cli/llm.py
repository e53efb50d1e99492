"""`brink llm`: try an endpoint, see what a campaign would ask, see what one asked."""

import asyncio
from pathlib import Path
from typing import Annotated, Any, Final

import typer
from rich.markup import escape
from rich.table import Table

from brink.api.client import Api
from brink.cli.options import (
    AsJson,
    CampaignFile,
    CampaignId,
    Database,
    Server,
    console,
    print_json,
    with_api,
)
from brink.search.algorithm import SeedRequest
from brink.server.campaigns.body import CampaignBody, read_campaign_file
from brink.server.campaigns.plan import make_checked_plan
from brink.server.errors import FieldError, InvalidInput
from brink.server.llm.check import EndpointReport, check_endpoint
from brink.server.llm.estimate import estimate
from brink.server.llm.prompts import example, question
from brink.server.llm.settings import LlmSettings
from brink.server.problems.base import Describes

llm = typer.Typer(help="Language models that seed searches.", no_args_is_help=True)

ASSUMED_REQUESTS: Final = 5
"""Differential requests that an estimate assumes: one in four generations of a thousand simulations."""


@llm.command()
def check(file: CampaignFile, as_json: AsJson = False) -> None:
    """Try the language model of a campaign file, and say what it supports. Asks it up to three small questions.

    Example: brink llm check examples/traffic-llm.yaml
    """
    settings = _settings(read_campaign_file(file))
    with console().status(f"asking {settings.model}"):
        report = asyncio.run(check_endpoint(settings))
    if as_json:
        print_json(
            {
                "works": report.works, "mode": report.mode, "reachable": report.reachable,
                "models": report.models, "model_listed": report.model_listed, "trouble": report.trouble,
                "modes": [{name: getattr(one, name) for name in one.__slots__} for one in report.modes],
            }
        )  # fmt: skip
    else:
        _print_report(settings, report)
    if not report.works:
        raise typer.Exit(1)


def _print_report(settings: LlmSettings, report: EndpointReport) -> None:
    screen = console()
    if report.trouble:
        screen.print(f"[red]{escape(report.trouble)}[/red]", soft_wrap=True)
        return
    if report.model_listed is False:
        known = escape(", ".join((report.models or ())[:10]))
        screen.print(
            f"[yellow]{escape(settings.model)} is not among the models that it lists: {known}[/yellow]"
        )
    table = Table(box=None, pad_edge=False, header_style="dim")
    for name in (
        "form of a reply",
        "taken",
        "usable",
        "states tokens",
        "finish reason",
        "seconds",
        "trouble",
    ):
        table.add_column(name)
    for one in report.modes:
        table.add_row(
            one.mode, _yes(one.accepted), _yes(one.usable), _yes(one.usage_stated), escape(one.finish_reason or "–"),
            "–" if one.latency_s is None else f"{one.latency_s:.1f}", escape(one.trouble or ""),
        )  # fmt: skip
    screen.print(table)
    works = f"works: replies will be asked for as {report.mode}" if report.works else "gives no usable reply"
    screen.print(f"{settings.model} at {settings.endpoint} {works}", markup=False)


def _yes(value: bool) -> str:
    return "yes" if value else "no"


@llm.command("dry-run")
def dry_run(
    file: CampaignFile,
    requests: Annotated[
        int, typer.Option(min=0, help="Differential requests to assume for the estimate.")
    ] = ASSUMED_REQUESTS,
    as_json: AsJson = False,
) -> None:
    """Print the prompts of a campaign, and estimate what its calls will take. Asks nobody.

    The later prompt shows made-up solutions where those stand that the search knows by then.

    Example: brink llm dry-run examples/traffic-llm.yaml
    """
    body = read_campaign_file(file)
    settings = _settings(body)
    plan = make_checked_plan(body)
    problem = plan.problem
    assert isinstance(problem, Describes)  # checked
    config: Any = plan.config
    initial = config.population_size if getattr(config, "initial", "") == "seeds" else 0
    request = SeedRequest(number=0, count=initial or config.seeds)
    messages = question(request, problem.road, problem.most, problem.system)
    known = (example(problem.road, problem.most),)
    later = SeedRequest(number=1, count=config.seeds, exposed=known, silent=known)
    asks_later = getattr(config, "differential", "never") != "never"
    differential = question(later, problem.road, problem.most, problem.system) if asks_later else ()
    requests = requests if asks_later else 0
    found = estimate(
        settings, road=problem.road, most=problem.most, system=problem.system, initial=initial,
        differential=config.seeds, differential_calls=requests,
    )  # fmt: skip
    if as_json:
        print_json(
            {
                "messages": [{"role": one.role, "content": one.content} for one in messages],
                "differential": [{"role": one.role, "content": one.content} for one in differential],
                "calls": found.calls, "most_calls": found.most_calls, "tokens": found.usage.total,
                "most_tokens": found.most_usage.total, "cost": found.cost, "most_cost": found.most_cost,
            }
        )  # fmt: skip
        return
    screen = console()
    for title, prompt in (("first", messages), ("differential", differential)):
        for one in prompt:
            screen.print(f"[bold]{title} request, {one.role}[/bold]")
            screen.print(one.content, markup=False, highlight=False, soft_wrap=True)
            screen.print()
    screen.print(f"with {requests} differential requests: {found.words}", soft_wrap=True)
    if asks_later:
        screen.print(
            f"seeds that do not differ enough go back up to {config.rounds} times, each a request of its own; "
            f"max_calls {settings.max_calls} bounds them all",
            soft_wrap=True,
        )


@llm.command()
def log(
    campaign: CampaignId,
    out: Annotated[
        Path | None, typer.Option(help="Folder for the raw replies, a file each.", file_okay=False)
    ] = None,
    database: Database = None,
    server: Server = None,
    as_json: AsJson = False,
) -> None:
    """Say what a campaign asked its language model, what came of it and what it took.

    Example: brink llm log 3f2a --out replies
    """

    async def work(api: Api) -> None:
        found = await api.get(f"/campaigns/{campaign}/llm-calls", {"replies": out is not None or as_json})
        if out is not None:
            out.mkdir(parents=True, exist_ok=True)
            for call in found["calls"]:
                path = out / f"reply-{call['request']}-{call['turn']}.json"
                path.write_text(call["reply"] or "", encoding="utf-8")
        if as_json:
            print_json(found)
        else:
            _print_calls(found)

    with_api(server, database, work)


def _print_calls(found: dict[str, Any]) -> None:
    table = Table(box=None, pad_edge=False, header_style="dim")
    for name in ("request", "turn", "outcome", "tokens", "cost", "seconds", "what was wrong"):
        table.add_column(name)
    for call in found["calls"]:
        tokens = None if call["prompt_tokens"] is None else call["prompt_tokens"] + call["completion_tokens"]
        table.add_row(
            str(call["request"]), str(call["turn"]), call["outcome"],
            "–" if tokens is None else f"{tokens}{' (estimate)' if call['estimated'] else ''}",
            _money(call["cost"]), f"{call['latency_s']:.1f}", escape(call["error"] or ""),
        )  # fmt: skip
    screen = console()
    screen.print(table)
    screen.print(
        f"{found['total_calls']} calls, {found['total_tokens']} tokens "
        f"({found['estimated_tokens']} of them estimated), cost {_money(found['cost'])}"
    )


def _money(cost: float | None) -> str:
    return "unknown" if cost is None else f"{cost:.4g}"


def _settings(body: CampaignBody) -> LlmSettings:
    """Return the language model of a campaign file.

    Raises:
        InvalidInput: It has none.
    """
    if body.llm is None:
        message = "expected a language model, such as {endpoint: http://127.0.0.1:8000/v1, model: ...}"
        raise InvalidInput([FieldError(pointer="/llm", message=message)])
    return body.llm
