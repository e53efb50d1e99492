"""The SiMOOD criteria A7 and A8: the saving of a search on a data set, and the cost of perturbations."""

import itertools
import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from benchmarks.measurement import Progress, Row, at_least, at_most
from benchmarks.simood_places import Criteria, NamedChain, Places
from benchmarks.simood_searches import Campaign
from benchmarks.trials import Record, Records, run_record
from brink.search.algorithms.simood import SimoodConfig
from brink.server.problems.aeb_crossing import AebCrossingParams
from brink.sim.driving.interface import CONTROL_STEP_S
from brink.sim.episode import EpisodeSpec
from brink.sim.perturbations import CATALOGUE
from brink.worker.pool import process_pool, single_threaded

TARGET_SPEEDUP: Final = 10.0
MAX_EXTRA_TIME: Final = 0.20
MAX_EXTRA_MEMORY: Final = 0.05
TIMED_CHAINS: Final = 12
COST_CHAINS: Final = 18
PICTURES: Final = (20, 60)
"""Sizes of the data set. They rank individuals much as 240 pictures do: their alphas correlate by .97 and .99."""
COST_PLACES: Final = range(2)
FRAMES: Final = 80
MAX_CAMERA_EPISODE_S: Final = 0.9
LARGE_POPULATION: Final = 120
"""A large last population, simulated as a whole."""
TOP: Final = 2
"""Finalists of the fastest search from beginning to end, each in one street; as many as the paper's k."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Times:
    """Wall-clock times, in s.

    Attributes:
        making_s: Making the data set, once.
        evaluation_s: Evaluating an individual on it.
        episode_s: Simulating an episode.
    """

    making_s: float
    evaluation_s: float
    episode_s: float

    def on_data_s(self, evaluations: int, episodes: int) -> float:
        """Return the time of a search on the data set and of the episodes after it."""
        return self.making_s + evaluations * self.evaluation_s + episodes * self.episode_s


def search_cost(config: SimoodConfig) -> int:
    """Return the number of individuals that a search evaluates."""
    return config.population_size + config.parents * config.generations


def time_rows(pictures: int, times: Times, measured: int, episodes: int) -> list[Row]:
    """Return the ratios of A7 for one size of the data set.

    Each ratio compares the same search in episodes and on the data set. With the default fitness, it has parts, too.

    Args:
        pictures: Number of pictures.
        times: What was timed.
        measured: Evaluations on the data set in a campaign with the default settings, those of parts included.
        episodes: Episodes of that campaign, those of its explanation included.
    """
    config = SimoodConfig()
    individuals, on = search_cost(config), f"{pictures} pictures"
    large = search_cost(replace(config, population_size=LARGE_POPULATION))
    included = (
        (
            f"whole last population of {config.population_size} simulated, as in the paper's sum",
            config.population_size,
        ),
        (f"all {config.finalists} finalists in {config.repeats} streets", config.finalists * config.repeats),
        (f"best {TOP} in one street", TOP),
    )
    rows = [
        at_least(
            f"A7 search alone, {on}, times faster",
            times.episode_s / times.evaluation_s,
            TARGET_SPEEDUP,
            f"an evaluation {times.evaluation_s:.2f} s, an episode {times.episode_s:.2f} s; making the pictures "
            f"{times.making_s:.1f} s",
        ),
        _ratio(
            f"whole last population of {LARGE_POPULATION} simulated, paper's fitness, {on}",
            times,
            large,
            LARGE_POPULATION,
        ),
        *(
            _ratio(f"{what}, {fitness}, {on}", times, evaluated, simulated)
            for fitness, evaluated in (("paper's fitness", individuals), ("default fitness", measured))
            for what, simulated in included
        ),
    ]
    # With the default fitness, parts take time on both sides of the ratio, so it has no target.
    targeted = f"best {TOP} in one street, paper's fitness"
    return [
        *(
            at_least(row.what, row.value, TARGET_SPEEDUP, row.note) if targeted in row.what else row
            for row in rows
        ),
        _campaign_row(on, times, measured, episodes),
    ]


def _ratio(what: str, times: Times, evaluated: int, simulated: int) -> Row:
    """Return the speed-up of a search followed by some episodes over the same search in episodes."""
    in_episodes_s, on_data_s = evaluated * times.episode_s, times.on_data_s(evaluated, simulated)
    return Row(
        what=f"A7 {what}, times faster",
        value=in_episodes_s / on_data_s,
        target="",
        met=None,
        note=f"{in_episodes_s:.0f} s in episodes, {on_data_s:.0f} s: {evaluated} evaluations, {simulated} episodes",
    )


def _campaign_row(on: str, times: Times, measured: int, episodes: int) -> Row:
    """Return the time of a default campaign, with its parts and its explanation, beside individuals in episodes."""
    individuals = search_cost(SimoodConfig())
    in_episodes_s, campaign_s = individuals * times.episode_s, times.on_data_s(measured, episodes)
    return Row(
        what=f"A7 default campaign with its explanation, {on}, share of {individuals} individuals in episodes, "
        "without parts or explanation",
        value=campaign_s / in_episodes_s,
        target="",
        met=None,
        note=f"{campaign_s:.0f} of {in_episodes_s:.0f} s: {measured} evaluations with those of parts, "
        f"{episodes} episodes",
    )


class Costs(Criteria):
    """A7 and A8: the saving of a search on the data set, and the cost of perturbations in time and memory.

    Args:
        records: Runs episodes and stores their outcomes.
        folder: Folder for tables and figures.
        progress: Progress callback.
        params: Parameters of the problem.
        campaign: Runs a campaign with the default settings.
    """

    def __init__(
        self,
        records: Records,
        folder: Path,
        progress: Progress,
        params: AebCrossingParams,
        *,
        campaign: Callable[[], Campaign],
    ) -> None:
        super().__init__(records, folder, progress, params)
        self._campaign = campaign

    def speedup(self) -> list[Row]:
        """Measure A7: how much faster a search on the data set is than the same search in episodes.

        A search in episodes has simulated its last population when it ends. What a search on the data set still has
        to simulate is up to the user, so there are several ratios from beginning to end, each named after what it
        includes.
        """
        chains = _spread(TIMED_CHAINS)
        _, episode_s = self._wall_times(
            "A7 in episodes", [self._places.episode(0, chain) for chain in chains]
        )
        campaign = self._campaign()
        rows = []
        for pictures in PICTURES:
            places = Places(replace(self._params, dataset_frames=pictures))
            first_s, evaluation_s = self._wall_times(
                f"A7 on {pictures} pictures", [places.evaluation(chain) for chain in chains]
            )
            # The first evaluation also makes the data set.
            making_s = max(0.0, first_s - evaluation_s)
            times = Times(making_s=making_s, evaluation_s=evaluation_s, episode_s=episode_s)
            rows += time_rows(pictures, times, campaign.measured, campaign.episodes)
        return rows

    def perturbing(self) -> list[Row]:
        """Measure A8: CPU time per frame and memory of a process, with and without perturbations.

        One process runs each perturbed episode right after the same one without perturbations.
        """
        chains = _spread(COST_CHAINS)
        perturbed = [
            self._places.episode(COST_PLACES[index % len(COST_PLACES)], chain)
            for index, chain in enumerate(chains)
        ]
        clean_specs = [self._places.episode(place) for place in COST_PLACES]
        turns = itertools.chain(*zip(itertools.cycle(clean_specs), perturbed, strict=False))
        records = self._run_fresh("A8 perturbed", [*clean_specs, *turns])[len(clean_specs) :]
        clean_s, perturbed_s = (list(map(_frame_s, records[first::2])) for first in (0, 1))
        ratios = [one / other - 1 for one, other in zip(perturbed_s, clean_s, strict=True)]
        small = Places(replace(self._params, width_px=320))
        camera = self._run_fresh(None, [small.episode(place) for place in (*COST_PLACES, *COST_PLACES)])
        # The first episodes pay for imports and are not counted.
        camera_s = FRAMES * statistics.fmean(map(_frame_s, camera[len(COST_PLACES) :]))
        memory_mb = [_peak_memory_mb(perturbed[:: len(perturbed) // 6]), _peak_memory_mb(clean_specs * 3)]
        return [
            at_most(
                "A8 time of perturbing, share of an unperturbed frame",
                statistics.fmean(ratios),
                MAX_EXTRA_TIME,
                f"{len(chains)} pairs of genes, {len(COST_PLACES)} places; min {min(ratios):.2f}, "
                f"max {max(ratios):.2f}; a frame without {1e3 * statistics.fmean(clean_s):.1f} ms",
            ),
            at_most(
                f"A8 CPU s of {FRAMES} frames of an episode, 320 x 180",
                camera_s,
                MAX_CAMERA_EPISODE_S,
                f"{FRAMES * CONTROL_STEP_S:g} s of driving, from the mean of a frame",
            ),
            at_most(
                "A8 memory of perturbing",
                memory_mb[0] / memory_mb[1] - 1,
                MAX_EXTRA_MEMORY,
                f"{memory_mb[0]:.0f} and {memory_mb[1]:.0f} MB",
            ),
        ]

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


def _frame_s(record: Record) -> float:
    return record.cpu_s / float(str(record.features["frames"]))


def _peak_memory_mb(specs: Sequence[EpisodeSpec]) -> float:
    """Return the peak memory of a fresh process that runs episodes."""
    with single_threaded(), process_pool(1) as pool:
        return pool.submit(_run_and_report_peak, list(specs)).result()


def _run_and_report_peak(specs: list[EpisodeSpec]) -> float:
    for spec in specs:
        run_record(spec)
    # Not from getrusage, where the peak of a new process is at least that of its parent.
    (line,) = [
        line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmHWM")
    ]
    return int(line.split()[1]) / 1024


def _spread(count: int) -> list[NamedChain]:
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
