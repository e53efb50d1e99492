"""`python -m benchmarks coverage` and `rate`: how often intervals and tests are right when the truth is known."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from benchmarks.cli.output import conclude, met_text, show_progress, value_table
from brink.cli.options import AsJson


def coverage(
    only: Annotated[
        list[str] | None,
        typer.Option(help="Run only the studies whose names begin with this; may be given several times."),
    ] = None,
    repetitions: Annotated[int, typer.Option(min=1, help="Repetitions of each study.")] = 1_000,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the synthetic data.")] = 1,
    as_json: AsJson = False,
) -> None:
    """Measure how often intervals cover a known truth, and how often tests err, on synthetic data.

    A study misses its target if the nominal rate is outside the 99% interval of the found one, on the wrong side: an
    interval may cover more often than it promises, and a test may err less often.

    Example: python -m benchmarks coverage

    Example: python -m benchmarks coverage --only tolerance --repetitions 200
    """
    from benchmarks.coverage import measure, studies

    known = studies()
    chosen = [study for study in known if study.name.startswith(tuple(only or [""]))]
    if not chosen:
        names = ", ".join(dict.fromkeys(study.name.partition(":")[0] for study in known))
        raise typer.BadParameter(
            f"expected the beginning of a study's name ({names}), got {', '.join(only or [])}"
        )
    with show_progress() as progress:
        found = list(measure(chosen, repetitions, seed, progress))
    table = value_table(
        ("study", "nominal", "found", "99% interval", ""),
        (
            (
                one.name,
                f"{one.claim} {one.nominal:.1%}".strip() if one.claim else "",
                f"{one.found:.1%}",
                "{:.1%} to {:.1%}".format(*one.interval),
                met_text(one.met),
            )
            for one in found
        ),
    )
    document = [
        {
            "study": one.name,
            "claim": str(one.claim),
            "nominal": one.nominal,
            "found": one.found,
            "hits": one.hits,
            "repetitions": one.repetitions,
            "interval": list(one.interval),
            "met": one.met,
        }
        for one in found
    ]
    conclude(document, table, as_json=as_json, missed=any(one.met is False for one in found))


def rate(
    repetitions: Annotated[int, typer.Option(min=2, help="Searches on each function.")] = 400,
    simulations: Annotated[
        int, typer.Option(min=100, help="Simulations of a search where the rate is 0.1.")
    ] = 1_000,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the first search.")] = 1,
    rate: Annotated[
        list[float] | None, typer.Option(help="Rate of the functions, 0.1, 0.01 or 0.001; by default all.")
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder for finished searches.")] = Path("rate"),
    as_json: AsJson = False,
) -> None:
    """Measure whether the intervals of rate@1 hold on functions of known rates, and what they save.

    Beside plain Monte Carlo with as many simulations: a width below 1 is a narrower interval, a variance above 1 a
    smaller one. Finished searches are kept in the folder, so the same command continues after an interruption.

    Example: python -m benchmarks rate --repetitions 40

    Example: python -m benchmarks rate --repetitions 40 --rate 0.1
    """
    from benchmarks.rate import RATES, measure

    if unknown := set(rate or ()) - set(RATES):
        known = ", ".join(f"{one:g}" for one in RATES)
        raise typer.BadParameter(f"--rate: expected some of {known}, got {min(unknown):g}")
    with show_progress() as progress:
        found = list(measure(repetitions, simulations, seed, progress, out, rate or RATES))
    table = value_table(
        ("function", "rate", "at every look", "fixed number", "bias", "variance", "width", "fixed width", ""),
        (
            (
                one.shape,
                f"{one.rate:g}",
                f"{one.sequence:.1%}",
                f"{one.fixed:.1%}",
                f"{one.bias:+.1f} se",
                f"{one.variance:.2f}",
                f"{one.width:.2f}",
                f"{one.fixed_width:.2f}",
                met_text(one.met),
            )
            for one in found
        ),
    )
    document = [{**asdict(one), "met": one.met} for one in found]
    conclude(document, table, as_json=as_json, missed=any(not one.met for one in found))
