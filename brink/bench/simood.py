"""The SiMOOD criteria A0 to A8: a safe baseline, hazards of perturbations, searches on a data set, and their cost.

Outcomes of episodes are stored, and criteria share them.
"""

import contextlib
import csv
import itertools
import resource
import statistics
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, TypeAlias

import numpy as np
from scipy import stats

from brink.bench.measurement import Progress, Row, at_least, at_most
from brink.bench.trials import Record, Records, code_fingerprint, process_pool, run_record, single_threaded
from brink.search.algorithm import Evaluation, Measured
from brink.search.algorithms.simood import Simood, SimoodConfig, SimoodState, Stage, finalists_of
from brink.search.analysis.statistics import compared
from brink.search.space import FloatArray
from brink.search.streams import Stream, generator
from brink.server.problems.aeb_crossing import AebCrossing, AebCrossingParams
from brink.sim.episode import EpisodeSpec, Json
from brink.sim.perturbations import CATALOGUE

Chain: TypeAlias = tuple[tuple[str, int], ...]
"""Genes and their levels, in the order in which they are applied."""

CRITERIA: Final = ("A0", "A1", "A2", "A3", "A4", "A5", "A6", "A7", "A8")
CODE: Final = (
    "sim/aeb", "sim/bullet", "sim/perception", "sim/perturbations", "sim/rendering", "sim/requirements.py",
    "sim/world",
)  # fmt: skip
"""Code that determines the outcome of an episode; outcomes stored by other versions of the code are not used."""
ACCIDENT: Final = "no-collision@1"
DANGEROUS_STOP: Final = "no-dangerous-stop@1"

CLEAN_PLACES: Final = range(20)
SWEEP_PLACES: Final = range(3)
CONFIRMATION_PLACES: Final = range(5)
OBSTACLE_PLACES: Final = range(10)
MAX_SAFE_SHARE: Final = 0.2
"""A chain is safe if at most this share of places is hazardous, and hazardous if at most this share is safe."""

SEEDS: Final = range(10)
REPEATS: Final = range(3)
GENERATIONS: Final = (5, 10, 20)
POPULATIONS: Final = (10, 20)
OMEGAS: Final = (0.0, 0.25, 0.5, 0.75, 1.0)
SIGNIFICANCE_LEVEL: Final = 0.05
BUDGET: Final = 10_000

TARGET_SPEEDUP: Final = 10.0
MAX_EXTRA_TIME: Final = 0.20
MAX_EXTRA_MEMORY: Final = 0.05
TIMED_CHAINS: Final = 12
PICTURES: Final = (20, 60)
"""Sizes of the data set. They rank individuals much as 240 pictures do: their alphas correlate by .97 and .99."""
COST_PLACES: Final = range(2)
FRAMES_IN_8_S: Final = 80
MAX_CAMERA_EPISODE_S: Final = 0.9
FINALISTS: Final = 2
"""The paper's k: candidates that are simulated after a search on the data set."""
_SIMOOD: Final = Simood()


def measure_simood(criteria: Sequence[str], folder: Path, *, processes: int, progress: Progress) -> list[Row]:
    """Measure the given criteria. Outcomes of episodes are stored in the folder and reused.

    Args:
        criteria: Some of `CRITERIA`; A3 and A4 are one measurement.
        folder: Folder for tables, figures and outcomes.
        processes: Number of processes that run episodes.
        progress: Progress callback.
    """
    file = folder / f"records-{code_fingerprint(CODE)}.jsonl"
    with contextlib.closing(Records(file, processes=processes)) as records:
        hazards = Hazards(records, folder, progress)
        searches = Searches(records, folder, progress)
        costs = Costs(records, folder, progress)
        measures: Mapping[str, Callable[[], list[Row]]] = {
            "A0": hazards.baseline,
            "A1": hazards.catalogue,
            "A2": hazards.sweep,
            "A3": hazards.pairs,
            "A4": hazards.pairs,
            "A5": searches.against_random,
            "A6": searches.tables,
            "A7": costs.speedup,
            "A8": costs.perturbing,
        }
        chosen = dict.fromkeys(measures[name] for name in CRITERIA if name in criteria)
        return [row for measure in chosen for row in measure()]


class Places:
    """Reproducible random streets. The number of a place determines its scenario and the seed of its episodes.

    Args:
        params: Parameters of the problem: detector, picture size, obstacle.
    """

    def __init__(self, params: AebCrossingParams | None = None) -> None:
        self.problem = AebCrossing(params or AebCrossingParams())

    def episode(
        self, place: int, chain: Chain = (), *, mode: str = "detector", **options: Json
    ) -> EpisodeSpec:
        """Return an episode in a place.

        Args:
            place: Number of the place.
            chain: Perturbations of the camera pictures.
            mode: Mode of the detector's behaviour.
            options: Further options of the episode.
        """
        vectors = self.problem.space.sample(generator(0, Stream.FINALISTS, place))
        spec = self.problem.episode(vectors, place)
        behaviour: dict[str, Json] = {"mode": mode}
        if mode == "detector":
            behaviour = {**spec.behaviour, "perturbations": _steps(chain)}
        return replace(spec, behaviour=behaviour, options={**spec.options, **options})

    def evaluation(self, chain: Chain) -> EpisodeSpec:
        """Return the evaluation of a chain on the data set."""
        vectors = self.problem.space.sample(generator(0, Stream.FINALISTS, 0))
        spec = self.problem.dataset_evaluation(vectors)
        return replace(spec, behaviour={**spec.behaviour, "perturbations": _steps(chain)})


class _Criteria:
    """Base class of the measurements: runs episodes in the numbered streets of `Places` and writes tables.

    Args:
        records: Runs episodes and stores their outcomes.
        folder: Folder for tables and figures.
        progress: Progress callback.
    """

    def __init__(self, records: Records, folder: Path, progress: Progress) -> None:
        self._records = records
        self._folder = folder
        self._progress = progress
        self._places = Places()

    def _run(self, part: str, specs: Sequence[EpisodeSpec]) -> list[Record]:
        return self._records.run(specs, lambda done, total: self._progress(part, done, total))

    def _run_chains(
        self, part: str, chains: Sequence[Chain], places: Sequence[int]
    ) -> dict[Chain, list[Record]]:
        """Run every chain in every place."""
        specs = [self._places.episode(place, chain) for chain in chains for place in places]
        records = self._run(part, specs)
        width = len(places)
        return {chain: records[index * width : (index + 1) * width] for index, chain in enumerate(chains)}

    def _write(self, name: str, rows: Sequence[Mapping[str, Any]]) -> None:
        with (self._folder / name).open("w", encoding="utf-8", newline="") as file:
            writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)


class Hazards(_Criteria):
    """A0 to A4: a safe baseline, and hazards of single perturbations, pairs and orders."""

    def baseline(self) -> list[Row]:
        """Measure A0: clean drives are safe, and without braking every drive is an accident."""
        rows = []
        for mode in ("detector", "oracle"):
            records = self._run(
                f"A0 {mode}", [self._places.episode(place, mode=mode) for place in CLEAN_PLACES]
            )
            for what, name in (("accidents", ACCIDENT), ("dangerous stops", DANGEROUS_STOP)):
                count = _violations(records, name)
                rows.append(_equal(f"A0 {what}, {mode}", count, 0, f"{len(records)} clean places"))
        specs = [self._places.episode(place, mode="oracle", braking=False) for place in CLEAN_PLACES]
        off = self._run("A0 braking off", specs)
        count = _violations(off, ACCIDENT)
        return [*rows, _equal("A0 accidents, braking off", count, len(off), f"{len(off)} places")]

    def catalogue(self) -> list[Row]:
        """Measure A1: 15 genes with 175 levels. Unit tests check what each does to a picture."""
        levels = sum(gene.levels for gene in CATALOGUE.values())
        return [
            _equal("A1 genes", len(CATALOGUE), 15, ""),
            _equal("A1 levels", levels, 175, f"{len(_singles())} of them do something"),
        ]

    def sweep(self) -> list[Row]:
        """Measure A2: every gene at every level, alone, in three places; fallen trees and overturned vehicles."""
        singles = self._run_chains("A2 singles", _singles(), SWEEP_PLACES)
        self._write_sweep(singles)
        records = [record for of_chain in singles.values() for record in of_chain]
        note = f"{len(records)} episodes; table in {self._folder / 'singles.csv'}"
        rows = [
            at_least("A2 accidents of singles", _violations(records, ACCIDENT), 1, note),
            at_least("A2 dangerous stops of singles", _violations(records, DANGEROUS_STOP), 1, note),
        ]
        for obstacle in ("novelty", "anomaly"):
            places = Places(AebCrossingParams(obstacle=obstacle))
            records = self._run(f"A2 {obstacle}", [places.episode(place) for place in OBSTACLE_PLACES])
            count = sum(record.features["collided_with"] == obstacle for record in records)
            rows.append(at_least(f"A2 collisions with the {obstacle}", count, 1, f"{len(records)} places"))
        return rows

    def pairs(self) -> list[Row]:
        """Measure A3 and A4: hazardous pairs of safe perturbations, and pairs hazardous in only one order."""
        alone = _unsafe_shares(self._run_chains("A2 singles", _singles(), SWEEP_PLACES))
        steps = list(_harmless_levels(alone).items())
        ordered = list(itertools.permutations(steps, 2))
        screened = _unsafe_shares(self._run_chains("A3 pairs, one place", ordered, range(1)))
        promising = [chain for chain in screened if screened[chain] or screened[chain[::-1]]]
        together = _unsafe_shares(self._run_chains("A3 pairs, five places", promising, CONFIRMATION_PLACES))
        parts = _unsafe_shares(
            self._run_chains("A3 their parts", [(step,) for step in steps], CONFIRMATION_PLACES)
        )
        hazardous = [chain for chain, share in together.items() if share >= 1 - MAX_SAFE_SHARE]
        only_together = [
            chain for chain in hazardous if all(parts[(step,)] <= MAX_SAFE_SHARE for step in chain)
        ]
        in_one_order = [chain for chain in hazardous if together.get(chain[::-1], 1.0) <= MAX_SAFE_SHARE]
        self._write_pairs(together, parts)
        note = f"{len(ordered)} ordered pairs of harmless levels, {len(promising)} of them in five places"
        return [
            at_least(what, len(chains), 1, f"{_words(chains[0])}; of {note}" if chains else f"of {note}")
            for what, chains in (
                ("A3 pairs hazardous only together", only_together),
                ("A4 pairs hazardous in one order", in_one_order),
            )
        ]

    def _write_sweep(self, singles: Mapping[Chain, Sequence[Record]]) -> None:
        rows = []
        for ((gene, level),), records in singles.items():
            alphas = [record.objectives["alpha"] for record in records if "alpha" in record.objectives]
            rows.append({
                "gene": gene, "level": level, "places": len(records), "accidents": _violations(records, ACCIDENT),
                "dangerous_stops": _violations(records, DANGEROUS_STOP),
                "mean_alpha": round(sum(alphas) / max(1, len(alphas)), 4),
            })  # fmt: skip
        self._write("singles.csv", rows)

    def _write_pairs(self, together: Mapping[Chain, float], parts: Mapping[Chain, float]) -> None:
        with (self._folder / "pairs.csv").open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(
                ["first", "second", "hazardous_share", "first_alone", "second_alone", "other_order"]
            )
            for chain, share in sorted(together.items(), key=lambda item: -item[1]):
                first, second = ((step,) for step in chain)
                other = together.get(chain[::-1])
                writer.writerow([_words(first), _words(second), share, parts[first], parts[second], other])


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


class Searches(_Criteria):
    """A5 and A6: the genetic algorithm against random search, and its results by configuration.

    Searches advance together, one generation at a time, so that no process is idle.
    """

    def against_random(self) -> list[Row]:
        """Measure A5: the final mean fitness, and how often finalists and random pairs are hazardous."""
        bred, drawn = (
            self._search(
                f"A5 {propose}",
                [Search(config=replace(SimoodConfig(), propose=propose), seed=seed) for seed in SEEDS],
            )
            for propose in ("ga", "random")
        )
        fitness = [[float(np.mean(state.fitness)) for state in states] for states in (bred, drawn)]
        means = [float(np.mean(values)) for values in fitness]
        tested = compared(*fitness)
        finalists = [self._chain(row) for state in bred for row in finalists_of(state)]
        pairs = [self._chain(row) for state in drawn for row in state.individuals[: state.config.finalists]]
        hazards = [
            self._count_hazards(f"A5 {part}", chains)
            for part, chains in (("finalists", finalists), ("random pairs", pairs))
        ]
        table = np.array([[count, total - count] for count, total in hazards])
        p_value = float(stats.fisher_exact(table, alternative="greater")[1])
        counts = " and ".join(f"{count} of {total}" for count, total in hazards)
        return [
            Row(
                what="A5 mean f of the GA minus that of random search", value=means[0] - means[1],
                target="below 0, p < .05", met=means[0] < means[1] and tested.p_value < SIGNIFICANCE_LEVEL,
                note=f"{means[0]:.3f} and {means[1]:.3f}; Mann-Whitney p {tested.p_value:.2g}, {len(SEEDS)} seeds",
            ),
            Row(
                what="A5 Fisher p of hazards of finalists against random pairs", value=p_value,
                target="below .05", met=p_value < SIGNIFICANCE_LEVEL, note=f"hazardous {counts}",
            ),
        ]  # fmt: skip

    def tables(self) -> list[Row]:
        """Measure A6: techniques and hazards by generations and population, and unique individuals by omega."""
        by_size = self._table_by_size()
        by_omega = self._table_by_omega()
        self._draw(by_omega)
        hazards = sum(row["hazards"] for row in by_size)
        simulated = sum(row["simulated"] for row in by_size)
        falls_by = by_omega[0]["mean_intensity"] - by_omega[-1]["mean_intensity"]
        return [
            at_least(
                "A6 hazards in the table of generations and population", hazards, 1,
                f"{simulated} simulated; {self._folder / 'generations-population.csv'}",
            ),
            Row(
                what="A6 mean intensity at omega 0 minus that at omega 1", value=falls_by, target="above 0",
                met=falls_by > 0, note=f"{self._folder / 'omega.png'}",
            ),
        ]  # fmt: skip

    def _table_by_size(self) -> list[dict[str, Any]]:
        sizes = [(generations, population) for generations in GENERATIONS for population in POPULATIONS]
        states = self._search(
            "A6 generations x population",
            [
                Search(config=replace(SimoodConfig(), generations=g, population_size=n), seed=0)
                for g, n in sizes
            ],
        )
        rows: list[dict[str, Any]] = []
        for (g, n), state in zip(sizes, states, strict=True):
            finalists = [self._chain(row) for row in finalists_of(state)]
            unsafe, total = self._count_hazards(f"A6 finalists g {g} n {n}", finalists)
            chains = [self._chain(state.individuals[place]) for place in state.population]
            rows.append({
                "generations": g, "population": n, "evaluated": len(state.individuals),
                "unique_genes": len({gene for chain in chains for gene, _ in chain}),
                "mean_f": round(float(np.mean(state.fitness)), 4), "hazards": unsafe, "simulated": total,
            })  # fmt: skip
        self._write("generations-population.csv", rows)
        return rows

    def _table_by_omega(self) -> list[dict[str, Any]]:
        searches = [
            Search(config=replace(SimoodConfig(), omega=w), seed=seed) for w in OMEGAS for seed in REPEATS
        ]
        by_omega = self._search("A6 omega", searches)
        rows: list[dict[str, Any]] = []
        for index, omega in enumerate(OMEGAS):
            states = by_omega[index * len(REPEATS) : (index + 1) * len(REPEATS)]
            unique = {self._chain(state.individuals[place]) for state in states for place in state.population}
            levels = [level / (CATALOGUE[gene].levels - 1) for chain in unique for gene, level in chain]
            alphas = [state.alphas[place] for state in states for place in state.population]
            rows.append({
                "omega": omega, "unique_individuals": len(unique),
                "mean_intensity": round(float(np.mean(levels)), 4), "mean_alpha": round(float(np.mean(alphas)), 4),
            })  # fmt: skip
        self._write("omega.csv", rows)
        return rows

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
            self._progress(
                part, sum(len(s.state.individuals) for s in searches if s.state is not None), total
            )
        self._progress(part, total, total)
        return [search.state for search in searches if search.state is not None]

    def _chain(self, individual: FloatArray) -> Chain:
        problem = self._places.problem
        vectors = [
            individual if component.name == "perturbation" else np.zeros(component.dimension)
            for component in problem.space.components
        ]
        return tuple((str(p["gene"]), int(str(p["level"]))) for p in problem.perturbations(vectors))

    def _count_hazards(self, part: str, chains: Sequence[Chain]) -> tuple[int, int]:
        """Return the number of hazardous episodes and the total number of episodes."""
        specs = [self._places.episode(place, chain) for chain in chains for place in REPEATS]
        records = self._run(part, specs)
        return sum(record.unsafe for record in records), len(records)

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


class Costs(_Criteria):
    """A7 and A8: what a search on the data set saves, and what perturbations cost in time and memory."""

    def speedup(self) -> list[Row]:
        """Measure A7: how much faster individuals are evaluated on the data set than in an episode."""
        chains = _spread(TIMED_CHAINS)
        _, episode_s = self._wall_times(
            "A7 in episodes", [self._places.episode(0, chain) for chain in chains]
        )
        config = SimoodConfig()
        evaluations = config.population_size + config.parents * config.generations
        rows = []
        for pictures in PICTURES:
            places = Places(AebCrossingParams(dataset_frames=pictures))
            first_s, evaluation_s = self._wall_times(
                f"A7 on {pictures} pictures", [places.evaluation(chain) for chain in chains]
            )
            making_s = max(0.0, first_s - evaluation_s)  # the first evaluation also makes the data set
            end_to_end_s = making_s + evaluations * evaluation_s + FINALISTS * episode_s
            rows += [
                at_least(
                    f"A7 search on {pictures} pictures, times faster", episode_s / evaluation_s, TARGET_SPEEDUP,
                    f"an evaluation {evaluation_s:.2f} s, an episode {episode_s:.2f} s; {evaluations} evaluations",
                ),
                at_least(
                    f"A7 end to end with {pictures} pictures, times faster", evaluations * episode_s / end_to_end_s,
                    TARGET_SPEEDUP, f"making the pictures {making_s:.1f} s, {FINALISTS} finalists",
                ),
            ]  # fmt: skip
        return rows

    def perturbing(self) -> list[Row]:
        """Measure A8: CPU time per frame and memory of a process, with and without perturbations."""
        chains = _spread(30)
        specs = [self._places.episode(place, chain) for chain in chains for place in COST_PLACES]
        perturbed_s = [_frame_s(record) for record in self._run("A8 perturbed", specs)]
        clean_specs = [self._places.episode(place) for place in COST_PLACES]
        clean_s = [_frame_s(record) for record in self._records.run(clean_specs)]
        ratios = [
            seconds / clean_s[index % len(COST_PLACES)] - 1 for index, seconds in enumerate(perturbed_s)
        ]
        small = Places(AebCrossingParams(width_px=320))
        camera = self._run_fresh(None, [small.episode(place) for place in (*COST_PLACES, *COST_PLACES)])
        # The first episodes pay for imports and are not counted.
        camera_s = FRAMES_IN_8_S * statistics.fmean(map(_frame_s, camera[len(COST_PLACES) :]))
        memory_mb = [_peak_memory_mb(specs[:6]), _peak_memory_mb(clean_specs * 3)]
        return [
            at_most(
                "A8 time of perturbing, share of an unperturbed frame", statistics.fmean(ratios), MAX_EXTRA_TIME,
                f"{len(chains)} random pairs, {len(COST_PLACES)} places; min {min(ratios):.2f}, "
                f"max {max(ratios):.2f}; a frame without {1e3 * statistics.fmean(clean_s):.1f} ms",
            ),
            at_most(
                "A8 CPU s of a camera episode of 80 frames, 320 x 180", camera_s, MAX_CAMERA_EPISODE_S,
                f"8 s at 10 Hz; {1 / camera_s:.2f} episodes per CPU second",
            ),
            at_most(
                "A8 memory of perturbing", memory_mb[0] / memory_mb[1] - 1, MAX_EXTRA_MEMORY,
                f"{memory_mb[0]:.0f} and {memory_mb[1]:.0f} MB",
            ),
        ]  # fmt: skip

    def _wall_times(self, part: str, specs: Sequence[EpisodeSpec]) -> tuple[float, float]:
        """Return the time of the first run, which fills caches, and the mean time of the later runs, in s."""
        first, *others = [record.wall_s for record in self._run_fresh(part, [specs[0], *specs])]
        return first, statistics.fmean(others)

    def _run_fresh(self, part: str | None, specs: Sequence[EpisodeSpec]) -> list[Record]:
        """Run episodes one after another in a fresh process, without the stored outcomes."""
        records = []
        with single_threaded(), process_pool(1) as pool:
            for record in pool.map(run_record, specs):
                records.append(record)
                if part is not None:
                    self._progress(part, len(records), len(specs))
        return records


def _equal(what: str, value: int, target: int, note: str) -> Row:
    return Row(what=what, value=value, target=str(target), met=value == target, note=note)


def _violations(records: Sequence[Record], requirement: str) -> int:
    return sum(record.robustness[requirement] < 0 for record in records)


def _unsafe_shares(records: Mapping[Chain, Sequence[Record]]) -> dict[Chain, float]:
    return {chain: sum(record.unsafe for record in found) / len(found) for chain, found in records.items()}


def _frame_s(record: Record) -> float:
    return record.cpu_s / float(str(record.features["frames"]))


def _peak_memory_mb(specs: Sequence[EpisodeSpec]) -> float:
    """Return the peak memory of a fresh process that runs episodes."""
    with single_threaded(), process_pool(1) as pool:
        return pool.submit(_run_and_report_peak, list(specs)).result()


def _run_and_report_peak(specs: list[EpisodeSpec]) -> float:
    for spec in specs:
        run_record(spec)
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def _steps(chain: Chain) -> list[Json]:
    """Return a chain in the format of an episode specification."""
    return [{"gene": gene, "level": level} for gene, level in chain]


def _words(chain: Chain) -> str:
    steps = (f"{gene.replace('_', ' ')} {level}/{CATALOGUE[gene].levels - 1}" for gene, level in chain)
    return ", then ".join(steps) or "nothing"


def _singles() -> list[Chain]:
    """Return every gene at every level that has an effect: 160 chains."""
    return [((name, level),) for name, gene in CATALOGUE.items() for level in range(1, gene.levels)]


def _harmless_levels(unsafe_shares: Mapping[Chain, float]) -> dict[str, int]:
    """Return, for each gene, the highest level such that no level up to it is ever hazardous alone."""
    found: dict[str, int] = {}
    for name, gene in CATALOGUE.items():
        for level in range(1, gene.levels):
            if unsafe_shares[((name, level),)] > 0.0:
                break
            found[name] = level
    return found


def _spread(count: int) -> list[Chain]:
    """Return pairs of different genes in which all genes are about equally frequent, at varying levels."""
    names = list(CATALOGUE)
    pairs = [
        pair for step in range(1, len(names)) for pair in zip(names, names[step:] + names[:step], strict=True)
    ]
    stride = max(1, len(pairs) // count)
    shares = itertools.cycle((0.3, 0.6, 1.0))
    return [
        tuple((name, max(1, round(share * (CATALOGUE[name].levels - 1)))) for name in pair)
        for pair, share in zip(pairs[::stride][:count], shares, strict=False)
    ]
