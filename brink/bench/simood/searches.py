"""A5 and A6: the genetic algorithm against random search, what it finds by generations, population and omega."""

import csv
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy import stats

from brink.bench.figures import Row
from brink.bench.simood.places import Chain, Places
from brink.bench.telling import Told
from brink.bench.trials import Records
from brink.search.algorithm import Evaluation, Measured
from brink.search.algorithms.simood import Simood, SimoodConfig, SimoodState, Stage, finalists_of
from brink.search.analysis.statistics import compared
from brink.sim.perturbations import CATALOGUE

SEEDS: Final = range(10)
REPEATS: Final = range(3)
GENERATIONS: Final = (5, 10, 20)
POPULATIONS: Final = (10, 20)
OMEGAS: Final = (0.0, 0.25, 0.5, 0.75, 1.0)
SIGNIFICANT: Final = 0.05
BUDGET: Final = 10_000
_SIMOOD: Final = Simood()


@dataclass(slots=True, kw_only=True)
class Search:
    """One search on data. Changes in place.

    Attributes:
        config: Its settings.
        seed: Its seed.
        state: Where it stands.
    """

    config: SimoodConfig
    seed: int
    state: SimoodState | None = None


class Searches:
    """Runs searches on data side by side, so that every process has something to do.

    Args:
        records: Runs specifications and keeps what came out.
        folder: Where tables and figures go.
        told: Told how far it is.
    """

    def __init__(self, records: Records, folder: Path, told: Told) -> None:
        self._records = records
        self._folder = folder
        self._told = told
        self._places = Places()

    def against_random(self) -> list[Row]:
        """A5: the final mean fitness, and how often finalists and random pairs are hazardous."""
        bred, drawn = (
            self._run(
                f"A5 {propose}",
                [Search(config=replace(SimoodConfig(), propose=propose), seed=seed) for seed in SEEDS],
            )
            for propose in ("ga", "random")
        )
        fitness = [[float(np.mean(state.fitness)) for state in states] for states in (bred, drawn)]
        tested = compared(*fitness)
        better = float(np.mean(fitness[0])) < float(np.mean(fitness[1])) and tested.p_value < SIGNIFICANT
        finalists = [self._chain(row) for state in bred for row in finalists_of(state)]
        pairs = [self._chain(row) for state in drawn for row in state.individuals[: state.config.finalists]]
        hazards = [
            self._hazards(f"A5 {what}", chains)
            for what, chains in (("finalists", finalists), ("random pairs", pairs))
        ]
        table = np.array([[count, total - count] for count, total in hazards])
        p_value = float(stats.fisher_exact(table, alternative="greater")[1])
        said = [f"{count} of {total}" for count, total in hazards]
        return [
            Row(
                what="A5 mean f of the GA less that of random search",
                value=float(np.mean(fitness[0]) - np.mean(fitness[1])), target="below 0, p < .05", met=better,
                note=f"{np.mean(fitness[0]):.3f} and {np.mean(fitness[1]):.3f}; Mann-Whitney p {tested.p_value:.2g}, "
                f"{len(SEEDS)} seeds",
            ),
            Row(
                what="A5 Fisher p of hazards of finalists against random pairs", value=p_value, target="below .05",
                met=p_value < SIGNIFICANT, note=f"hazardous {said[0]} and {said[1]}",
            ),
        ]  # fmt: skip

    def tables(self) -> list[Row]:
        """A6: unique techniques and hazards by generations and population; unique individuals by omega."""
        grid = [(g, n) for g in GENERATIONS for n in POPULATIONS]
        states = self._run(
            "A6 generations x population",
            [
                Search(config=replace(SimoodConfig(), generations=g, population_size=n), seed=0)
                for g, n in grid
            ],
        )
        rows: list[dict[str, Any]] = []
        for (g, n), state in zip(grid, states, strict=True):
            finalists = [self._chain(row) for row in finalists_of(state)]
            unsafe, total = self._hazards(f"A6 finalists g {g} n {n}", finalists)
            rows.append({
                "generations": g, "population": n, "evaluated": len(state.individuals),
                "unique_genes": len({gene for place in state.population
                                     for gene, _ in self._chain(state.individuals[place])}),
                "mean_f": round(float(np.mean(state.fitness)), 4), "hazards": unsafe, "simulated": total,
            })  # fmt: skip
        self._write("generations-population.csv", rows)
        by_omega = self._run(
            "A6 omega",
            [Search(config=replace(SimoodConfig(), omega=w), seed=seed) for w in OMEGAS for seed in REPEATS],
        )
        found: list[dict[str, Any]] = []
        for index, omega in enumerate(OMEGAS):
            states = by_omega[index * len(REPEATS) : (index + 1) * len(REPEATS)]
            kept = {self._chain(state.individuals[place]) for state in states for place in state.population}
            levels = [level / (CATALOGUE[gene].levels - 1) for chain in kept for gene, level in chain]
            alphas = [state.alphas[place] for state in states for place in state.population]
            found.append({
                "omega": omega, "unique_individuals": len(kept), "mean_intensity": round(float(np.mean(levels)), 4),
                "mean_alpha": round(float(np.mean(alphas)), 4),
            })  # fmt: skip
        self._write("omega.csv", found)
        self._draw(found)
        hazards = sum(row["hazards"] for row in rows)
        falls = found[0]["mean_intensity"] > found[-1]["mean_intensity"]
        return [
            Row(
                what="A6 hazards in the table of generations and population", value=hazards, target="at least 1",
                met=hazards > 0, note=f"{sum(row['simulated'] for row in rows)} simulated; "
                f"{self._folder / 'generations-population.csv'}",
            ),
            Row(
                what="A6 mean intensity at omega 0 less that at omega 1",
                value=found[0]["mean_intensity"] - found[-1]["mean_intensity"], target="above 0", met=falls,
                note=f"{self._folder / 'omega.png'}",
            ),
        ]  # fmt: skip

    def _run(self, what: str, searches: Sequence[Search]) -> list[SimoodState]:
        """Run searches to the end of their search on data; return their states."""
        space = self._places.problem.space
        total = sum(s.config.population_size + s.config.parents * s.config.generations for s in searches)
        for search in searches:
            search.state = _SIMOOD.start(space, search.config, seed=search.seed, budget=BUDGET)
        while True:
            asked = []
            for search in searches:
                assert search.state is not None
                if search.state.stage is Stage.SEARCH:
                    state, candidates = _SIMOOD.ask(search.state)
                    asked.append((search, state, candidates))
            if not asked:
                break
            chains = [self._chain(c.vectors[-1]) for _, _, candidates in asked for c in candidates]
            records = iter(self._records.run([self._places.evaluation(chain) for chain in chains]))
            for search, state, candidates in asked:
                answers: dict[int, Evaluation] = {
                    c.number: Measured(objectives=next(records).objectives) for c in candidates
                }
                search.state = _SIMOOD.tell(state, answers)
            self._told(what, sum(len(s.state.individuals) for s in searches if s.state is not None), total)
        self._told(what, total, total)
        return [search.state for search in searches if search.state is not None]

    def _chain(self, individual: np.ndarray[Any, Any]) -> Chain:
        problem = self._places.problem
        vectors = [
            individual if component.name == "perturbation" else np.zeros(component.dimension)
            for component in problem.space.components
        ]
        return tuple((str(p["gene"]), int(str(p["level"]))) for p in problem.perturbations(vectors))

    def _hazards(self, what: str, chains: Sequence[Chain]) -> tuple[int, int]:
        specs = [self._places.episode(place, chain) for chain in chains for place in REPEATS]
        records = self._records.run(specs, lambda done, total: self._told(what, done, total))
        return sum(record.unsafe for record in records), len(records)

    def _write(self, name: str, rows: Sequence[dict[str, Any]]) -> None:
        with (self._folder / name).open("w", encoding="utf-8", newline="") as file:
            writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)

    def _draw(self, found: Sequence[dict[str, Any]]) -> None:
        # matplotlib takes half a second to load: only this needs it.
        from matplotlib.figure import Figure

        figure = Figure(figsize=(7, 3.6), layout="constrained")
        left, right = figure.subplots(1, 2)
        omegas = [row["omega"] for row in found]
        left.bar(omegas, [row["unique_individuals"] for row in found], width=0.18, color="#0072b2")
        left.set(xlabel="omega", ylabel="unique individuals in the last population")
        right.plot(
            omegas, [row["mean_intensity"] for row in found], "o-", color="#0072b2", label="mean intensity"
        )
        right.plot(
            omegas, [row["mean_alpha"] for row in found], "s--", color="#d55e00", label="mean alpha (mAP)"
        )
        right.set(xlabel="omega", ylim=(0, 1))
        right.legend(frameon=False)
        for axes in (left, right):
            axes.spines[["top", "right"]].set_visible(False)
            axes.set_xticks(omegas)
        figure.savefig(self._folder / "omega.png", dpi=120)
