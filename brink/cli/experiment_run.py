"""Running an experiment to its end on this machine, and its results as tables, figures and a report."""

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console

from brink.api.client import Api
from brink.api.live import ExperimentDisplay, Steps
from brink.api.runs import ExperimentRun
from brink.cli.experiment_findings import (
    PAIRS,
    THRESHOLDS,
    FoundKind,
    V,
    fetch_found,
    print_found,
    run_follow_ups,
)
from brink.cli.local import CommandSession, RunOptions, run_to_end
from brink.cli.options import console, file_name, plain_table, print_json
from brink.report.experiment import ReportedFound, html_report, markdown_report, sentences
from brink.report.experiment_found import Found, FoundWords
from brink.search.analysis.comparison import Repeat, duels, standings
from brink.search.analysis.count_comparison import FoundRepeat, by_problem
from brink.search.analysis.paper import LEVEL, Measure
from brink.search.analysis.scores import Control, Figures, Scores
from brink.server.api.experiments import Results
from brink.server.api.schemas import ControlView, ExperimentProgress, RepeatView
from brink.server.campaigns.body import DEFAULT_D_TH, DEFAULT_T_B
from brink.server.campaigns.plan import make_checked_plan
from brink.server.errors import InvalidInput
from brink.server.experiments.body import ExperimentBody, FollowUpChoice
from brink.server.experiments.checks import check_follow_ups
from brink.server.problems.catalogue import check_extra


@dataclass(frozen=True, slots=True, kw_only=True)
class FinishedExperiment:
    """An experiment that has finished.

    Attributes:
        results: Its results.
        folder: Folder of its report.
    """

    results: Results
    folder: Path


def run_experiment(
    body: ExperimentBody, options: RunOptions, *, alpha: float = LEVEL
) -> FinishedExperiment | None:
    """Run an experiment to its end on this machine and write its report.

    Args:
        body: The experiment.
        options: How to run it.
        alpha: Corrected p-value up to which a difference is significant, in (0, 1).

    Returns:
        The results; None if the experiment was stopped or ended unfinished, or its follow-ups did.

    Raises:
        InvalidInput: A campaign of the experiment cannot run.
        Conflict: An earlier run is unfinished, and neither ``resume`` nor ``new`` is set.
    """
    problems = []
    for cell in body.cells()[: len(body.problems) * len(body.algorithms)]:
        try:
            problems.append(make_checked_plan(cell.body).problem)
            check_extra(problems[-1])
        except InvalidInput as error:
            raise cell.in_experiment(error) from None
    check_follow_ups(body)
    for problem in problems:
        problem.install()
    screen = console(stderr=options.json)

    async def finish(session: CommandSession, progress: ExperimentProgress) -> FinishedExperiment | None:
        complete = await _follow_up(session, THRESHOLDS, body.thresholds, progress.id)
        complete &= session.stop.is_set() or await _follow_up(session, PAIRS, body.pairs, progress.id)
        if session.stop.is_set():
            screen.print("stopped; nothing is lost")
            session.hint("continue with", options.resume_command)
            return None
        results = await fetch_results(session.api, progress.id, screen, alpha=alpha)
        folder = options.out / f"{file_name(body.name)}-{progress.id}"
        with Steps(screen, "drawing the report"):
            files = await asyncio.to_thread(write_report, results, progress.elapsed_s, body, folder)
        if options.json:
            print_json({**results.model_dump(mode="json"), "files": [str(path) for path in files]})
        else:
            print_results(screen, results)
            screen.print(f"report: {folder / 'report.html'}", soft_wrap=True)
        return FinishedExperiment(results=results, folder=folder) if complete else None

    return run_to_end(ExperimentRun(body), options, screen, ExperimentDisplay(screen), finish)


async def _follow_up(
    session: CommandSession, kind: FoundKind[V], wanted: FollowUpChoice | None, experiment: str
) -> bool:
    """Follow up what an experiment found as its file asks; return whether nothing was refused or stopped."""
    if wanted is None or not (wanted.confirm or wanted.component):
        return True
    found = await fetch_found(session.api, kind, experiment, session.screen)
    return await run_follow_ups(session, kind, found, confirm=wanted.confirm, component=wanted.component)


async def fetch_results(api: Api, experiment: str, screen: Console, *, alpha: float = LEVEL) -> Results:
    """Return the results of an experiment, once all its finished campaigns are scored.

    Raises:
        CoordinatorError: The experiment does not exist.
    """
    with Steps(screen, "scoring") as steps:
        path = f"/experiments/{experiment}/results"
        return await api.read_computed(Results, path, {"alpha": alpha}, steps.show)


def repeats_of(results: Results) -> list[Repeat]:
    """Return the scores of the finished campaigns."""
    return [
        Repeat(
            problem=one.problem, method=one.method, seed=one.seed, campaign=one.campaign, scores=_scores(one)
        )
        for one in results.repeats
    ]


def _scores(one: RepeatView) -> Scores:
    return Scores(
        evaluated=one.evaluated,
        unsafe=one.unsafe,
        figures=_figures(one),
        control=None
        if one.control is None
        else Control(
            figures=_figures(one.control),
            unsafe_share=one.control.unsafe_share,
            spread=np.array(one.control.spread),
            repeats=one.control.behaviours_a_scenario,
        ),
    )


def _figures(view: RepeatView | ControlView) -> Figures:
    return Figures(dbs=np.array(view.dbs), strict=np.array(view.strict))


def print_results(screen: Console, results: Results) -> None:
    """Print the results of an experiment at the default thresholds."""
    repeats = repeats_of(results)
    if not repeats:
        screen.print("no campaign has finished yet")
        return
    for words, found in _found(results):
        print_found(screen, words, found)
    scored, compared = standings(repeats), duels(repeats, level=results.alpha)
    default = [one for one in scored if (one.t_b, one.d_th) == (DEFAULT_T_B, DEFAULT_D_TH)]
    for problem in dict.fromkeys(one.problem for one in repeats):
        columns = ("DBS", "95%", "strict DBS", "95%", "unsafe")
        title = f"{problem}: {results.scored} campaigns, t_b {DEFAULT_T_B:g}, d_th {DEFAULT_D_TH:g}"
        table = plain_table("", *columns, right=columns, title=title)
        for line in dict.fromkeys(one.line for one in default if one.line.problem == problem):
            cells = []
            for measure in Measure:
                value = next(one.value for one in default if one.line == line and one.measure is measure)
                interval = "" if value.low is None else f"{value.low:.1f} to {value.high:.1f}"
                cells += [f"{value.mean:.1f}", interval]
            share = "" if line.control else f"{_unsafe_share(repeats, line.problem, line.method):.0%}"
            table.add_row(line.label, *cells, share, style="dim" if line.control else None)
        screen.print(table, "")
        for sentence in sentences(repeats, scored, compared, problem):
            screen.print(sentence.replace("**", "").rstrip())
        screen.print()


def _unsafe_share(repeats: Sequence[Repeat], problem: str, method: str) -> float:
    """Return the unsafe share, averaged over the campaigns of a method on a problem."""
    scores = [one.scores for one in repeats if (one.problem, one.method) == (problem, method)]
    return float(np.mean([one.unsafe / max(1, one.evaluated) for one in scores]))


def write_report(results: Results, elapsed_s: float, body: ExperimentBody, folder: Path) -> list[Path]:
    """Write the report of an experiment as one HTML page, and as Markdown with separate figures and data.

    Args:
        results: Results with at least one campaign.
        elapsed_s: How long the experiment took.
        body: The experiment.
        folder: Folder of the report; created if missing.

    Returns:
        The files, the HTML page first.
    """
    # matplotlib takes half a second to load: only commands that draw wait for it.
    from brink.plots.experiment import EXPERIMENT_FIGURES
    from brink.plots.style import DPI

    repeats = repeats_of(results)
    (folder / "figures").mkdir(parents=True, exist_ok=True)
    problems = list(dict.fromkeys(one.problem for one in repeats))
    pictures: dict[tuple[str, Measure, str], str] = {}
    for number, problem in enumerate(problems, start=1):
        for measure in Measure:
            for kind, draw in EXPERIMENT_FIGURES.items():
                name = f"figures/{measure}-{kind}{f'-{number}' if len(problems) > 1 else ''}.png"
                draw(repeats, problem, measure).savefig(folder / name, dpi=DPI, metadata={"Software": None})
                pictures[problem, measure, kind] = name
    found = [
        ReportedFound(words=words, found=one, pictures=_draw(words.name, one.repeats, folder))
        for words, one in _found(results)
    ]
    text = markdown_report(
        body,
        repeats,
        pictures,
        experiment=results.id,
        created_at=results.created_at,
        elapsed_s=elapsed_s,
        found=found,
        level=results.alpha,
    )
    files = [folder / "report.html", folder / "report.md", folder / "results.json"]
    files[0].write_text(html_report(text, results.name, folder), encoding="utf-8")
    files[1].write_text(text, encoding="utf-8")
    files[2].write_text(results.model_dump_json(indent=1) + "\n", encoding="utf-8")
    drawn = [name for one in found for name in one.pictures.values()]
    drawn += pictures.values()
    return [*files, *(folder / name for name in drawn)]


def _found(results: Results) -> list[tuple[FoundWords, Found]]:
    """Return what the experiment asks for besides, and how it is reported."""
    both = ((THRESHOLDS.words, results.thresholds), (PAIRS.words, results.pairs))
    return [(words, found) for words, found in both if found is not None]


def _draw(stem: str, repeats: Sequence[FoundRepeat], folder: Path) -> dict[str, str]:
    """Draw a figure of each problem into the folder of a report; return the names of the files."""
    from brink.plots.experiment import figure_found
    from brink.plots.style import DPI

    pictures = {}
    problems = by_problem(repeats)
    for number, problem in enumerate(problems, start=1):
        name = f"figures/{stem}{f'-{number}' if len(problems) > 1 else ''}.png"
        figure_found(repeats, problem).savefig(folder / name, dpi=DPI, metadata={"Software": None})
        pictures[problem] = name
    return pictures
