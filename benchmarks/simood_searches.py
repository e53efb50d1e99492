"""The SiMOOD criteria A5, A6 and A9: searches on the data set, and how far their finalists depend on interaction.

Every search is one of `simood-ga@1` itself, without a coordinator: it chooses and explains its finalists, too. The
scenarios that it asks for are replaced by numbered streets that all searches share, so that criteria share episodes.
"""

import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np
from scipy import stats

from benchmarks.measurement import Progress, Row, at_least, at_most
from benchmarks.simood_figures import draw_omega
from benchmarks.simood_places import CONFIRMATION_PLACES, Criteria, NamedChain, words_of
from benchmarks.trials import Record, Records
from brink.report.text import p_text
from brink.search.algorithm import Candidate, Evaluation, Measured, Question, Scored
from brink.search.algorithms.simood import (
    Simood,
    SimoodConfig,
    SimoodState,
    Stage,
    budget_for,
    explained_of,
    finalists_of,
)
from brink.search.analysis.combinations import HAZARDOUS, Combination, combinations, verdicts_by_chain
from brink.search.analysis.comparison import is_significant
from brink.search.analysis.statistics import compared, holm
from brink.search.fitness import wilson_interval
from brink.search.slots import ChainGenome
from brink.search.space import FloatArray, SearchSpace
from brink.server.problems.aeb_crossing import AebCrossingParams
from brink.sim.episode import EpisodeSpec

GENERATIONS: Final = (10, 20, 30, 50)
POPULATIONS: Final = (10, 20, 30, 50)
OMEGAS: Final = (0.01, 0.1, 0.25, 0.5, 0.66, 0.75, 0.99)
"""The grids of the paper's tables II and III and of its Fig. 4, as in the authors' published code."""
SIGNIFICANCE_LEVEL: Final = 0.05
CONTROL_SEED: Final = 1_000
"""First seed of random searches. With the same seeds, they would begin with the same individuals as the genetic
algorithm, and the samples would not be independent."""
BUDGET: Final = 100_000
PAPER_EVALUATIONS: Final = 60
"""Individuals of a search with the paper's settings: n + k g."""
EVALUATIONS: Final = 120
"""Evaluations of a search that is compared with others, those of parts included; about as many as a search with the
default settings needs."""
MAX_HAZARDOUS_RANDOM_PAIRS: Final = 0.5
MIN_SHARE_BY_INTERACTION: Final = 1 / 3
PAPER: Final = replace(SimoodConfig(), interaction="none")
WITH_MARGIN: Final = replace(SimoodConfig(), interaction="fitness")
_SIMOOD: Final = Simood()


class Spread(NamedTuple):
    """Mean, standard deviation and range of a figure over repeated searches."""

    mean: float
    deviation: float
    least: float
    most: float


def spread_of(values: Sequence[float]) -> Spread:
    """Return the spread of values; the deviation of a single one is 0."""
    deviation = statistics.stdev(values) if len(values) > 1 else 0.0
    return Spread(statistics.fmean(values), deviation, min(values), max(values))


def unique_genes(chains: Sequence[NamedChain]) -> int:
    """Return the number of distinct genes of chains: techniques at a level, as the paper's table II counts them."""
    return len({step for chain in chains for step in chain if step[1]})


def hazard_p_value(first: Sequence[float], second: Sequence[float]) -> float:
    """Return the one-sided p-value of Fisher's exact test that chains of the first group are hazardous more often.

    The unit is the chain: its streets share its perturbations and are not independent.

    Args:
        first: Share of the streets in which each chain of the first group is unsafe.
        second: The same for the second group.
    """
    table = np.array(
        [
            [sum(share >= HAZARDOUS for share in group), sum(share < HAZARDOUS for share in group)]
            for group in (first, second)
        ]
    )
    return float(stats.fisher_exact(table, alternative="greater")[1])


Shares: TypeAlias = Sequence[Mapping[NamedChain, float]]
"""For each search, the share of the streets in which each of its chains is unsafe."""


class Contest(NamedTuple):
    """Finalists of the genetic algorithm, and chains of random searches.

    Attributes:
        words: What is compared with what, such as ``finalists against random pairs, default fitness``.
        finalists: Finalists of the genetic algorithm.
        others: Chains of random searches.
    """

    words: str
    finalists: Shares
    others: Shares

    @property
    def distinct(self) -> list[list[float]]:
        """For both sides, the share of the streets in which each distinct chain of all searches is unsafe."""
        return [
            list({chain: s for search in group for chain, s in search.items()}.values())
            for group in (self.finalists, self.others)
        ]

    @property
    def by_search(self) -> list[list[float]]:
        """For both sides, the hazardous share of the chains of each search."""
        return [
            [statistics.fmean(s >= HAZARDOUS for s in search.values()) for search in group]
            for group in (self.finalists, self.others)
        ]


def hazard_rows(contests: Sequence[Contest]) -> list[Row]:
    """Return the rows of A5 that compare how often finalists and other chains are hazardous.

    Fisher's test takes distinct chains of all searches together. Chains of one search are related, so that the share
    of hazardous chains of each search is tested, too. The p-values of each test are corrected by Holm's method.
    """
    fisher = holm([hazard_p_value(*one.distinct) for one in contests])
    whitney = holm([compared(*one.by_search).p_value for one in contests])
    rows = []
    for one, chains_p, searches_p in zip(contests, fisher, whitney, strict=True):
        assert chains_p is not None
        counts = " and ".join(
            f"{sum(s >= HAZARDOUS for s in group)} of {len(group)}" for group in one.distinct
        )
        means = [statistics.fmean(shares) for shares in one.by_search]
        numbers = [len(shares) for shares in one.by_search]
        rows += [
            Row(
                what=f"A5 Fisher p of hazardous {one.words}",
                value=chains_p,
                target=f"below {SIGNIFICANCE_LEVEL:g}",
                met=chains_p < SIGNIFICANCE_LEVEL,
                note=f"with Holm's correction; distinct chains, hazardous, unsafe in {HAZARDOUS:.0%} of "
                f"{len(CONFIRMATION_PLACES)} streets: {counts}",
            ),
            Row(
                what=f"A5 hazardous share, difference, {one.words}",
                value=means[0] - means[1],
                target=f"above 0, p < {SIGNIFICANCE_LEVEL:g}",
                met=means[0] > means[1] and is_significant(searches_p, SIGNIFICANCE_LEVEL),
                note=f"{means[0]:.2f} and {means[1]:.2f}; Mann-Whitney p {p_text(searches_p)} with Holm's "
                f"correction, of the shares of {numbers[0]} and {numbers[1]} searches",
            ),
        ]
    return rows


def share_words(part: int, whole: int) -> str:
    """Return a count with its 95% Wilson interval, such as ``2 of 10 (6% to 51%)``."""
    if not whole:
        return "0 of 0"
    low, high = (float(limit[0]) for limit in wilson_interval([part], [whole]))
    return f"{part} of {whole} ({low:.0%} to {high:.0%})"


@dataclass(frozen=True, slots=True, kw_only=True)
class Campaign:
    """A whole campaign: its search, the simulation of its finalists, and their explanation.

    Attributes:
        state: The algorithm when it was finished.
        explained: The explained finalists beside their parts and other orders.
    """

    state: SimoodState
    explained: list[Combination]

    @property
    def measured(self) -> int:
        """Number of evaluations on the data set, those of parts included."""
        return evaluations_of(self.state)

    @property
    def episodes(self) -> int:
        """Number of episodes, those of the explanation included."""
        return len(self.state.archive)

    @property
    def hazardous(self) -> int:
        """Number of explained finalists that are hazardous."""
        return sum(one.hazardous for one in self.explained)

    @property
    def by_interaction(self) -> int:
        """Number of explained finalists that are hazardous only together or only in one order."""
        return sum(one.only_together or one.order_matters for one in self.explained)


def evaluations_of(state: SimoodState) -> int:
    """Return the number of evaluations of a search, those of parts included."""
    return len(state.individuals) + len(state.parts)


@dataclass(slots=True, kw_only=True)
class Search:
    """A search on the data set; mutable.

    Attributes:
        config: Configuration of the algorithm.
        seed: Seed of the search.
        evaluations: Number of evaluations, those of parts included, after which it stops; None for as many as the
            configuration says.
        state: Current state; None before the start.
    """

    config: SimoodConfig
    seed: int
    evaluations: int | None = None
    state: SimoodState | None = None

    def start(self, space: SearchSpace) -> None:
        """Start the search."""
        if self.evaluations is None:
            config, budget = self.config, BUDGET
        else:
            config = replace(self.config, generations=self.evaluations)
            budget = budget_for(space, config, self.evaluations)
        self.state = _SIMOOD.start(space, config, seed=self.seed, budget=budget)

    @property
    def limit(self) -> int:
        """Largest number of individuals."""
        most = self.config.population_size + self.config.parents * self.config.generations
        return most if self.evaluations is None else self.evaluations


class Searches(Criteria):
    """A5, A6 and A9: the genetic algorithm against random search, its results by configuration, and interaction.

    Searches advance together, one generation at a time, so that no process is idle.

    Args:
        records: Runs episodes and stores their outcomes.
        folder: Folder for tables and figures.
        progress: Progress callback.
        params: Parameters of the problem.
        repeats: Searches with each configuration in A6, and campaigns in A9.
        seeds: Searches of each kind in A5.
    """

    def __init__(
        self,
        records: Records,
        folder: Path,
        progress: Progress,
        params: AebCrossingParams,
        *,
        repeats: int,
        seeds: int,
    ) -> None:
        super().__init__(records, folder, progress, params)
        self._repeats = range(repeats)
        self._seeds = range(seeds)
        self._genome = ChainGenome.of(self._places.problem.space)

    def against_random(self) -> list[Row]:
        """Measure A5: the final mean fitness, and how often finalists and random pairs are hazardous.

        Both with the paper's fitness and with that of the default settings. Searches that are compared stop at the
        same number of evaluations, those of parts included.
        """
        rows: list[Row] = []
        contests = []
        for which, config, evaluations in (
            ("paper's fitness", PAPER, PAPER_EVALUATIONS),
            ("default fitness", SimoodConfig(), EVALUATIONS),
        ):
            bred, drawn = (
                self._search(
                    f"A5 {propose}, {which}",
                    [
                        Search(
                            config=replace(config, propose=propose),
                            seed=first + seed,
                            evaluations=evaluations,
                        )
                        for seed in self._seeds
                    ],
                )
                for propose, first in (("ga", 0), ("random", CONTROL_SEED))
            )
            finalists, selected, pairs = (
                self._unsafe_shares(
                    f"A5 {part}, {which}", [list(map(self._named, found)) for found in rows_of]
                )
                for part, rows_of in (
                    ("finalists", [finalists_of(state) for state in bred]),
                    ("finalists of random search", [finalists_of(state) for state in drawn]),
                    ("random pairs", [state.individuals[: config.finalists] for state in drawn]),
                )
            )
            rows.append(_fitness_row(which, bred, drawn))
            contests += [
                Contest(f"finalists against random pairs, {which}", finalists, pairs),
                Contest(f"finalists against finalists of random search, {which}", finalists, selected),
            ]
        # Both fitnesses have the same random pairs.
        return [*rows, *hazard_rows(contests), random_pairs_row(pairs)]

    def _unsafe_shares(self, part: str, searches: Sequence[Sequence[NamedChain]]) -> Shares:
        """Simulate the chains of several searches; return the share of streets in which each is unsafe."""
        distinct = list(dict.fromkeys(chain for chains in searches for chain in chains))
        found = self._run_chains(part, distinct, CONFIRMATION_PLACES)
        shares = {chain: sum(r.unsafe for r in records) / len(records) for chain, records in found.items()}
        return [{chain: shares[chain] for chain in chains} for chains in searches]

    def tables(self) -> list[Row]:
        """Measure A6: tables II and III, and Fig. 4, with the paper's fitness and grids."""
        by_size = self._table_by_size()
        by_omega = self._table_by_omega()
        draw_omega(by_omega, self._folder / "omega.png")
        intensity_drop = by_omega[0]["mean_intensity"] - by_omega[-1]["mean_intensity"]
        (usual,) = [row for row in by_size if (row["generations"], row["population"]) == (20, 20)]
        note = f"{len(self._repeats)} searches each; {self._folder / 'generations-population.csv'}"
        genes, hazards = (
            f"{usual[f'{name}_mean']:g} ± {usual[f'{name}_sd']:g}, {usual[f'{name}_min']:g} to "
            f"{usual[f'{name}_max']:g}"
            for name in ("unique_genes", "hazards")
        )
        return [
            Row(
                what="A6 unique genes, 20 generations, population 20",
                value=usual["unique_genes_mean"],
                target="",
                met=None,
                note=f"{genes}; {note}",
            ),
            Row(
                what="A6 hazards, 20 generations, population 20",
                value=usual["hazards_mean"],
                target="",
                met=None,
                note=f"{hazards}, of 20 simulated in one street; {note}",
            ),
            Row(
                what=f"A6 mean intensity at omega {OMEGAS[0]:g} minus that at {OMEGAS[-1]:g}",
                value=intensity_drop,
                target="above 0",
                met=intensity_drop > 0,
                note=f"{self._folder / 'omega.png'}",
            ),
        ]

    def _table_by_size(self) -> list[dict[str, Any]]:
        """Simulate the whole last population of each search once, as the paper does, and tabulate its hazards."""
        sizes = [(generations, population) for generations in GENERATIONS for population in POPULATIONS]
        runs = [(g, n, seed) for g, n in sizes for seed in self._repeats]
        states = self._search(
            "A6 generations x population",
            [
                Search(config=replace(PAPER, generations=g, population_size=n), seed=seed)
                for g, n, seed in runs
            ],
        )
        last = [[self._named(state.individuals[place]) for place in state.population] for state in states]
        simulated = self._run_chains(
            "A6 last populations", list(dict.fromkeys(chain for chains in last for chain in chains)), range(1)
        )
        each: list[dict[str, Any]] = [
            {
                "generations": g,
                "population": n,
                "seed": seed,
                "evaluated": len(state.individuals),
                "unique_genes": unique_genes(chains),
                "mean_f": round(float(np.mean(state.fitness)), 4),
                "hazards": sum(simulated[chain][0].unsafe for chain in chains),
                "simulated": len(chains),
            }
            for (g, n, seed), state, chains in zip(runs, states, last, strict=True)
        ]
        self._write("generations-population-runs.csv", each)
        rows = [_tabulated(g, n, each) for g, n in sizes]
        self._write("generations-population.csv", rows)
        return rows

    def _table_by_omega(self) -> list[dict[str, Any]]:
        searches = [
            Search(config=replace(PAPER, omega=w), seed=seed) for w in OMEGAS for seed in self._repeats
        ]
        by_omega = self._search("A6 omega", searches)
        rows: list[dict[str, Any]] = []
        for index, omega in enumerate(OMEGAS):
            states = by_omega[index * len(self._repeats) : (index + 1) * len(self._repeats)]
            last = [[self._named(state.individuals[place]) for place in state.population] for state in states]
            orders = [len({tuple(gene for gene, _ in chain) for chain in chains}) for chains in last]
            etas = [self._genome.eta(state.individuals[list(state.population)]) for state in states]
            alphas = [state.alphas[place] for state in states for place in state.population]
            rows.append(
                {
                    "omega": omega,
                    "unique_individuals": len({chain for chains in last for chain in chains}),
                    "unique_orders": round(statistics.fmean(orders), 2),
                    "mean_intensity": round(float(np.mean(np.concatenate(etas))), 4),
                    "mean_alpha": round(float(np.mean(alphas)), 4),
                }
            )
        self._write("omega.csv", rows)
        return rows

    def interactions(self) -> list[Row]:
        """Measure A9: how many explained finalists are hazardous only together or only in one order.

        All campaigns stop at the same number of evaluations, those of parts included. Random search with the default
        fitness shows what breeding adds. The same drives decide which finalists are explained and which are
        hazardous, so the share of hazardous ones among the explained says little; the share that is hazardous by
        interaction is what counts.
        """
        rows, table = [], []
        for which, config, first in (
            ("default fitness", SimoodConfig(), 0),
            ("fitness with a margin", WITH_MARGIN, 0),
            ("paper's fitness", PAPER, 0),
            (
                "random search with the default fitness",
                replace(SimoodConfig(), propose="random"),
                CONTROL_SEED,
            ),
        ):
            confirmed = replace(config, repeats=len(CONFIRMATION_PLACES))
            seeds = range(first, first + len(self._repeats))
            campaigns = self._campaigns(f"A9 {which}", confirmed, seeds, EVALUATIONS)
            rows += interaction_rows(
                which,
                campaigns,
                MIN_SHARE_BY_INTERACTION if config == SimoodConfig() else None,
                f"{self._folder / 'explained.csv'}",
            )
            table += [
                self._explained_row(which, seed, campaign, one)
                for seed, campaign in zip(seeds, campaigns, strict=True)
                for one in campaign.explained
            ]
        if table:
            self._write("explained.csv", table)
        return rows

    def default_campaign(self) -> Campaign:
        """Return a campaign with the default settings, its explanation included."""
        (found,) = self._campaigns("A7 a default campaign", SimoodConfig(), range(1))
        return found

    def _campaigns(
        self, part: str, config: SimoodConfig, seeds: range, evaluations: int | None = None
    ) -> list[Campaign]:
        """Run campaigns to their end."""
        searches = [Search(config=config, seed=seed, evaluations=evaluations) for seed in seeds]
        space, campaigns = self._places.problem.space, []
        for state in self._search(part, searches, tuple(Stage)):
            chains = {self._genome.chain(row) for row in explained_of(state)}
            found = combinations(verdicts_by_chain(space, state.archive))
            campaigns.append(Campaign(state=state, explained=[one for one in found if one.chain in chains]))
        return campaigns

    def _explained_row(self, which: str, seed: int, campaign: Campaign, one: Combination) -> dict[str, Any]:
        """Return an explained finalist as a row of a table; unknown added harm is empty."""
        state = campaign.state
        (place,) = [
            place for place, row in enumerate(state.individuals) if self._genome.chain(row) == one.chain
        ]
        added_harm = float(state.added_harms[place])
        return {
            "search": which,
            "seed": seed,
            "chain": words_of(self._named(state.individuals[place])),
            "alpha": round(float(state.alphas[place]), 4),
            "added_harm": "" if np.isnan(added_harm) else round(added_harm, 4),
            "hazardous": f"{one.tally.unsafe} of {one.tally.trials}",
            "parts": ", ".join(f"{part.unsafe} of {part.trials}" for part in one.parts.values()),
            "other_order": ", ".join(f"{order.unsafe} of {order.trials}" for order in one.orders.values()),
            "only_together": one.only_together,
            "only_in_one_order": one.order_matters,
        }

    def _search(
        self, part: str, searches: Sequence[Search], stages: Sequence[Stage] = (Stage.SEARCH, Stage.PARTS)
    ) -> list[SimoodState]:
        """Run searches until they have finished some stages; return their states."""
        total = sum(search.limit for search in searches)
        for search in searches:
            search.start(self._places.problem.space)
        while True:
            asked = []
            for search in searches:
                assert search.state is not None
                if search.state.stage in stages and not _SIMOOD.finished(search.state):
                    asked.append((search, *_SIMOOD.ask(search.state)))
            if not asked:
                break
            specs = [self._spec(candidate) for _, _, candidates in asked for candidate in candidates]
            records = iter(self._records.run(specs))
            for search, state, candidates in asked:
                search.state = _SIMOOD.tell(state, {c.number: _answer(c, next(records)) for c in candidates})
            done = (len(search.state.individuals) for search in searches if search.state is not None)
            self._progress(part, min(total, sum(done)), total)
        self._progress(part, total, total)
        return [search.state for search in searches if search.state is not None]

    def _spec(self, candidate: Candidate) -> EpisodeSpec:
        """Return the evaluation of a candidate, or its episode in a numbered street that all searches share."""
        chain = self._named(candidate.vectors[self._genome.index])
        if candidate.question is Question.DATASET:
            return self._places.evaluation(chain)
        return self._places.episode(CONFIRMATION_PLACES[candidate.seed_number or 0], chain)

    def _named(self, individual: FloatArray) -> NamedChain:
        """Return the chain of an individual; empty slots are genes at level 0."""
        problem = self._places.problem
        vectors = [
            individual if component.name == "perturbation" else np.zeros(component.dimension)
            for component in problem.space.components
        ]
        return tuple((str(p["gene"]), int(str(p["level"]))) for p in problem.perturbations(vectors))


def _tabulated(generations: int, population: int, runs: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return a cell of tables II and III: the spread of a count over its runs."""
    cell = [run for run in runs if (run["generations"], run["population"]) == (generations, population)]
    row: dict[str, Any] = {"generations": generations, "population": population, "searches": len(cell)}
    for name in ("unique_genes", "hazards", "mean_f"):
        spread = spread_of([run[name] for run in cell])
        for part, value in zip(("mean", "sd", "min", "max"), spread, strict=True):
            row[f"{name}_{part}"] = round(value, 4)
    return row


def _answer(candidate: Candidate, record: Record) -> Evaluation:
    if candidate.question is Question.DATASET:
        return Measured(objectives=record.objectives)
    return Scored(
        unsafe=record.unsafe, robustness=min(record.robustness.values()), objectives=record.objectives
    )


def _fitness_row(which: str, bred: Sequence[SimoodState], drawn: Sequence[SimoodState]) -> Row:
    fitness = [[float(np.mean(state.fitness)) for state in states] for states in (bred, drawn)]
    means = [statistics.fmean(values) for values in fitness]
    tested = compared(*fitness)
    spent = " and ".join(
        f"{statistics.fmean(evaluations_of(state) for state in states):.1f}" for states in (bred, drawn)
    )
    return Row(
        what=f"A5 mean f of the GA minus that of random search, {which}",
        value=means[0] - means[1],
        target="below 0, p < .05",
        met=means[0] < means[1] and is_significant(tested.p_value, SIGNIFICANCE_LEVEL),
        note=f"{means[0]:.3f} and {means[1]:.3f}; Mann-Whitney p {p_text(tested.p_value)}, {len(bred)} seeds, "
        f"{spent} evaluations a search, those of parts included",
    )


def random_pairs_row(pairs: Shares) -> Row:
    """Return how many distinct random pairs are hazardous."""
    shares = list({chain: share for search in pairs for chain, share in search.items()}.values())
    hazardous = sum(share >= HAZARDOUS for share in shares)
    return at_most(
        "A5 share of hazardous random pairs",
        hazardous / len(shares),
        MAX_HAZARDOUS_RANDOM_PAIRS,
        f"{share_words(hazardous, len(shares))}, unsafe in {HAZARDOUS:.0%} of {len(CONFIRMATION_PLACES)} streets",
    )


def interaction_rows(which: str, campaigns: Sequence[Campaign], least: float | None, table: str) -> list[Row]:
    """Return the rows of A9 for one kind of campaign.

    Args:
        which: The kind of campaign, in words.
        campaigns: The campaigns.
        least: Smallest share of explained finalists that are hazardous only together or in one order; None without
            a target.
        table: Name of the file with the explained finalists.
    """
    explained = sum(len(one.explained) for one in campaigns)
    hazardous = sum(one.hazardous for one in campaigns)
    found = sum(one.by_interaction for one in campaigns)
    finalists = sum(len(finalists_of(one.state)) for one in campaigns)
    spent = statistics.fmean(one.measured for one in campaigns)
    note = (
        f"{share_words(found, explained)} explained: unsafe in at least one street; of {finalists} finalists of "
        f"{len(campaigns)} campaigns of {spent:.1f} evaluations; {table}"
    )
    what = f"A9 share of explained finalists hazardous only together or in one order, {which}"
    share = found / explained if explained else 0.0
    return [
        Row(what=what, value=share, target="", met=None, note=note)
        if least is None
        else at_least(what, share, least, note),
        Row(
            what=f"A9 share of hazardous ones that are so only together or in one order, {which}",
            value=found / hazardous if hazardous else 0.0,
            target="",
            met=None,
            note=f"{share_words(found, hazardous)} hazardous: unsafe in {HAZARDOUS:.0%} of "
            f"{len(CONFIRMATION_PLACES)} streets",
        ),
    ]
