"""What an experiment found: fetched, printed, and written as a report."""

import asyncio
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from brink.api.client import Api
from brink.report.experiment import html_report, markdown_report, sentences
from brink.search.analysis.experiment_tables import Measure, Repeat, duels, standings
from brink.search.analysis.scores import Control, Figures, Scores
from brink.server.api.experiment_schemas import ControlView, RepeatView, Results
from brink.server.campaigns.body import DEFAULT_D_TH, DEFAULT_T_B
from brink.server.experiments.body import ExperimentBody

LOOK_EVERY_S = 1.0


async def fetch_results(api: Api, experiment: str, screen: Console) -> Results:
    """Return the results of an experiment, waiting until its finished campaigns are scored.

    Raises:
        CoordinatorSaid: There is no such experiment.
    """
    with screen.status("scoring") as status:
        while True:
            response = await api.request("GET", f"/experiments/{experiment}/results", params={"wait_s": 5})
            if response.status_code == 200:
                return Results.model_validate_json(response.content)
            status.update(str(response.json()["detail"]))
            await asyncio.sleep(LOOK_EVERY_S)


def repeats_of(results: Results) -> list[Repeat]:
    """Return what finished campaigns reached."""
    return [
        Repeat(
            problem=one.problem, method=one.method, seed=one.seed, campaign=one.campaign, scores=_scores(one)
        )
        for one in results.repeats
    ]


def _scores(one: RepeatView) -> Scores:
    return Scores(
        evaluated=one.evaluated, unsafe=one.unsafe, figures=_figures(one),
        control=None if one.control is None else Control(
            figures=_figures(one.control), unsafe_share=one.control.unsafe_share,
            spread=np.array(one.control.spread), repeats=one.control.behaviours_a_scenario,
        ),
    )  # fmt: skip


def _figures(view: RepeatView | ControlView) -> Figures:
    return Figures(dbs=np.array(view.dbs), strict=np.array(view.strict))


def print_results(screen: Console, results: Results) -> None:
    """Print what an experiment says at the usual thresholds."""
    repeats = repeats_of(results)
    if not repeats:
        screen.print("no campaign of it has finished yet")
        return
    found, compared = standings(repeats), duels(repeats)
    usual = [one for one in found if (one.t_b, one.d_th) == (DEFAULT_T_B, DEFAULT_D_TH)]
    shares = {
        (one.problem, one.method): np.mean([
            other.scores.unsafe / max(1, other.scores.evaluated)
            for other in repeats
            if (other.problem, other.method) == (one.problem, one.method)
        ])
        for one in repeats
    }  # fmt: skip
    for problem in dict.fromkeys(one.problem for one in repeats):
        table = Table(
            title=f"{problem}: {results.scored} campaigns, t_b {DEFAULT_T_B:g}, d_th {DEFAULT_D_TH:g}",
            title_justify="left", box=None, pad_edge=False,
        )  # fmt: skip
        for name in ("", "DBS", "95%", "strict DBS", "95%", "unsafe"):
            table.add_column(name, justify="right" if name else "left", header_style="dim")
        for line in dict.fromkeys(one.line for one in usual if one.line.problem == problem):
            cells = []
            for measure in Measure:
                value = next(o.value for o in usual if o.line == line and o.measure is measure)
                cells += [
                    f"{value.mean:.1f}",
                    "" if value.low is None else f"{value.low:.1f} to {value.high:.1f}",
                ]
            share = "" if line.control else f"{shares[line.problem, line.method]:.0%}"
            table.add_row(line.label, *cells, share, style="dim" if line.control else None)
        screen.print(table, "")
        for sentence in sentences(repeats, found, compared, problem):
            screen.print(sentence.replace("**", "").rstrip(), markup=False, highlight=False)
        screen.print()


def write_report(
    results: Results, progress: dict[str, Any], body: ExperimentBody, folder: Path
) -> list[Path]:
    """Write the report of an experiment: pictures, Markdown beside them, one HTML page with all of it inside.

    Args:
        results: With one campaign at least.
        progress: Of ``GET /experiments/{id}/progress``.
        body: What was asked for.
        folder: Where to; made if it is not there.

    Returns:
        The files, the page first.
    """
    # matplotlib takes half a second to load: only those who draw wait for it.
    from brink.plots.experiment import EXPERIMENT_FIGURES
    from brink.plots.style import DPI

    repeats = repeats_of(results)
    (folder / "figures").mkdir(parents=True, exist_ok=True)
    problems = list(dict.fromkeys(one.problem for one in repeats))
    pictures: dict[tuple[str, Measure, str], str] = {}
    for place, problem in enumerate(problems):
        for measure in Measure:
            for kind, draw in EXPERIMENT_FIGURES.items():
                name = f"figures/{measure}-{kind}{f'-{place + 1}' if len(problems) > 1 else ''}.png"
                draw(repeats, problem, measure).savefig(folder / name, dpi=DPI, metadata={"Software": None})
                pictures[problem, measure, kind] = name
    text = markdown_report(
        body, repeats, pictures, experiment=results.id, created_at=results.created_at,
        elapsed_s=progress["elapsed_s"],
    )  # fmt: skip
    files = [folder / "report.html", folder / "report.md", folder / "results.json"]
    files[0].write_text(html_report(text, results.name, folder), encoding="utf-8")
    files[1].write_text(text, encoding="utf-8")
    files[2].write_text(results.model_dump_json(indent=1) + "\n", encoding="utf-8")
    return [*files, *(folder / name for name in pictures.values())]
