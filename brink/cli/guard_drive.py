"""`brink guard drive`: fresh drives without and with a guard and the fallback that it triggers."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from brink.api.live import Steps
from brink.cli.options import (
    AsJson,
    Odd,
    check_out,
    console,
    named_values,
    plain_table,
    print_json,
    read_odd,
    write_json,
)
from brink.guard.choices import DEFAULT_PROBLEM, FIRST_SEED, LIMITS
from brink.server.campaigns.body import PluginChoice
from brink.server.errors import InvalidInput
from brink.sim.catalogue import plugin_ids
from brink.sim.guard.option import DEFAULT_FALLBACK, FILE, GUARDS, GuardOption

if TYPE_CHECKING:
    from brink.guard.loop import Condition, GuardedLoop
    from brink.guard.model import GuardModel
    from brink.search.analysis.guard_drives import Estimate, GuardWorth
    from brink.search.space import BoolArray

MOST_PICTURES: Final = 20


def drive(
    guard: Annotated[
        str,
        typer.Argument(
            metavar="GUARD",
            help="Guard file written by `brink guard fit`, or ttc@1 or range-ttc@1: a least time to collision.",
            show_default=False,
        ),
    ],
    fallback: Annotated[
        str,
        typer.Option(
            help="What an alarm triggers: safe-stop@1, slow-down@1, ignore-boxes@1, or none@1 to count alarms only."
        ),
    ] = DEFAULT_FALLBACK,
    setting: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=VALUE",
            show_default=False,
            help="Setting of the fallback, such as decel_mps2=3; may be repeated.",
        ),
    ] = None,
    threshold: Annotated[
        list[float] | None,
        typer.Option(
            min=LIMITS[0],
            max=LIMITS[1],
            show_default=False,
            help="Probability from which the guard raises the alarm; may be repeated "
            "(default: 1/64 to four times the odds of the guard's own).",
        ),
    ] = None,
    drives: Annotated[int, typer.Option(min=1, max=100_000, help="Drives of each seed.")] = 200,
    seeds: Annotated[int, typer.Option(min=1, max=1000, help="Number of seeds.")] = 10,
    first_seed: Annotated[int, typer.Option(min=0, help="The first seed.")] = FIRST_SEED,
    problem: Annotated[
        str | None,
        typer.Option(
            metavar="ID",
            show_default=False,
            help="Problem from whose space drives are drawn (default: the guard's own, with its parameters; "
            f"{DEFAULT_PROBLEM} for a guard that needs no fitting).",
        ),
    ] = None,
    param: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=VALUE",
            show_default=False,
            help="Parameter of the problem, such as trajectories=3, in place of the guard's; may be repeated.",
        ),
    ] = None,
    odd: Odd = None,
    requirement: Annotated[
        list[str] | None,
        typer.Option(
            metavar="ID",
            show_default=False,
            help="Requirement that counts; may be repeated (default: what the guard predicts, or the problem's).",
        ),
    ] = None,
    processes: Annotated[int, typer.Option(min=1, max=256, help="Number of processes.")] = 2,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder for the figures (drives.json), a plot of the trade-off, and prevented violations.",
            show_default=False,
        ),
    ] = None,
    pictures: Annotated[
        int, typer.Option(min=0, max=MOST_PICTURES, help="Number of prevented violations to draw.")
    ] = 3,
    as_json: AsJson = False,
) -> None:
    """Run fresh drives without and with a guard, and report what its fallback prevents, costs and causes.

    Each drive runs without the guard, and again with it at each threshold. Intervals are 95% intervals with the drive
    as unit: Wilson's for shares of drives, gamma intervals for other figures.

    Example: brink guard drive guard.json --drives 200 --seeds 10 --out guard-drives
    """
    from brink.guard.drives import check_problem, random_specs
    from brink.guard.loop import drive_with_guard, thresholds_around
    from brink.guard.seen import SeenDrives, check_unseen
    from brink.server.problems.catalogue import make_problem

    option = _option(guard, fallback, setting or [])
    model = _model(option)
    chosen = sorted(set(threshold)) if threshold else thresholds_around(option.own_threshold)
    used = [*range(first_seed, first_seed + seeds)]
    params = named_values("--param", param, "trajectories=3")
    if odd:
        params["odd"] = read_odd(odd)
    choice = _choice(model, problem, params, requirement or [])
    task = check_problem(make_problem(choice.id, choice.params))
    seen = None if model is None else SeenDrives.by(model.about)
    if model is not None:
        fresh = ((f"seed {one}", random_specs(task, drives, one)) for one in used)
        check_unseen(model.about, fresh, name="the guard", seeds=used, option="--first-seed")
    if out is not None:
        check_out(out / "drives.json", make_folder=True)
    with Steps(console(stderr=True), "starting") as steps:
        loop = drive_with_guard(
            task, option, chosen, drives=drives, seeds=used, processes=processes, on_progress=steps.show
        )
        parts = {} if seen is None else seen.parts(loop.specs)
        document = {
            "problem": choice.model_dump(mode="json"),
            "guard": option.to_json(),
            **loop.to_json(parts),
        }
        if out is not None:
            _remove_pictures(out)
            write_json(out / "drives.json", document)
            steps.show("drawing the trade-off")
            _draw(loop, out)
            _draw_prevented(loop, out, pictures, steps)
    if as_json:
        print_json(document)
        return
    _print(loop, option, parts)
    if out is not None:
        console().print(f"figures and pictures: {out}", soft_wrap=True)


def _option(guard: str, fallback: str, settings: Sequence[str]) -> GuardOption:
    """Return the guard and the fallback that the command line names.

    Raises:
        InvalidInput: A setting has another form.
        InvalidEpisode: The guard or the fallback is unknown, or a setting is out of range.
    """
    known = plugin_ids(GUARDS)
    if guard not in known and not Path(guard).exists():
        raise InvalidInput.at(
            "GUARD", f"expected a guard file or one of {', '.join(known)}; there is no {guard!r}"
        )
    name = guard if guard in known else f"{FILE}{Path(guard).absolute()}"
    values = named_values("--setting", settings, "decel_mps2=3", float)
    return GuardOption.of(name, fallback=fallback, settings=values)


def _model(option: GuardOption) -> "GuardModel | None":
    """Return the fitted model of a guard; None if it is a registered one."""
    from brink.guard.model import GuardModel

    return GuardModel.load(option.guard.removeprefix(FILE)) if option.guard.startswith(FILE) else None


def _choice(
    model: "GuardModel | None", problem_id: str | None, params: Mapping[str, Any], requirements: Sequence[str]
) -> PluginChoice:
    """Return the problem of the drives: the guard's own, unless the command line names another one.

    Args:
        model: The guard; None for one that was not fitted.
        problem_id: Id of another problem, whose parameters are not the guard's.
        params: Parameters that replace those of the guard's own problem.
        requirements: Requirements that count; without any, what the guard predicts.
    """
    from brink.guard.drives import problem_of, with_requirements

    own = PluginChoice(id=DEFAULT_PROBLEM) if model is None else problem_of(model.about)
    base = own if problem_id in (None, own.id) else PluginChoice(id=str(problem_id))
    merged = PluginChoice(id=base.id, params={**base.params, **params})
    limits = base.params.get("odd")
    if isinstance(limits, Mapping) and "odd" in params:
        merged = PluginChoice(id=base.id, params={**merged.params, "odd": {**limits, **params["odd"]}})
    if not requirements and model is not None:
        requirements = model.requirements
    return with_requirements(merged, requirements)


def _remove_pictures(out: Path) -> None:
    """Remove the pictures of an earlier run, which would not belong to the new figures."""
    for picture in (out / "trade-off.png", *out.glob("prevented-[0-9]*.png")):
        picture.unlink(missing_ok=True)


def _print(loop: "GuardedLoop", option: GuardOption, parts: "Mapping[str, BoolArray]") -> None:
    screen = console()
    count = len(loop.specs)
    violating = sum(one.violates(loop.requirements) for one in loop.without)
    screen.print(
        f"{count:,} drives of {len(set(loop.seed))} seeds, {violating:,} of which ({violating / count:.0%}) violate "
        f"{' or '.join(loop.requirements)} without a guard; with it, an alarm triggers {option.fallback}",
        soft_wrap=True,
    )
    names = (
        "fall by",
        "prevented",
        "entirely",
        "caused",
        "others",
        "distance lost",
        "when safe",
        "an hour",
        "drives",
    )
    screen.print(
        "violations prevented, those of them without a violation of any other requirement, violations caused, and "
        "safe drives with one of another requirement; mean distance lost, and that of drives that are safe without; "
        "false alarms an hour, and safe drives with one:",
        soft_wrap=True,
    )
    rows = [(f"{one.threshold:.3f}", *_row(loop.worth(one))) for one in loop.conditions]
    screen.print(plain_table("threshold", *names, right=("threshold", *names), rows=rows))
    best, counts = loop.shown()
    _print_recommendation(loop, loop.recommended())
    _print_parts(loop, best, {name: mask & counts for name, mask in parts.items()})
    _print_sights(loop, best, counts)
    _print_requirements(loop, best)


def _print_recommendation(loop: "GuardedLoop", best: "Condition | None") -> None:
    from brink.guard.loop import MOST_LOST

    limit = f"a loss of at most {MOST_LOST:.0%} of the mean distance of safe drives"
    if not loop.chooses.any():
        text = "no threshold is recommended: that needs two seeds, one to choose it and one to report on"
    elif best is None:
        text = f"no threshold is recommended: none prevents more violations than it causes at {limit}"
    else:
        worth = loop.worth(best, ~loop.chooses)
        text = (
            f"recommended: threshold {best.threshold:.3f}, with which violations fall most at {limit}, on the first "
            f"half of the seeds. On the other half they fall by {_percent(worth.reduction)} ({worth.prevented:,} "
            f"prevented, {worth.caused:,} caused), and safe drives lose {_percent(worth.distance_lost_when_safe, 1)}"
        )
        if loop.bounds(best):
            text += (
                "; it is at the end of the range tried, so a threshold beyond it may be better (--threshold)"
            )
    console().print(text, soft_wrap=True)


def _row(worth: "GuardWorth") -> list[str]:
    return [
        _percent(worth.reduction),
        f"{worth.prevented:,}",
        f"{worth.prevented_entirely:,}",
        f"{worth.caused:,}",
        _percent(worth.other_share, 1),
        _percent(worth.distance_lost, 1),
        _percent(worth.distance_lost_when_safe, 1),
        _number(worth.false_alarms_per_h),
        _percent(worth.alarmed_when_safe),
    ]


def _print_parts(loop: "GuardedLoop", best: "Condition", parts: "Mapping[str, BoolArray]") -> None:
    if not parts:
        return
    names = ("drives", "violations", "fall by", "distance lost", "false alarms an hour")
    worths = {name: loop.worth(best, mask) for name, mask in parts.items() if mask.any()}
    rows = [
        (
            name,
            f"{worth.drives:,}",
            f"{worth.violations_without:,}",
            _percent(worth.reduction),
            _percent(worth.distance_lost, 1),
            _number(worth.false_alarms_per_h),
        )
        for name, worth in worths.items()
    ]
    console().print("", plain_table(f"at threshold {best.threshold:.3f}", *names, right=names, rows=rows))


def _print_requirements(loop: "GuardedLoop", best: "Condition") -> None:
    """Print how many drives violate each requirement, also those that do not count."""
    names = ("without the guard", f"at threshold {best.threshold:.3f}")
    rows = [
        (name, f"{row['without']:,}", f"{row['with']:,}") for name, row in loop.by_requirement(best).items()
    ]
    console().print(
        "", plain_table(f"of all {len(loop.specs):,} drives, violate", *names, right=names, rows=rows)
    )


def _print_sights(loop: "GuardedLoop", best: "Condition", counts: "BoolArray") -> None:
    from brink.guard.sight import LEAD_S, WINDOW_S, Reported

    words = {
        Reported.COUNTERPART: "the other road user",
        Reported.OTHERS: "something else only",
        Reported.NOTHING: "nothing",
        Reported.NO_ROAD_USER: "(not about a road user)",
    }
    names = ("violations", "never reported", "within range", "prevented")
    keys = ("violations", "never_reported", "in_range", "prevented")
    rows = [
        (words[Reported(row["reported"])], *(f"{row[key]:,}" for key in keys))
        for row in loop.by_report(best, counts)
        if row["violations"]
    ]
    table = plain_table(f"reported in the {WINDOW_S:g} s before", *names, right=names, rows=rows)
    screen = console()
    screen.print("", table)
    screen.print(
        f"(never: of the whole drive so far; within range: in the sectors of a range sensor {LEAD_S:g} s before the "
        "violation, even if hidden)",
        style="dim",
    )


def _percent(estimate: "Estimate", decimals: int = 0) -> str:
    """Return a share with its interval, such as ``42% (37 to 47)``."""
    if estimate.value is None:
        return "–"
    shown = f"{estimate.value:.{decimals}%}"
    if estimate.low is None or estimate.high is None:
        return shown
    return f"{shown} ({100 * estimate.low:.{decimals}f} to {100 * estimate.high:.{decimals}f})"


def _number(estimate: "Estimate") -> str:
    if estimate.value is None:
        return "–"
    shown = f"{estimate.value:.1f}"
    return shown if estimate.low is None else f"{shown} ({estimate.low:.1f} to {estimate.high:.1f})"


def _draw(loop: "GuardedLoop", out: Path) -> None:
    # matplotlib takes half a second to load: only commands that draw wait for it.
    from brink.plots.guard_drives import figure_guard_tradeoff

    points = [(condition.threshold or 0.0, loop.worth(condition)) for condition in loop.conditions]
    figure = figure_guard_tradeoff(
        points, fallback=loop.conditions[0].option.fallback, requirements=loop.requirements
    )
    figure.savefig(out / "trade-off.png")


def _draw_prevented(loop: "GuardedLoop", out: Path, count: int, steps: Steps) -> None:
    from brink.guard.loop import guarded_spec, record_drive_trace
    from brink.pictures.guard import prevented_pair
    from brink.pictures.render import render_pair

    best, _ = loop.shown()
    chosen = loop.prevented(best)[:count]
    for number, drive_number in enumerate(chosen, start=1):
        steps.show("drawing prevented violations", number, len(chosen))
        spec = loop.specs[drive_number]
        alone, guarded = record_drive_trace(spec), record_drive_trace(guarded_spec(spec, best.option))
        render_pair(prevented_pair(alone, guarded, loop.requirements), out / f"prevented-{number}.png")
