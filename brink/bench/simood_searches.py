"""The SiMOOD criteria A5, A6 and A9: searches on the data set, and what their finalists owe to interaction.

Every search is one of `simood-ga@1` itself, without a coordinator; its individuals are evaluated as in a campaign.
Finalists of all searches are simulated in the same streets, so that criteria share episodes.
"""

import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from scipy import stats

from brink.bench.measurement import Progress, Row, at_least
from brink.bench.simood_places import REPEATS, Criteria, NamedChain, words_of
from brink.bench.trials import Records
from brink.search.algorithm import Evaluation, Measured
from brink.search.algorithms.simood import Simood, SimoodConfig, SimoodState, Stage, finalists_of
from brink.search.analysis.combinations import HAZARDOUS, Combination, Verdict, combinations
from brink.search.analysis.statistics import compared
from brink.search.slots import Chain, ChainGenome
from brink.search.space import FloatArray
from brink.server.problems.aeb_crossing import AebCrossingParams
from brink.sim.perturbations import CATALOGUE

SEEDS: Final = range(10)
GENERATIONS: Final = (10, 20, 30, 50)
POPULATIONS: Final = (10, 20, 30, 50)
OMEGAS: Final = (0.01, 0.1, 0.25, 0.5, 0.66, 0.75, 0.99)
"""The grids of the paper's tables II and III and of its Fig. 4, as in the authors' published code."""
SIGNIFICANCE_LEVEL: Final = 0.05
BUDGET: Final = 100_000
MIN_SHARE_BY_INTERACTION: Final = 1 / 3
PAPER: Final = replace(SimoodConfig(), interaction="none")
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
    """Return how likely chance alone makes as many chains hazardous in a first group, by Fisher's exact test.

    The unit is the chain: its streets share its perturbations and are not independent.

    Args:
        first: Share of the streets in which each chain of the first group is hazardous.
        second: The same for the second group.
    """
    table = np.array([
        [sum(share >= HAZARDOUS for share in group), sum(share < HAZARDOUS for share in group)]
        for group in (first, second)
    ])  # fmt: skip
    return float(stats.fisher_exact(table, alternative="greater")[1])


@dataclass(frozen=True, slots=True, kw_only=True)
class Campaign:
    """A whole campaign: its search, the simulation of its finalists, and their explanation.

    Attributes:
        state: The search, when it was over.
        finalists: The finalists, best first.
        explained: The explained finalists beside their parts and other orders.
        episodes: Number of episodes, those of the explanation included.
    """

    state: SimoodState
    finalists: list[NamedChain]
    explained: list[Combination]
    episodes: int

    @property
    def measured(self) -> int:
        """Number of evaluations on the data set."""
        return len(self.state.individuals) + len(self.state.parts)

    @property
    def by_interaction(self) -> int:
        """Number of explained finalists that are hazardous only together or only in one order."""
        return sum(one.only_together or one.order_matters for one in self.explained)


@dataclass(slots=True, kw_only=True)
class Search:
    """A search on the data set; mutable.

    Attributes:
        config: Configuration of the algorithm.
        seed: Seed of the search.
        state: Current state; None before the start.
    """

    config: SimoodConfig
    seed: int
    state: SimoodState | None = None


class Searches(Criteria):
    """A5, A6 and A9: the genetic algorithm against random search, its results by configuration, and interaction.

    Searches advance together, one generation at a time, so that no process is idle.

    Args:
        records: Runs episodes and stores their outcomes.
        folder: Folder for tables and figures.
        progress: Progress callback.
        params: Parameters of the problem.
        repeats: Searches with each configuration, and campaigns.
    """

    def __init__(
        self, records: Records, folder: Path, progress: Progress, params: AebCrossingParams, *, repeats: int
    ) -> None:
        super().__init__(records, folder, progress, params)
        self._repeats = range(repeats)
        self._genome = ChainGenome.of(self._places.problem.space)

    def against_random(self) -> list[Row]:
        """Measure A5: the final mean fitness, and how often finalists and random pairs are hazardous.

        Both with the paper's fitness and with that of the default settings.
        """
        return [
            *self._against_random("paper's fitness", PAPER),
            *self._against_random("default fitness", SimoodConfig()),
        ]

    def _against_random(self, which: str, config: SimoodConfig) -> list[Row]:
        bred, drawn = (
            self._search(
                f"A5 {propose}, {which}",
                [Search(config=replace(config, propose=propose), seed=seed) for seed in SEEDS],
            )
            for propose in ("ga", "random")
        )
        fitness = [[float(np.mean(state.fitness)) for state in states] for states in (bred, drawn)]
        means = [float(np.mean(values)) for values in fitness]
        tested = compared(*fitness)
        finalists = [self._named(row) for state in bred for row in finalists_of(state)]
        pairs = [self._named(row) for state in drawn for row in state.individuals[: config.finalists]]
        shares = [
            self._hazardous_shares(f"A5 {part}, {which}", chains)
            for part, chains in (("finalists", finalists), ("random pairs", pairs))
        ]
        p_value = hazard_p_value(*shares)
        counts = " and ".join(
            f"{sum(share >= HAZARDOUS for share in group)} of {len(group)}" for group in shares
        )
        evaluations = " and ".join(
            str(sum(len(s.individuals) + len(s.parts) for s in states)) for states in (bred, drawn)
        )
        return [
            Row(
                what=f"A5 mean f of the GA minus that of random search, {which}", value=means[0] - means[1],
                target="below 0, p < .05", met=means[0] < means[1] and tested.p_value < SIGNIFICANCE_LEVEL,
                note=f"{means[0]:.3f} and {means[1]:.3f}; Mann-Whitney p {tested.p_value:.2g}, {len(SEEDS)} seeds, "
                f"{evaluations} evaluations",
            ),
            Row(
                what=f"A5 Fisher p of hazardous finalists against random pairs, {which}", value=p_value,
                target="below .05", met=p_value < SIGNIFICANCE_LEVEL,
                note=f"distinct chains, hazardous in {HAZARDOUS:.0%} of {len(REPEATS)} streets: {counts}",
            ),
        ]  # fmt: skip

    def _hazardous_shares(self, part: str, chains: Sequence[NamedChain]) -> list[float]:
        """Return the share of streets in which each distinct chain is hazardous."""
        found = self._run_chains(part, list(dict.fromkeys(chains)), REPEATS)
        return [sum(record.unsafe for record in records) / len(records) for records in found.values()]

    def tables(self) -> list[Row]:
        """Measure A6: tables II and III, and Fig. 4, with the paper's fitness and grids."""
        by_size = self._table_by_size()
        by_omega = self._table_by_omega()
        self._draw(by_omega)
        falls_by = by_omega[0]["mean_intensity"] - by_omega[-1]["mean_intensity"]
        (usual,) = [row for row in by_size if (row["generations"], row["population"]) == (20, 20)]
        note = f"{len(self._repeats)} searches each; {self._folder / 'generations-population.csv'}"
        genes, hazards = (
            f"{usual[f'{name}_mean']:g} ± {usual[f'{name}_sd']:g}, {usual[f'{name}_min']:g} to "
            f"{usual[f'{name}_max']:g}"
            for name in ("unique_genes", "hazards")
        )
        return [
            Row(
                what="A6 unique genes, 20 generations, population 20", value=usual["unique_genes_mean"], target="",
                met=None, note=f"{genes}; {note}",
            ),
            at_least(
                "A6 hazards, 20 generations, population 20", usual["hazards_mean"], 1,
                f"{hazards}, of 20 simulated in one street; {note}",
            ),
            Row(
                what=f"A6 mean intensity at omega {OMEGAS[0]:g} minus that at {OMEGAS[-1]:g}", value=falls_by,
                target="above 0", met=falls_by > 0, note=f"{self._folder / 'omega.png'}",
            ),
        ]  # fmt: skip

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
                "generations": g, "population": n, "seed": seed, "evaluated": len(state.individuals),
                "unique_genes": unique_genes(chains), "mean_f": round(float(np.mean(state.fitness)), 4),
                "hazards": sum(simulated[chain][0].unsafe for chain in chains), "simulated": len(chains),
            }
            for (g, n, seed), state, chains in zip(runs, states, last, strict=True)
        ]  # fmt: skip
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
            unique = {self._named(state.individuals[place]) for state in states for place in state.population}
            levels = [level / (CATALOGUE[gene].levels - 1) for chain in unique for gene, level in chain]
            alphas = [state.alphas[place] for state in states for place in state.population]
            rows.append({
                "omega": omega, "unique_individuals": len(unique),
                "unique_orders": len({tuple(gene for gene, _ in chain) for chain in unique}),
                "mean_intensity": round(float(np.mean(levels)), 4), "mean_alpha": round(float(np.mean(alphas)), 4),
            })  # fmt: skip
        self._write("omega.csv", rows)
        return rows

    def interactions(self) -> list[Row]:
        """Measure A9: how many explained finalists are hazardous only together or only in one order."""
        rows, table = [], []
        for which, config in (("default", SimoodConfig()), ("paper's fitness", PAPER)):
            campaigns = self._campaigns(f"A9 {which}", config, self._repeats)
            explained = sum(len(one.explained) for one in campaigns)
            found = sum(one.by_interaction for one in campaigns)
            note = (
                f"{found} of {explained} explained, of {sum(len(one.finalists) for one in campaigns)} finalists of "
                f"{len(campaigns)} campaigns; {self._folder / 'explained.csv'}"
            )
            what = f"A9 share hazardous only together or in one order, {which}"
            share = found / explained if explained else 0.0
            if config is PAPER:
                rows.append(Row(what=what, value=share, target="", met=None, note=note))
            else:
                rows.append(at_least(what, share, MIN_SHARE_BY_INTERACTION, note))
            table += [
                self._explained_row(config.interaction, seed, campaign, one)
                for seed, campaign in zip(self._repeats, campaigns, strict=True)
                for one in campaign.explained
            ]
        if table:
            self._write("explained.csv", table)
        return rows

    def default_campaign(self) -> Campaign:
        """Return a campaign with the default settings, its explanation included."""
        (found,) = self._campaigns("A7 a default campaign", SimoodConfig(), range(1))
        return found

    def _campaigns(self, part: str, config: SimoodConfig, seeds: range) -> list[Campaign]:
        """Search, simulate the finalists, and explain the hazardous ones, as campaigns do."""
        states = self._search(part, [Search(config=config, seed=seed) for seed in seeds])
        finalists = [list(finalists_of(state)) for state in states]
        found = [self._verdicts(f"{part}, finalists", rows) for rows in finalists]
        explained = [
            [row for row in rows if any(v.unsafe for v in verdicts[self._genome.chain(row)].values())]
            for rows, verdicts in zip(finalists, found, strict=True)
        ]
        campaigns = []
        for state, rows, verdicts, hazardous in zip(states, finalists, found, explained, strict=True):
            chosen = hazardous[: config.explained]
            variants = [variant for row in chosen for variant in self._genome.ablations(row)]
            verdicts = {**self._verdicts(f"{part}, explanation", variants), **verdicts}
            chains = {self._genome.chain(row) for row in chosen}
            campaigns.append(
                Campaign(
                    state=state,
                    finalists=[self._named(row) for row in rows],
                    explained=[one for one in combinations(verdicts) if one.chain in chains],
                    episodes=len({self._named(row) for row in (*rows, *variants)}) * len(REPEATS),
                )
            )
        return campaigns

    def _verdicts(self, part: str, rows: Sequence[FloatArray]) -> dict[Chain, dict[bytes, Verdict]]:
        """Simulate individuals in every street; return the verdicts by chain and street."""
        named = {self._named(row): self._genome.chain(row) for row in rows}
        return {
            named[name]: {str(place).encode(): Verdict(place, record.unsafe) for place, record in enumerate(records)}
            for name, records in self._run_chains(part, list(named), REPEATS).items()
        }  # fmt: skip

    def _explained_row(
        self, interaction: str, seed: int, campaign: Campaign, one: Combination
    ) -> dict[str, Any]:
        """Return an explained finalist as a row of a table; unknown added_harms are empty."""
        state = campaign.state
        (place,) = [
            place for place, row in enumerate(state.individuals) if self._genome.chain(row) == one.chain
        ]
        added_harm = float(state.added_harms[place])
        return {
            "interaction": interaction, "seed": seed, "chain": words_of(self._named(state.individuals[place])),
            "alpha": round(float(state.alphas[place]), 4),
            "added_harm": "" if np.isnan(added_harm) else round(added_harm, 4),
            "hazardous": f"{one.tally.unsafe} of {one.tally.trials}",
            "parts": ", ".join(f"{part.unsafe} of {part.trials}" for part in one.parts.values()),
            "other_order": ", ".join(f"{order.unsafe} of {order.trials}" for order in one.orders.values()),
            "only_together": one.only_together, "only_in_one_order": one.order_matters,
        }  # fmt: skip

    def _search(self, part: str, searches: Sequence[Search]) -> list[SimoodState]:
        """Run searches until they have finished with the data set; return their states."""
        space = self._places.problem.space
        total = sum(s.config.population_size + s.config.parents * s.config.generations for s in searches)
        for search in searches:
            search.state = _SIMOOD.start(space, search.config, seed=search.seed, budget=BUDGET)
        while True:
            asked = []
            for search in searches:
                assert search.state is not None
                if search.state.stage in (Stage.SEARCH, Stage.PARTS):
                    state, candidates = _SIMOOD.ask(search.state)
                    asked.append((search, state, candidates))
            if not asked:
                break
            chains = [self._named(c.vectors[-1]) for _, _, candidates in asked for c in candidates]
            records = iter(self._records.run([self._places.evaluation(chain) for chain in chains]))
            for search, state, candidates in asked:
                answers: dict[int, Evaluation] = {
                    c.number: Measured(objectives=next(records).objectives) for c in candidates
                }
                search.state = _SIMOOD.tell(state, answers)
            self._progress(
                part, sum(len(s.state.individuals) for s in searches if s.state is not None), total
            )
        self._progress(part, total, total)
        return [search.state for search in searches if search.state is not None]

    def _named(self, individual: FloatArray) -> NamedChain:
        """Return the chain of an individual; empty slots are genes at level 0."""
        problem = self._places.problem
        vectors = [
            individual if component.name == "perturbation" else np.zeros(component.dimension)
            for component in problem.space.components
        ]
        return tuple((str(p["gene"]), int(str(p["level"]))) for p in problem.perturbations(vectors))

    def _draw(self, rows: Sequence[Mapping[str, Any]]) -> None:
        # Imported here: matplotlib takes half a second to load.
        from matplotlib.figure import Figure

        figure = Figure(figsize=(7, 3.6), layout="constrained")
        left, right = figure.subplots(1, 2)
        omegas, unique, intensities, alphas = (
            [row[name] for row in rows]
            for name in ("omega", "unique_individuals", "mean_intensity", "mean_alpha")
        )
        left.bar(omegas, unique, width=0.18, color="#0072b2")
        left.set(xlabel="omega", ylabel="unique individuals in the last population")
        right.plot(omegas, intensities, "o-", color="#0072b2", label="mean intensity")
        right.plot(omegas, alphas, "s--", color="#d55e00", label="mean alpha (mAP)")
        right.set(xlabel="omega", ylim=(0, 1))
        right.legend(frameon=False)
        for axes in (left, right):
            axes.spines[["top", "right"]].set_visible(False)
            axes.set_xticks(omegas)
        figure.savefig(self._folder / "omega.png", dpi=120)


def _tabulated(generations: int, population: int, runs: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return a cell of tables II and III: the spread of what was counted over its runs."""
    cell = [run for run in runs if (run["generations"], run["population"]) == (generations, population)]
    row: dict[str, Any] = {"generations": generations, "population": population, "searches": len(cell)}
    for name in ("unique_genes", "hazards", "mean_f"):
        spread = spread_of([run[name] for run in cell])
        for part, value in zip(("mean", "sd", "min", "max"), spread, strict=True):
            row[f"{name}_{part}"] = round(value, 4)
    return row
