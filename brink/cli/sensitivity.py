"""`brink sensitivity rescore | rerun`: how much a boundary depends on the settings of its search."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
import yaml
from rich.table import Table

from brink.cli.local import RunOptions
from brink.cli.options import (
    RESULTS,
    AsJson,
    CampaignFile,
    CampaignId,
    Database,
    DistanceThreshold,
    FitnessThreshold,
    New,
    Resume,
    Server,
    Workers,
    check_picture,
    console,
    file_name,
    plain_table,
    print_json,
    with_api,
    write_json,
)
from brink.search.analysis.choices import P_THS, RADII
from brink.search.analysis.paper import D_THS, PAPER_T_BS, Measure
from brink.server.campaigns.body import DEFAULT_D_TH, DEFAULT_T_B, CampaignBody, read_campaign_file
from brink.server.errors import Conflict, InvalidInput
from brink.server.experiments.body import ExperimentBody, parse_experiment

if TYPE_CHECKING:
    from brink.search.analysis.boundary import Rescored

_USUAL_RADII = ",".join(map(str, RADII))
_USUAL_P_THS = ",".join(map(str, P_THS))

sensitivity = typer.Typer(
    name="sensitivity",
    help="Measure how much a boundary depends on the settings of its search and its scores.",
    no_args_is_help=True,
    rich_markup_mode=None,
)


@sensitivity.command()
def rescore(
    campaign: CampaignId,
    t_b: FitnessThreshold = DEFAULT_T_B,
    d_th: DistanceThreshold = DEFAULT_D_TH,
    radii: Annotated[
        str, typer.Option("--radius", help="Neighbourhood radii, separated by commas.")
    ] = _USUAL_RADII,
    p_ths: Annotated[
        str, typer.Option("--p-th", help="Threshold probabilities, separated by commas.")
    ] = _USUAL_P_THS,
    picture: Annotated[Path | None, typer.Option("--picture", help="PNG or SVG file for a plot.")] = None,
    database: Database = None,
    server: Server = None,
    as_json: AsJson = False,
) -> None:
    """Score a campaign again with other neighbourhood radii (delta) and threshold probabilities (p_th).

    No simulations are run.

    Example: brink sensitivity rescore 3f2a --picture sensitivity.png
    """
    from brink.api.results import fetch_archive
    from brink.search.analysis.boundary import by_p_th, by_radius

    check_picture(picture)
    wanted_radii = _numbers("--radius", radii, low=0.0, high=1.0, closed=True)
    wanted_p_ths = _numbers("--p-th", p_ths, low=0.0, high=1.0, closed=False)
    fetched = with_api(server, database, lambda api: fetch_archive(api, campaign))
    if not len(fetched.archive):
        raise Conflict(f"campaign {fetched.id} has no evaluated solutions yet")
    near = fetched.archive.neighbourhood
    found_radii = by_radius(fetched.archive, sorted({*wanted_radii, near.radius}), t_b=t_b, d_th=d_th)
    found_p_ths = by_p_th(fetched.archive, sorted({*wanted_p_ths, near.p_th}), t_b=t_b, d_th=d_th)
    if picture is not None:
        # matplotlib takes half a second to load: only commands that draw wait for it.
        from brink.plots.evidence import figure_rescored

        drawn = figure_rescored(
            found_radii,
            found_p_ths,
            own=(near.radius, near.p_th),
            t_b=t_b,
            d_th=d_th,
            title=f"How much the boundary depends on its settings: {fetched.body.name}",
        )
        drawn.savefig(picture)
    if as_json:
        print_json(
            {
                "campaign": fetched.id,
                "t_b": t_b,
                "d_th": d_th,
                "radius": near.radius,
                "p_th": near.p_th,
                "by_radius": [asdict(one) for one in found_radii],
                "by_p_th": [asdict(one) for one in found_p_ths],
            }
        )
        return
    console().print(_table("radius", found_radii, near.radius), "")
    console().print(_table("p_th", found_p_ths, near.p_th))
    if picture is not None:
        console().print(f"picture: {picture}", soft_wrap=True)


@sensitivity.command()
def rerun(
    file: CampaignFile,
    parameter: Annotated[
        str, typer.Option(help="Algorithm parameter to vary, such as population_size or archive_size.")
    ],
    values: Annotated[str, typer.Option(help="Values of the parameter, separated by commas.")],
    seeds: Annotated[int, typer.Option(min=2, max=100, help="Number of searches with each value.")] = 5,
    t_b: Annotated[
        float,
        typer.Option("--t-b", help="Maximum fitness of a boundary solution; one of the paper's values."),
    ] = DEFAULT_T_B,
    d_th: Annotated[
        float,
        typer.Option(
            "--d-th", help="Minimum distance between distinct solutions: 0.1, 0.2, 0.3, 0.4 or 0.5."
        ),
    ] = DEFAULT_D_TH,
    workers: Workers = 2,
    database: Database = None,
    resume: Resume = False,
    new: New = False,
    out: Annotated[
        Path, typer.Option(help="Folder for the experiment file, the report and the plot.")
    ] = RESULTS,
    as_json: AsJson = False,
) -> None:
    """Search again with several values of a parameter and several seeds, as an experiment, and compare the results.

    Example: brink sensitivity rerun examples/quickstart.yaml --parameter population_size --values 5,10,20 --seeds 5
    """
    from brink.cli.experiment_run import repeats_of, run_experiment
    from brink.search.analysis.comparison import lines_of, values_of

    for name, value, known in (("--t-b", t_b, PAPER_T_BS), ("--d-th", d_th, D_THS)):
        if value not in known:
            raise InvalidInput.at(name, f"expected one of {', '.join(map(str, known))}, got {value:g}")
    body = varied(read_campaign_file(file), parameter, _values(values), seeds)
    out.mkdir(parents=True, exist_ok=True)
    experiment = out / f"{file_name(body.name)}.yaml"
    document = body.model_dump(mode="json", exclude_defaults=True)
    experiment.write_text(yaml.safe_dump(document, sort_keys=False), encoding="utf-8")
    options = RunOptions(
        file=experiment,
        workers=workers,
        out=out,
        resume=resume,
        new=new,
        json=as_json,
        database=database,
        group="experiment ",
    )
    finished = run_experiment(body, options)
    if finished is None:
        raise typer.Exit(1)
    found = {
        line.method: {str(measure): values_of(campaigns, measure, t_b, d_th) for measure in Measure}
        for line, campaigns in lines_of(repeats_of(finished.results)).items()
        if not line.control
    }
    # matplotlib takes half a second to load: only commands that draw wait for it.
    from brink.plots.evidence import figure_rerun

    picture = finished.folder / "sensitivity.png"
    title = f"How much the boundary depends on {parameter}: {body.name}"
    figure_rerun(found, parameter=parameter, t_b=t_b, d_th=d_th, title=title).savefig(picture)
    write_json(finished.folder / "sensitivity.json", found)
    if not as_json:
        console().print(f"picture: {picture}", soft_wrap=True)


def varied(body: CampaignBody, parameter: str, values: list[Any], seeds: int) -> ExperimentBody:
    """Return an experiment that varies one parameter of a campaign's algorithm.

    Args:
        body: The campaign.
        parameter: Name of the parameter.
        values: Values of the parameter.
        seeds: Number of searches with each value; the first uses the campaign's seed.

    Raises:
        InvalidInput: The experiment is invalid.
    """
    document = {
        "name": f"{body.name}: {parameter}"[:100],
        "problems": [body.problem.model_dump(mode="json")],
        "algorithms": [
            {
                "name": f"{value:g}" if isinstance(value, float) else str(value),
                "id": body.algorithm.id,
                "params": {**body.algorithm.params, parameter: value},
                "llm": body.document()["llm"],
            }
            for value in values
        ],
        "seeds": {"first": body.seed, "count": seeds},
        "budget": body.budget.model_dump(mode="json"),
        "priority": body.priority,
        "execution": body.execution.model_dump(mode="json"),
    }
    return parse_experiment(document)


def _values(text: str) -> list[Any]:
    """Return comma-separated values in their JSON types: numbers, booleans, otherwise strings."""
    found: list[Any] = []
    for part in filter(None, map(str.strip, text.split(","))):
        try:
            found.append(json.loads(part))
        except ValueError:
            found.append(part)
    return found


def _numbers(option: str, text: str, *, low: float, high: float, closed: bool) -> list[float]:
    bound = f"({low:g}, {high:g}{']' if closed else ')'}"
    try:
        found = [float(part) for part in text.split(",") if part.strip()]
    except ValueError:
        found = []
    if not found or not all(low < value < high or (closed and value == high) for value in found):
        raise InvalidInput.at(option, f"expected numbers in {bound}, separated by commas, got {text!r}")
    return found


def _table(name: str, found: "list[Rescored]", own: float) -> Table:
    columns = (name, "neighbours", "on the boundary", "distinct", "strict")
    rows = [
        (
            f"{getattr(one, name):g}",
            f"{one.neighbours:g}",
            f"{one.near:,}",
            f"{one.dbs:,}",
            f"{one.strict_dbs:,}",
            "this campaign" if getattr(one, name) == own else "",
        )
        for one in found
    ]
    return plain_table(*columns, "", right=columns, rows=rows)
