"""Combinations of techniques: tables for people, files, and what they did side by side."""

import asyncio
import csv
import io
import json
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from brink.api.client import Api, CoordinatorSaid
from brink.cli.draw import FetchedArchive, NoTrace, fetch_trace
from brink.cli.findings.drawing import Drawing
from brink.cli.options import AsJson, CampaignId, Database, Server, console, print_json, with_api
from brink.search.errors import UnsupportedSpace
from brink.search.slots import slots_of
from brink.sim.replay.sheets import Row, side_by_side

SHOWN = 10
PICTURES = 3


class CombinationFindings:
    """What a campaign found about combinations.

    Args:
        found: As the coordinator tells it.
    """

    name = "combinations"

    def __init__(self, found: dict[str, Any]) -> None:
        self._found = found

    def sentence(self) -> str:
        """Return it in a sentence."""
        return in_words(self._found)

    def show(self, screen: Console) -> None:
        """Print it for people."""
        print_combinations(screen, self._found)

    def write(self, folder: Path) -> list[Path]:
        """Write it to files."""
        return write_combinations(self._found, folder)

    async def draw(self, drawing: Drawing) -> list[Path]:
        """Draw it, as far as traces can be had."""
        return await draw_combinations(self._found, drawing)

    def hints(self, campaign: str, database: str) -> list[tuple[str, str]]:
        """Return commands to go on with, and what each is for."""
        chains = self._found["combinations"]
        telling = [number for one in chains for number in (*one["together"], *one["turned"])]
        hints = [(f"combinations {campaign}{database}", "all chains of techniques")]
        if telling:
            hints.append((f"replay {campaign} {telling[0]} --out hazard.mp4{database}", "watch the hazard"))
        return hints


async def fetch_combinations(api: Api, fetched: FetchedArchive) -> CombinationFindings | None:
    """Return what a campaign found about combinations; None if its space has no ordered techniques."""
    try:
        slots_of(fetched.plan.problem.space)
    except UnsupportedSpace:
        return None
    return CombinationFindings(await api.get(f"/campaigns/{fetched.id}/combinations"))


def combinations(
    campaign: CampaignId,
    shown: Annotated[int, typer.Option(min=1, help="Rows of each table.")] = SHOWN,
    database: Database = None,
    server: Server = None,
    as_json: AsJson = False,
) -> None:
    """Say which techniques are hazardous, alone, only together, or only in one order.

    Example: brink combinations 3f2a
    """

    async def work(api: Api) -> None:
        found = await api.get(f"/campaigns/{campaign}/combinations")
        if as_json:
            print_json(found)
        else:
            print_combinations(console(), found, shown)

    with_api(server, database, work)


def print_combinations(screen: Console, found: dict[str, Any], shown: int = SHOWN) -> None:
    """Print both tables, and in a sentence what they amount to."""
    chains = found["combinations"]
    table = _table("chain", "unsafe", "its parts alone", "other order", "")
    for one in chains[:shown]:
        table.add_row(
            one["words"],
            _share(one),
            _shares(one["parts"]) or "not simulated",
            _shares(one["orders"]) or "",
            _claim(one),
        )
    if chains:
        screen.print(table)
        if len(chains) > shown:
            screen.print(f"[dim]… and {len(chains) - shown} more in combinations.json[/dim]")
    steps = sorted(found["steps"], key=lambda s: (-_rate(s, "alone"), -_rate(s, "joined")))
    steps = [step for step in steps if step["alone_unsafe"] or step["joined_unsafe"]]
    if steps:
        table = _table("technique at a level", "alone", "with others")
        for step in steps[:shown]:
            table.add_row(step["words"], _of(step, "alone"), _of(step, "joined"))
        screen.print(table)
    screen.print(in_words(found))


def in_words(found: dict[str, Any]) -> str:
    """Return what a campaign found about combinations in a sentence."""
    chains = found["combinations"]
    hazardous, together, turned = (
        sum(bool(one[name]) for one in chains) for name in ("hazardous", "only_together", "order_matters")
    )
    places = sum(len(one["together"]) for one in chains)
    return (
        f"{hazardous} of {len(chains)} chains are hazardous: {together} only together (each part alone is safe), "
        f"{turned} only in one order; {places} simulations were unsafe where every part alone was safe"
    )


def write_combinations(found: dict[str, Any], folder: Path) -> list[Path]:
    """Write everything as JSON, and the hazards by technique and level as CSV."""
    document, table = folder / "combinations.json", folder / "hazards.csv"
    document.write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(
        ["technique", "level", "levels", "alone_unsafe", "alone_trials", "joined_unsafe", "joined_trials"]
    )
    for step in found["steps"]:
        named = step["step"]
        tallies = [step[name] for name in ("alone_unsafe", "alone_trials", "joined_unsafe", "joined_trials")]
        writer.writerow([named["technique"], named["level"], named["levels"], *tallies])
    table.write_text(text.getvalue(), encoding="utf-8")
    return [document, table]


async def draw_combinations(found: dict[str, Any], drawing: Drawing) -> list[Path]:
    """Draw the most telling combinations beside their parts and other orders, as far as they can be had."""
    api, campaign_id = drawing.api, drawing.campaign
    files: list[Path] = []
    for one in found["combinations"]:
        telling = one["together"] or one["turned"]
        if drawing.stop.is_set() or len(files) == PICTURES:
            break
        if not telling:
            continue
        variants = await api.get(f"/campaigns/{campaign_id}/solutions/{telling[0]}/variants")
        rows = []
        try:
            for variant in variants:
                trace = await fetch_trace(api, campaign_id, variant["number"], drawing.patience_s)
                rows.append(Row(words=variant["words"], trace=trace))
        except (NoTrace, CoordinatorSaid):
            continue
        if any(row.trace.film is None for row in rows):
            continue
        title = f"The same street and the same chance: solution {telling[0]} and what it consists of"
        picture = await asyncio.to_thread(side_by_side, rows, title=title)
        path = drawing.folder / f"combination-{len(files) + 1}.png"
        await asyncio.to_thread(picture.save, path)
        files.append(path)
    return files


def _claim(one: dict[str, Any]) -> str:
    claims = [
        ("only_together", "only together"),
        ("order_matters", "only in this order"),
        ("minimal", "minimal"),
    ]
    said = [words for name, words in claims if one[name]]
    if "only together" in said:
        said = [words for words in said if words != "minimal"]
    return ", ".join(said)


def _share(tally: dict[str, Any]) -> str:
    return f"{tally['unsafe']} of {tally['trials']}"


def _shares(tallies: list[dict[str, Any]]) -> str:
    return ", ".join(_share(tally) for tally in tallies)


def _of(step: dict[str, Any], kind: str) -> str:
    return f"{step[f'{kind}_unsafe']} of {step[f'{kind}_trials']}" if step[f"{kind}_trials"] else "–"


def _rate(step: dict[str, Any], kind: str) -> float:
    return step[f"{kind}_unsafe"] / step[f"{kind}_trials"] if step[f"{kind}_trials"] else 0.0


def _table(*columns: str) -> Table:
    table = Table(box=None, pad_edge=False, header_style="dim")
    for name in columns:
        table.add_column(name)
    return table
