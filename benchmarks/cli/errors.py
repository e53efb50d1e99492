"""`python -m benchmarks errors`: whether drives with fitted errors violate as often as drives with the detector."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from benchmarks.cli.output import Processes, conclude, show_progress, value_table
from brink.api.results import fetch_archive
from brink.cli.options import RESULTS, AsJson, Database, Server, check_ids, with_api
from brink.report.errors import COLUMNS, agreement_words, error_rows, violations_of
from brink.sim.perception.user_files import DEFAULT_DETECTOR


def errors(
    recorded: Annotated[
        int, typer.Option(min=5, help="Drives with the camera to which errors are fitted.")
    ] = 400,
    drives: Annotated[int, typer.Option(min=10, help="Drives with the fitted errors.")] = 2000,
    camera: Annotated[
        int, typer.Option(min=0, help="Other drives with the camera, without --campaign.")
    ] = 2000,
    campaign: Annotated[
        str | None,
        typer.Option(
            metavar="ID",
            show_default=False,
            callback=check_ids,
            help="Take these from a finished campaign of random drives on urban-camera@1.",
        ),
    ] = None,
    detector: Annotated[str, typer.Option(help="Id of the detector.")] = DEFAULT_DETECTOR,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the drives to compare.")] = 6,
    processes: Processes = 2,
    out: Annotated[Path, typer.Option(help="Folder for recorded drives, which are kept.")] = RESULTS
    / "bench-errors",
    database: Database = None,
    server: Server = None,
    as_json: AsJson = False,
) -> None:
    """Compare how often drives violate with errors that were fitted to a detector, and with the detector itself.

    Example: python -m benchmarks errors --recorded 150 --drives 2000 --campaign 3f2a
    """
    from benchmarks.errors import ErrorsBench

    with show_progress() as progress:
        found = ErrorsBench(
            folder=out,
            recorded=recorded,
            drives=drives,
            camera=0 if campaign else camera,
            detector=detector,
            seed=seed,
            processes=processes,
            progress=progress,
        ).measure()
    violations = list(found.violations)
    if campaign is not None:
        violations.insert(
            1, violations_of(with_api(server, database, lambda api: fetch_archive(api, campaign)))
        )
    words = [agreement_words(violations[0], other) for other in violations[1:]]
    shares = value_table(
        ("drives with", "drives", "violate", "share [95%]"),
        ((one.name, f"{one.drives:,}", f"{one.unsafe:,}", one.words) for one in violations),
    )
    document = {"violations": [asdict(one) | {"share": one.share} for one in violations], "words": words}
    conclude(document, value_table(COLUMNS, error_rows(found.fitted)), shares, *words, as_json=as_json)
