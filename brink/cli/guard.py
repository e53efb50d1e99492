"""`brink guard fit | judge | drive`: runtime monitors of what a car can observe, fitted to drives of campaigns."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from brink.api.live import Steps
from brink.cli.guard_drive import drive
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
from brink.guard.choices import DEFAULT_PROBLEM, FALSE_ALARMS, Sensor
from brink.server.campaigns.body import PluginChoice
from brink.server.errors import Conflict, InvalidInput
from brink.sim.catalogue import REQUIREMENTS, plugin_ids
from brink.sim.episode import EpisodeSpec

if TYPE_CHECKING:
    from brink.api.results import FetchedArchive
    from brink.guard.drives import Drive
    from brink.guard.evaluation import GuardEvaluation, PredictorResult
    from brink.guard.model import GuardModel
    from brink.server.problems.base import SimulatedProblem

FRESH_SEED = 2_001
"""Seed of fresh drives; seeds of campaigns are usually small."""
RANDOM_SEED = 1_001
INTERVALS = "95% intervals, drives that share a scenario or a behaviour counting as dependent"

guard = typer.Typer(
    name="guard",
    help="Fit, judge and drive with a guard: a monitor in the car that warns of a violation.",
    no_args_is_help=True,
    rich_markup_mode=None,
)
guard.command(name="drive")(drive)
GuardFile = Annotated[
    Path, typer.Argument(metavar="GUARD", help="Guard file written by `brink guard fit`.", show_default=False)
]
Campaigns = Annotated[
    list[str] | None,
    typer.Argument(metavar="ID...", help="Ids of campaigns.", show_default=False, callback=check_ids),
]
Processes = Annotated[int, typer.Option(min=1, max=256, help="Processes that re-run drives.")]


@guard.command()
def fit(
    campaigns: Campaigns = None,
    out: Annotated[Path, typer.Option(help="File to write.")] = Path("guard.json"),
    random: Annotated[
        int,
        typer.Option(
            "--random",
            min=0,
            help="Random drives of the same problem to add (default problem: urban-injected@1).",
        ),
    ] = 0,
    sensor: Annotated[
        Sensor,
        typer.Option(
            help="Sensors of the car: the detector's boxes alone, or also a coarse forward range sensor."
        ),
    ] = Sensor.BOXES,
    requirement: Annotated[
        list[str] | None,
        typer.Option(
            metavar="ID",
            show_default=False,
            help="Requirement whose violation the guard predicts; may be repeated (default: those of the campaigns).",
        ),
    ] = None,
    false_alarms: Annotated[
        float,
        typer.Option(
            min=0.0, max=0.5, help="Share of safe drives that may have an alarm; sets its threshold."
        ),
    ] = FALSE_ALARMS,
    seed: Annotated[
        int, typer.Option(min=0, help="Seed of the random drives and of the division into folds.")
    ] = RANDOM_SEED,
    processes: Processes = 2,
    database: Database = None,
    server: Server = None,
    as_json: AsJson = False,
) -> None:
    """Fit a guard to the drives of campaigns, to random drives, or to both.

    The drives run again on this machine to record what the car observes. Needs the extra `analysis`; the guard itself
    needs only NumPy.

    Example: brink guard fit 3f2a 91bc --random 500 --out guard.json
    """
    from brink.guard.fitting import fit as fit_guard

    check_out(out, make_folder=True)
    source = _source(campaigns, random, seed, database, server, requirement=requirement)
    with Steps(console(stderr=True), "re-running drives") as steps:
        drives = source.recorded(processes, steps)
        model = fit_guard(
            drives,
            source.requirements,
            sensor=sensor,
            false_alarms=false_alarms,
            seed=seed,
            about=source.about,
            on_progress=steps.of("fitting trees"),
        )
    model.save(out)
    violations = model.about["violations"]
    if as_json:
        print_json(
            {
                "file": str(out),
                "drives": len(drives),
                "violations": violations,
                "sensor": str(sensor),
                "requirements": list(source.requirements),
                "horizons_s": list(model.horizons_s),
                "threshold": model.alarm.threshold,
            }
        )
        return
    console().print(
        f"{out}: fitted to {len(drives):,} drives, {violations:,} of which violate "
        f"{' or '.join(source.requirements)}; "
        f"alarm at a probability of {model.alarm.threshold:.3f} within {model.alarm.horizon_s:g} s",
        soft_wrap=True,
    )


@guard.command()
def judge(
    file: GuardFile,
    campaigns: Campaigns = None,
    drives: Annotated[
        int, typer.Option("--drives", min=0, help="Fresh random drives of the guard's problem.")
    ] = 0,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the fresh drives.")] = FRESH_SEED,
    picture: Annotated[
        Path | None,
        typer.Option("--picture", help="PNG or SVG file for a plot of lead time and false alarms."),
    ] = None,
    processes: Processes = 2,
    database: Database = None,
    server: Server = None,
    as_json: AsJson = False,
) -> None:
    """Judge a guard on campaigns or fresh random drives that it was not fitted to, beside two baselines.

    Example: brink guard judge guard.json --drives 2000 --picture guard.png
    """
    from brink.guard.drives import problem_of
    from brink.guard.evaluation import evaluate
    from brink.guard.model import GuardModel

    check_picture(picture)
    model = GuardModel.load(file)
    if not campaigns and not drives:
        raise InvalidInput.at("", "expected ids of campaigns, or a number of fresh drives with --drives")
    source = _source(
        campaigns,
        drives,
        seed,
        database,
        server,
        requirement=list(model.requirements),
        default=problem_of(model.about),
    )
    _check_fresh(file, model, source)
    with Steps(console(stderr=True), "re-running drives") as steps:
        recorded = source.recorded(processes, steps)
        steps.show("judging")
        evaluation = evaluate(model, recorded)
    if picture is not None:
        from brink.plots.guard import figure_guard  # matplotlib takes half a second to load

        figure_guard(evaluation).savefig(picture)
    if as_json:
        print_json(evaluation.to_json())
        return
    _print(evaluation)
    if picture is not None:
        console().print(f"picture: {picture}", soft_wrap=True)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Part:
    """Some of the drives.

    Attributes:
        whose: Whose drives they are, for messages.
        specs: Their episodes.
        fetched: The campaign that simulated them; None for random drives.
    """

    whose: str
    specs: Sequence[EpisodeSpec]
    fetched: "FetchedArchive | None" = None


@dataclass(frozen=True, slots=True, kw_only=True)
class _Source:
    """The source of drives.

    Attributes:
        choice: Id and parameters of their problem.
        requirements: Ids of the requirements that count.
        parts: The drives of each campaign, and random ones.
        random: Number of random drives.
        seed: Seed of the random drives.
    """

    choice: PluginChoice
    requirements: tuple[str, ...]
    parts: Sequence[_Part]
    random: int
    seed: int

    @property
    def campaigns(self) -> list[str]:
        """Ids of the campaigns."""
        return [one.fetched.id for one in self.parts if one.fetched is not None]

    @property
    def about(self) -> dict[str, Any]:
        """Provenance of a guard."""
        return {
            "campaigns": self.campaigns,
            "random": {"drives": self.random, "seed": self.seed} if self.random else None,
            "problem": self.choice.model_dump(mode="json"),
        }

    def recorded(self, processes: int, steps: Steps) -> "list[Drive]":
        """Run all drives again; a drive that several campaigns share counts once.

        Raises:
            Conflict: The drives of a campaign end differently on this machine.
        """
        from brink.guard.drives import Drive, Recorders, check_problem, check_verdicts

        found: dict[str, Drive] = {}
        with Recorders(processes) as recorders:
            for one in self.parts:
                drives = recorders.record(
                    one.specs, on_progress=steps.of(f"running the drives of {one.whose}")
                )
                if one.fetched is not None:
                    problem = check_problem(one.fetched.plan.problem)
                    check_verdicts(drives, problem.requirements, one.fetched.archive, one.whose)
                found |= {drive.digest: drive for drive in drives}
        return list(found.values())


def _specs(problem: "SimulatedProblem", fetched: "FetchedArchive") -> list[EpisodeSpec]:
    """Return the episodes of a campaign.

    Raises:
        Conflict: They differ from those that were simulated, or the coordinator does not send their seeds.
    """
    from brink.guard.drives import solution_specs

    whose = f"campaign {fetched.id}"
    if fetched.seeds is None or fetched.digests is None:
        raise Conflict(f"{whose}: its coordinator does not send the seeds of episodes: update it")
    return solution_specs(problem, fetched.archive, fetched.seeds, fetched.digests, whose)


def _source(
    campaigns: Sequence[str] | None,
    random: int,
    seed: int,
    database: str | None,
    server: str | None,
    *,
    requirement: Sequence[str] | None,
    default: PluginChoice = PluginChoice(id=DEFAULT_PROBLEM),
) -> _Source:
    """Return the source of drives, checked before anything slow begins.

    Raises:
        InvalidInput: There are no drives, or a guard cannot watch them.
        Conflict: The campaigns have different problems, or their drives were not judged by a requirement.
    """
    from brink.cli.fitted import fetch_archives
    from brink.guard.drives import check_problem, check_requirements, random_specs, with_requirements
    from brink.server.problems.catalogue import make_problem

    if not campaigns and not random:
        raise InvalidInput.at("", "expected ids of campaigns, or a number of random drives with --random")
    for one in requirement or ():
        if one not in plugin_ids(REQUIREMENTS):
            raise InvalidInput.at(
                "--requirement", f"expected one of {', '.join(plugin_ids(REQUIREMENTS))}, got {one!r}"
            )
    fetched = fetch_archives(campaigns, server=server, database=database) if campaigns else []
    if fetched:
        choice, problem = fetched[0].body.problem, check_problem(fetched[0].plan.problem)
    else:
        choice = with_requirements(default, requirement or ())
        problem = check_problem(make_problem(choice.id, choice.params))
    names = tuple(requirement) if requirement else problem.requirements
    check_requirements(problem, names)
    parts = [
        _Part(whose=f"campaign {one.id}", specs=_specs(check_problem(one.plan.problem), one), fetched=one)
        for one in fetched
    ]
    if random:
        parts.append(_Part(whose=f"random seed {seed}", specs=random_specs(problem, random, seed)))
    return _Source(choice=choice, requirements=names, parts=parts, random=random, seed=seed)


def _check_fresh(file: Path, model: "GuardModel", source: _Source) -> None:
    """Check that a guard was not fitted to the drives on which it is to be evaluated, whatever their campaign.

    Raises:
        Conflict: It was.
    """
    from brink.cli.fitted import fitted_among, fitted_words
    from brink.guard.seen import check_unseen

    fetched = [one.fetched for one in source.parts if one.fetched is not None]
    if own := fitted_among(model.about, fetched):
        raise Conflict(
            f"{fitted_words(file, own)}: evaluate it on other drives, ideally fresh ones (--drives 2000)"
        )
    seeds = [source.seed] if source.random else []
    drives = [(one.whose, one.specs) for one in source.parts]
    check_unseen(model.about, drives, name=str(file), seeds=seeds, option="--seed")


def _print(evaluation: "GuardEvaluation") -> None:
    from brink.guard.evaluation import LEAD_S, LEADS_S

    screen = console()
    share = evaluation.violations / evaluation.drives
    screen.print(
        f"{evaluation.drives:,} drives, {evaluation.violations:,} of which ({share:.0%}) violate "
        f"{' or '.join(evaluation.requirements)}; {evaluation.too_early:,} within the first {LEAD_S:g} s",
        soft_wrap=True,
    )
    leads = [f"{lead_s:g} s" for lead_s in LEADS_S if lead_s]
    screen.print(
        f"violations predicted at least this long ahead, with alarms in {FALSE_ALARMS:.0%} of the safe drives (each "
        f"threshold is chosen on other drives; {INTERVALS}):",
        soft_wrap=True,
    )
    right = ("false alarms", *leads)
    columns = ("predictor", *right, f"interval at {LEAD_S:g} s")
    screen.print(plain_table(*columns, right=right, rows=map(_row, evaluation.predictors)))
    own = evaluation.own
    lead = "none" if own.median_lead_s is None else f"{own.median_lead_s:.1f} s"
    screen.print(
        f"with its own threshold ({own.point.threshold:.3f}): {own.point.recall:.0%} ({_limits(own.interval)}) of "
        f"violations predicted at least {LEAD_S:g} s ahead, {own.recent:.0%} by an alarm of the last seconds; alarms "
        f"in {own.point.false_alarms:.1%} ({_limits(own.false_interval, 1)}) of safe drives, "
        f"{own.false_per_hour:.1f} an hour; median lead {lead}",
        soft_wrap=True,
    )
    figures = ("AUROC", "Brier", "calibration error")
    rows = [
        (f"{one.horizon_s:g} s", f"{one.auroc:.3f}", f"{one.brier:.4f}", f"{one.calibration_error:.4f}")
        for one in evaluation.horizons
    ]
    screen.print("", plain_table("horizon", *figures, right=figures, rows=rows))


def _row(one: "PredictorResult") -> list[str]:
    from brink.guard.evaluation import LEADS_S

    interval = _limits(one.interval) if one.shown == one.compared else ""
    warned = [f"{share:.0%}" for lead_s, share in zip(LEADS_S, one.shown.warned, strict=True) if lead_s]
    return [f"  {one.name}", f"{one.shown.false_alarms:.1%}", *warned, interval]


def _limits(interval: tuple[float, float], decimals: int = 0) -> str:
    low, high = interval
    return f"{low:.{decimals}%} to {high:.{decimals}%}"
