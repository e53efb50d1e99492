"""The searches for pairs on one problem at equal budgets, and what differs between the sides of their pairs.

An experiment of the product runs the searches, checks included, and confirms their pairs with fresh seeds; so it can
be stopped and continued, and reported with `brink experiment report`. The table tells apart pairs of which one number
moves, as a threshold needs, and pairs of which a category changes. What a search found is a `Tally`; a further way to
count it, such as by the thresholds that its pairs lead to, is a further column.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from statistics import fmean
from typing import Any, Final, Self

from rich.console import Console
from rich.table import Table

from brink.api.client import Api
from brink.api.live import ExperimentDisplay, Steps
from brink.api.runs import ExperimentRun
from brink.api.terminal import plain_table
from brink.cli.experiment_pairs import fetch_experiment_pairs, pair_repeats_of, run_follow_ups
from brink.cli.local import CommandSession, RunOptions, run_to_end
from brink.report.experiment_pairs import duel_words
from brink.search.analysis.confirmation import Confirmation
from brink.search.analysis.pair_comparison import measure_words, pair_duels
from brink.server.api.experiment_pairs import ExperimentPairs
from brink.server.api.schemas import ExperimentProgress
from brink.server.campaigns.plan import make_checked_plan
from brink.server.experiments.body import ExperimentBody, parse_experiment
from brink.server.experiments.pairs import check_pairs
from brink.server.findings.pairs.views import MOST_PAIRS, ChangeView, PairNature, PairsView, PairView
from brink.server.problems.catalogue import check_extra

FINDERS: Final[Mapping[str, str]] = {
    "edge": "edge@1",
    "nearest opposite": "nearest-opposite@1",
    "DeepJanus": "deepjanus@1",
    "straddle": "straddle@1",
    "BSV": "bsv@1",
    "MLCSHE": "mlcshe@1",
    "GA": "ga@1",
    "random search": "random@1",
}
"""The algorithms by their names in tables; each runs with its default settings."""
NARROW: Final = 0.05
"""Share of its range that a number may move between the sides of a narrow pair."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """A problem to compare on.

    Attributes:
        id: Its id.
        params: Its parameters.
        eps: Largest distance between the sides of a pair.
        d_th: Smallest distance between two distinct pairs.
        confirm: Most simulations of each side with fresh seeds; 0 where verdicts are computed.
    """

    id: str
    params: Mapping[str, Any] = field(default_factory=dict)
    eps: float = 0.02
    d_th: float = 0.2
    confirm: int = 30


CASES: Final[Mapping[str, Case]] = {
    "urban-errors": Case(id="urban-errors@1"),
    "front-gap": Case(id="urban-injected@1", params={"requirement": "front-gap@1"}),
    "lane-keeping": Case(id="urban-injected@1", params={"requirement": "lane-keeping@1"}),
    "mtq": Case(id="mtq@1", eps=0.002, d_th=0.05, confirm=0),
}
"""The problems by name."""


def experiment(problem: str, *, simulations: int, seeds: int, methods: Sequence[str]) -> ExperimentBody:
    """Return the experiment that compares searches on a problem.

    Args:
        problem: Name in `CASES`.
        simulations: Budget of each search.
        seeds: Searches with each method.
        methods: Names in `FINDERS`.
    """
    case = CASES[problem]
    return parse_experiment(
        {
            "name": f"finders-{problem}",
            "problems": [{"name": problem, "id": case.id, "params": dict(case.params)}],
            "algorithms": [{"name": name, "id": FINDERS[name]} for name in methods],
            "seeds": {"first": 1, "count": seeds},
            "budget": {"simulations": simulations},
            "pairs": {"eps": case.eps, "d_th": case.d_th, "confirm": case.confirm},
        }
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Tally:
    """The pairs of a campaign: those that were confirmed or, where verdicts are computed, all of them.

    Attributes:
        method: Name of the algorithm.
        seed: The campaign's seed.
        pairs: Distinct pairs, confirmed or not.
        held: Those that count.
        numbers: Of these, pairs whose numbers move.
        narrow: Of these, pairs of which one number moves, by at most 5% of its range.
        category: Pairs that held of which only a category, or a step, of the component changes.
        scenario: Those of which only one of the scenario changes.
    """

    method: str
    seed: int
    pairs: int
    held: int
    numbers: int
    narrow: int
    category: int
    scenario: int

    @classmethod
    def of(cls, method: str, seed: int, view: PairsView, *, computed: bool) -> Self:
        """Return the tally of a campaign.

        Args:
            method: Name of the algorithm.
            seed: The campaign's seed.
            view: Its distinct pairs.
            computed: Whether verdicts are computed, so that there is nothing to confirm.
        """
        held = [one for one in view.pairs if computed or one.confirmation.state is Confirmation.CONFIRMED]
        natures = [one.nature for one in held]
        return cls(
            method=method,
            seed=seed,
            pairs=view.distinct,
            held=len(held),
            numbers=natures.count(PairNature.NUMBERS),
            narrow=sum(_is_narrow(one) for one in held),
            category=natures.count(PairNature.CATEGORY),
            scenario=natures.count(PairNature.SCENARIO),
        )


def _is_narrow(pair: PairView) -> bool:
    """Return whether one unit of numbers alone has a part in a pair, and moves by little."""
    changes: list[ChangeView] = [one for one in pair.changes if one.active is not False]
    return len(changes) == 1 and changes[0].moved is not None and changes[0].moved <= NARROW


COLUMNS: Final[Mapping[str, str]] = {
    "pairs": "distinct pairs",
    "held": "that hold",
    "numbers": "numbers move",
    "narrow": "one, by at most 5%",
    "category": "a category changes",
    "scenario": "the scenario's",
}
"""Titles of the columns, by attributes of `Tally`."""


def standings(tallies: Sequence[Tally]) -> list[dict[str, Any]]:
    """Return the mean of each column over the campaigns of each method, in the order of the experiment."""
    by_method: dict[str, list[Tally]] = {}
    for one in tallies:
        by_method.setdefault(one.method, []).append(one)
    return [
        {"method": method, "campaigns": len(ours)}
        | {name: fmean(getattr(one, name) for one in ours) for name in COLUMNS}
        for method, ours in by_method.items()
    ]


def table(problem: str, tallies: Sequence[Tally]) -> Table:
    """Return the means as a table."""
    shown = plain_table(
        "",
        *COLUMNS.values(),
        right=COLUMNS.values(),
        title=f"{problem}: means over the campaigns of a method",
    )
    for row in standings(tallies):
        shown.add_row(row["method"], *(f"{row[name]:.1f}" for name in COLUMNS))
    return shown


def run_finders(
    body: ExperimentBody,
    screen: Console,
    *,
    workers: int = 2,
    database: str | None = None,
    out: Path,
    new: bool = False,
) -> list[Tally] | None:
    """Run an experiment of `experiment` to its end on this machine, or continue an earlier one of the same kind.

    Args:
        body: The experiment.
        screen: Console for progress and for the comparison of the first method with the others.
        workers: Number of worker processes.
        database: Database URL; None takes the default one.
        out: Folder for the experiment file and the workers' log.
        new: Whether to start anew even if there is an earlier one.

    Returns:
        The tallies of all campaigns; None if the experiment was stopped or did not finish.

    Raises:
        InvalidInput: A campaign of the experiment cannot run.
    """
    for cell in body.cells()[: len(body.algorithms)]:
        check_extra(make_checked_plan(cell.body).problem)
    check_pairs(body)
    out.mkdir(parents=True, exist_ok=True)
    file = out / f"{body.name}.json"
    file.write_text(body.model_dump_json(indent=1) + "\n", encoding="utf-8")
    options = RunOptions(
        file=file,
        workers=workers,
        out=out,
        resume=not new,
        new=new,
        json=False,
        database=database,
        port=0,
        group="experiment ",
    )

    async def finish(session: CommandSession, progress: ExperimentProgress) -> list[Tally] | None:
        pairs = await fetch_experiment_pairs(session.api, progress.id, screen)
        confirm = 0 if body.pairs is None else body.pairs.confirm
        if confirm:
            complete = await run_follow_ups(session, pairs, confirm=confirm, component=False)
            if not complete:
                screen.print("not all pairs were tried; the same command continues")
                return None
            pairs = await fetch_experiment_pairs(session.api, progress.id, screen)
        _print_comparison(screen, pairs, body)
        with Steps(screen, "reading the pairs"):
            settings = {"eps": pairs.eps, "d_th": pairs.d_th}
            return [
                Tally.of(
                    one.method,
                    one.seed,
                    await _pairs_of(session.api, one.campaign, settings),
                    computed=one.computed,
                )
                for one in pairs.repeats
            ]

    return run_to_end(ExperimentRun(body), options, screen, ExperimentDisplay(screen), finish)


def _print_comparison(screen: Console, pairs: ExperimentPairs, body: ExperimentBody) -> None:
    """Print how the first method compares with each other one."""
    repeats = pair_repeats_of(pairs)
    screen.print(measure_words(repeats, body.problems[0].label), soft_wrap=True)
    for duel in pair_duels(repeats, level=pairs.alpha):
        if duel.first == body.algorithms[0].label:
            screen.print(f"- {duel_words(duel).replace('**', '')}", soft_wrap=True)


async def _pairs_of(api: Api, campaign: str, settings: Mapping[str, float]) -> PairsView:
    return await api.read(PairsView, f"/campaigns/{campaign}/pairs", {**settings, "limit": MOST_PAIRS})
