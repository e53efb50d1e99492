"""`brink monitor fit | score | judge`: a safety monitor fitted to the results of campaigns."""

import json
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from brink import __version__
from brink.cli.options import (
    AsJson,
    Database,
    Server,
    check_ids,
    check_out,
    check_picture,
    console,
    plain_table,
    print_json,
)
from brink.search.analysis.choices import LEAST_OF_A_VERDICT, Model
from brink.search.errors import DocumentError, SpaceError
from brink.server.documents import read_yaml
from brink.server.errors import Conflict, InvalidInput
from brink.user_file import read_text

if TYPE_CHECKING:
    from brink.api.results import FetchedArchive
    from brink.search.analysis.monitor import Monitor
    from brink.search.analysis.monitor_evaluation import MonitorEvaluation
    from brink.search.space import FloatArray, SearchSpace

MISSED = (0.01, 0.05, 0.1)
"""Shares of missed hazards for which false alarm rates are shown."""

monitor = typer.Typer(
    name="monitor",
    help="Estimate the probability that a solution is unsafe, from the simulations of campaigns.",
    no_args_is_help=True,
    rich_markup_mode=None,
)
MonitorFile = Annotated[
    Path,
    typer.Argument(
        metavar="MONITOR", help="Monitor file written by `brink monitor fit`.", show_default=False
    ),
]
Campaigns = Annotated[
    list[str],
    typer.Argument(metavar="ID...", help="Ids of campaigns.", show_default=False, callback=check_ids),
]


@monitor.command()
def fit(
    campaigns: Campaigns,
    out: Annotated[Path, typer.Option(help="File to write.")] = Path("monitor.json"),
    threshold: Annotated[
        float | None,
        typer.Option(
            min=0.001,
            max=0.999,
            help="Threshold probability: unsafe if the whole interval lies above it, safe if none of it does, "
            "otherwise unknown (default: p_th).",
        ),
    ] = None,
    model: Annotated[
        Model | None,
        typer.Option(
            help="Trees are more accurate; fitting them needs the extra `analysis`. Default: trees where that extra "
            f"is installed and at least {LEAST_OF_A_VERDICT} solutions have each verdict.",
            show_default=False,
        ),
    ] = None,
    database: Database = None,
    server: Server = None,
    as_json: AsJson = False,
) -> None:
    """Fit a safety monitor to campaigns on the same problem.

    Example: brink monitor fit 3f2a --out monitor.json
    """
    from brink.cli.fitted import fetch_archives
    from brink.search.analysis.monitor import Monitor, default_model

    check_out(out, make_folder=True)
    fetched = fetch_archives(campaigns, server=server, database=database)
    vectors, unsafe = _evaluated(fetched)
    if len(vectors) < 2:
        raise Conflict(f"a monitor needs at least two evaluated solutions, got {len(vectors)}")
    plan = fetched[0].plan
    level = threshold if threshold is not None else plan.neighbourhood.p_th
    try:
        fitted = Monitor.fitted(
            plan.problem.space,
            vectors,
            unsafe,
            threshold=level,
            z=plan.neighbourhood.z,
            seed=fetched[0].body.seed,
            model=default_model(unsafe) if model is None else model,
        )
    except ValueError as error:
        raise Conflict(str(error)) from None
    weights = fitted.informative_weights
    about = {
        "campaigns": [one.id for one in fetched],
        "problem": fetched[0].body.problem.model_dump(mode="json"),
        "brink": __version__,
    }
    out.write_text(fitted.to_json(about) + "\n", encoding="utf-8")
    if as_json:
        print_json(
            {
                "file": str(out),
                "solutions": len(fitted),
                "threshold": level,
                "model": str(fitted.model),
                "weights": weights,
            }
        )
        return
    screen = console()
    screen.print(
        f"{out}: {fitted.model}, fitted to {len(fitted):,} solutions, {fitted.unsafe_share:.0%} unsafe; "
        f"unsafe above {level:g}",
        soft_wrap=True,
    )
    if fitted.model is Model.NEIGHBOURS:
        parameters = ", ".join(f"{name} {weight:g}" for name, weight in weights.items()) or "none"
        screen.print(f"parameters by weight: {parameters}", soft_wrap=True)


@monitor.command()
def score(
    file: MonitorFile,
    solutions: Annotated[
        Path,
        typer.Argument(
            metavar="FILE",
            show_default=False,
            help="One solution or a list of solutions (JSON or YAML): {component: {parameter: value}}.",
        ),
    ],
    as_json: AsJson = False,
) -> None:
    """Estimate how likely solutions are to be unsafe. Needs no server.

    Example: brink monitor score monitor.json solutions.json
    """
    fitted = _read(file)
    document = read_yaml(solutions)
    given = document if isinstance(document, list) else [document]
    risks = []
    for place, values in enumerate(given):
        if not isinstance(values, dict):
            raise InvalidInput.at(f"/{place}", f"expected parameters by component, got {values!r}"[:200])
        try:
            risks.append(fitted.ask(values.get("parameters", values)))
        except (SpaceError, AttributeError) as error:
            raise InvalidInput.at(f"/{place}", str(error)) from None
    if as_json:
        print_json([asdict(risk) for risk in risks])
        return
    columns = ("", "unsafe", "interval", "neighbours", "nearest")
    rows = [
        (
            str(place),
            f"{risk.probability:.2f}",
            f"{risk.low:.2f} to {risk.high:.2f}",
            "" if risk.neighbours is None else f"{risk.neighbours:.1f}",
            f"{risk.nearest:.3f}",
            str(risk.answer),
        )
        for place, risk in enumerate(risks)
    ]
    screen = console()
    screen.print(plain_table(*columns, "answer", right=columns, rows=rows))
    for place, risk in enumerate(risks):
        if risk.unlike:
            screen.print(
                f"{place} is unlike anything simulated: {risk.unlike}", soft_wrap=True, style="yellow"
            )


@monitor.command()
def judge(
    file: MonitorFile,
    campaigns: Campaigns,
    picture: Annotated[
        Path | None, typer.Option("--picture", help="PNG or SVG file for a plot of calibration and alarms.")
    ] = None,
    pairs: Annotated[
        Path | None,
        typer.Option(
            "--pairs",
            help="JSON Lines file of pairs across the boundary, on which the monitor is evaluated too: "
            '{"safe": {"parameters": {...}}, "unsafe": {"parameters": {...}}}.',
        ),
    ] = None,
    database: Database = None,
    server: Server = None,
    as_json: AsJson = False,
) -> None:
    """Evaluate a monitor on campaigns that it was not fitted to, ideally a random search with a different seed.

    Example: brink monitor judge monitor.json 91bc --picture monitor.png
    """
    from brink.cli.fitted import fetch_archives
    from brink.search.analysis.monitor_evaluation import evaluate_monitor, evaluate_pairs

    check_picture(picture)
    fitted = _read(file)
    sides = None if pairs is None else _pairs(pairs, fitted.space.unlimited())
    fetched = fetch_archives(campaigns, server=server, database=database)
    _check_fresh(file, fetched)
    vectors, unsafe = _evaluated(fetched)
    if fetched[0].plan.problem.space.column_names() != fitted.space.column_names():
        raise Conflict(f"the search space of {file} differs from that of campaign {fetched[0].id}")
    try:
        evaluation = evaluate_monitor(fitted, vectors, unsafe)
    except ValueError as error:
        raise Conflict(str(error)) from None
    if sides is not None:
        evaluation = replace(evaluation, pairs=evaluate_pairs(fitted, *sides))
    if picture is not None:
        # matplotlib takes half a second to load: only commands that draw wait for it.
        from brink.plots.evidence import figure_monitor

        figure_monitor(evaluation).savefig(picture)
    if as_json:
        print_json(evaluation.to_json())
        return
    _print(evaluation)
    if picture is not None:
        console().print(f"picture: {picture}", soft_wrap=True)


def _read(file: Path) -> "Monitor":
    from brink.search.analysis.monitor import Monitor

    try:
        return Monitor.load(file)
    except DocumentError as error:
        raise InvalidInput.at("", f"{file}: {error}") from None


def _check_fresh(file: Path, campaigns: "Sequence[FetchedArchive]") -> None:
    """Check that a monitor was not fitted to the campaigns that evaluate it; warn if it was fitted to some.

    Raises:
        Conflict: It was fitted to all of them.
    """
    from brink.cli.fitted import fitted_among, fitted_words
    from brink.search.analysis.monitor import LARGEST_BYTES

    own = fitted_among(json.loads(read_text(file, LARGEST_BYTES)).get("about"), campaigns)
    if not own:
        return
    words = fitted_words(file, own)
    if len(own) == len(campaigns):
        raise Conflict(
            f"{words}: its performance on its own training data is meaningless; evaluate it on another campaign on "
            "the same problem, ideally a random search (random@1) with another seed"
        )
    console(stderr=True).print(
        f"{words}: its training data is left out, but the rest of that search is similar",
        soft_wrap=True,
        style="yellow",
    )


def _pairs(file: Path, space: "SearchSpace") -> "tuple[FloatArray, FloatArray]":
    """Return the safe and the unsafe sides of the pairs in a JSON Lines file, each of shape ``(n, d)``."""
    import numpy as np

    from brink.search.analysis.monitor import LARGEST_BYTES
    from brink.search.space import FloatArray

    sides: dict[str, list[FloatArray]] = {"safe": [], "unsafe": []}
    try:
        lines = read_text(file, LARGEST_BYTES).splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InvalidInput.at("", f"{file}: expected JSON Lines: {error}") from None
    for number, line in enumerate(lines, start=1):
        if not line.strip():
            continue
        try:
            document = json.loads(line)
            for side, rows in sides.items():
                rows.append(space.join(space.encode(document[side]["parameters"])))
        except (SpaceError, AttributeError) as error:
            raise InvalidInput.at("", f"{file}, line {number}: {error}") from None
        except (ValueError, KeyError, TypeError):
            raise InvalidInput.at(
                "",
                f'{file}, line {number}: expected {{"safe": {{"parameters": {{...}}}}, '
                f'"unsafe": {{"parameters": {{...}}}}}}, got {line[:100]}',
            ) from None
    if not sides["safe"]:
        raise InvalidInput.at("", f"{file}: expected at least one pair, got none")
    return np.array(sides["safe"]), np.array(sides["unsafe"])


def _evaluated(fetched: "Sequence[FetchedArchive]") -> tuple[Any, Any]:
    import numpy as np

    from brink.search.archive import Archive

    archives: list[Archive] = [one.archive for one in fetched]
    return (
        np.concatenate([archive.vectors for archive in archives]),
        np.concatenate([archive.unsafe for archive in archives]),
    )


def _print(evaluation: "MonitorEvaluation") -> None:
    from brink.search.analysis.monitor import Answer
    from brink.search.analysis.monitor_evaluation import fewest_false_alarms

    screen = console()
    screen.print(f"fitted to {evaluation.learned:,} simulations, evaluated on {evaluation.fresh:,} others")
    columns = (
        "AUROC",
        "Brier",
        "calibration error",
        *(f"false alarms at {missed:.0%} missed" for missed in MISSED),
    )
    rows = [
        (
            one.name,
            f"{one.metrics.auroc:.3f}",
            f"{one.metrics.brier:.3f}",
            f"{one.metrics.calibration_error:.3f}",
            *(f"{fewest_false_alarms(one.operating_points, missed).false:.0%}" for missed in MISSED),
        )
        for one in evaluation.predictors
    ]
    screen.print(plain_table("", *columns, right=columns, rows=rows), "")
    columns = ("solutions", "predicted", "interval", "unsafe share", "within")
    rows = [
        (
            f"{bin_.solutions:,}",
            f"{bin_.predicted:.2f}",
            f"{bin_.low:.2f} to {bin_.high:.2f}",
            f"{bin_.observed:.2f}",
            "yes" if bin_.within else "no",
        )
        for bin_ in evaluation.predictors[0].metrics.bins
    ]
    screen.print(plain_table(*columns, right=columns, title="calibration of the monitor", rows=rows), "")
    for verdicts in evaluation.answers:
        share = f", {verdicts.unsafe / verdicts.solutions:.0%} of them unsafe" if verdicts.solutions else ""
        unknown = verdicts.answer is Answer.UNKNOWN
        reason = (
            ": their intervals contain the threshold, or they are unlike anything simulated"
            if unknown
            else ""
        )
        screen.print(f"  {verdicts.answer}: {verdicts.solutions:,}{share}{reason}")
    screen.print(f"  unlike anything simulated: {evaluation.unlike:,} of {evaluation.fresh:,}")
    if (pairs := evaluation.pairs) is not None:
        screen.print(
            f"pairs across the boundary: {pairs.pairs:,}; both sides right {pairs.both_right:,} "
            f"({pairs.both_right / pairs.pairs:.0%}), unsafe side given the higher probability {pairs.ranked:,} "
            f"({pairs.ranked / pairs.pairs:.0%}), mean difference {pairs.difference:+.3f}",
            soft_wrap=True,
        )
    for name, reason in evaluation.left_out.items():
        screen.print(f"left out: {name}, {reason}", soft_wrap=True, style="yellow")
