"""A7 and A8: what searching on data saves, and what perturbing costs in time and memory."""

import itertools
import multiprocessing
import resource
import statistics
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import Final

from brink.bench.figures import Row
from brink.bench.simood.places import Chain, Places
from brink.bench.telling import Told
from brink.bench.trials import Progress, Record, Records, run_record, single_threaded
from brink.search.algorithms.simood import SimoodConfig
from brink.server.problems.aeb_crossing import AebCrossingParams
from brink.sim.episode import EpisodeSpec
from brink.sim.perturbations import CATALOGUE

FASTER: Final = 10.0
MOST_TIME: Final = 0.20
MOST_MEMORY: Final = 0.05
EVALUATIONS: Final = 12
"""Individuals that are timed on data and in an episode."""
PICTURES: Final = (20, 60)
"""Of the data set: their alphas rank individuals as those of 240 do, with a correlation of .97 and .99."""
PLACES: Final = range(2)
EIGHT_SECONDS_FRAMES: Final = 80
CAMERA_S: Final = 0.9
FINALISTS: Final = 2
"""The paper's k: what is simulated after the search on data."""


class Costs:
    """Times evaluations and episodes, one at a time in one process.

    Args:
        records: Where outcomes of the other criteria are.
        told: Told how far it is.
    """

    def __init__(self, records: Records, told: Told) -> None:
        self._records = records
        self._told = told
        self._places = Places()

    def time_claim(self) -> list[Row]:
        """A7: the same individuals on data and in an episode; the ratio of a search, and end to end."""
        chains = _spread(EVALUATIONS)
        simulated = self._mean_s("A7 in episodes", [self._places.episode(0, chain) for chain in chains])[1]
        config = SimoodConfig()
        evaluations = config.population_size + config.parents * config.generations
        rows = []
        for pictures in PICTURES:
            places = Places(AebCrossingParams(dataset_frames=pictures))
            specs = [places.evaluation(chain) for chain in chains]
            first, on_data = self._mean_s(f"A7 on {pictures} pictures", specs)
            making = max(0.0, first - on_data)  # the first one makes the data set
            search = simulated / on_data
            whole = evaluations * simulated / (making + evaluations * on_data + FINALISTS * simulated)
            of = f"an evaluation {on_data:.2f} s, an episode {simulated:.2f} s; {evaluations} evaluations"
            rows += [
                Row(what=f"A7 search on {pictures} pictures, times faster", value=search,
                    target=f"at least {FASTER:g}", met=search >= FASTER, note=of),
                Row(what=f"A7 end to end with {pictures} pictures, times faster", value=whole,
                    target=f"at least {FASTER:g}", met=whole >= FASTER,
                    note=f"making the pictures {making:.1f} s, {FINALISTS} finalists"),
            ]  # fmt: skip
        return rows

    def _mean_s(self, what: str, specs: Sequence[EpisodeSpec]) -> tuple[float, float]:
        """Return the seconds of the first one, which pays for what is kept, and the mean of all run after it."""
        records = _fresh([specs[0], *specs], lambda done, total: self._told(what, done, total))
        first, *others = [record.wall_s for record in records]
        return first, statistics.fmean(others)

    def perturbing(self) -> list[Row]:
        """A8: CPU time a frame with perturbations against the same place without, and the memory of a process."""
        chains = _spread(30)
        specs = [self._places.episode(place, chain) for chain in chains for place in PLACES]
        perturbed = self._records.run(specs, lambda done, total: self._told("A8 perturbed", done, total))
        clean_specs = [self._places.episode(place) for place in PLACES]
        clean = self._records.run(clean_specs)
        frame_s = [record.cpu_s / float(str(record.features["frames"])) for record in perturbed]
        base_s = [record.cpu_s / float(str(record.features["frames"])) for record in clean]
        ratios = [seconds / base_s[index % len(PLACES)] - 1 for index, seconds in enumerate(frame_s)]
        mean = statistics.fmean(ratios)
        small = Places(AebCrossingParams(width_px=320))
        camera = [small.episode(place) for place in (*PLACES, *PLACES)]
        # The first one pays for imports: it is run, and not counted.
        camera_s = [r.cpu_s / float(str(r.features["frames"])) for r in _fresh(camera)[len(PLACES) :]]
        eighty_s = EIGHT_SECONDS_FRAMES * statistics.fmean(camera_s)
        memory = [_memory_mb(specs[:6]), _memory_mb(clean_specs * 3)]
        more = memory[0] / memory[1] - 1
        return [
            Row(what="A8 time of perturbing, share of an unperturbed frame", value=mean,
                target=f"at most {MOST_TIME:g}", met=mean <= MOST_TIME,
                note=f"{len(chains)} random pairs, {len(PLACES)} places; least {min(ratios):.2f}, "
                f"most {max(ratios):.2f}; a frame without {1e3 * statistics.fmean(base_s):.1f} ms"),
            Row(what="A8 CPU s of a camera episode of 80 frames, 320 x 180", value=eighty_s,
                target=f"at most {CAMERA_S:g}", met=eighty_s <= CAMERA_S,
                note=f"8 s at 10 Hz; {1 / eighty_s:.2f} episodes a CPU second"),
            Row(what="A8 memory of perturbing", value=more, target=f"at most {MOST_MEMORY:g}",
                met=more <= MOST_MEMORY, note=f"{memory[0]:.0f} and {memory[1]:.0f} MB"),
        ]  # fmt: skip


def _spread(count: int) -> list[Chain]:
    """Return pairs of different genes, every gene about as often, at low, middle and top levels in turn."""
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


def _fresh(specs: Sequence[EpisodeSpec], told: Progress | None = None) -> list[Record]:
    """Return what came out of each, one after the other in one fresh process."""
    context = multiprocessing.get_context("spawn")
    records = []
    with single_threaded(), ProcessPoolExecutor(1, mp_context=context) as pool:
        for record in pool.map(run_record, specs):
            records.append(record)
            if told is not None:
                told(len(records), len(specs))
    return records


def _memory_mb(specs: Sequence[EpisodeSpec]) -> float:
    """Return the greatest memory of a fresh process that runs these."""
    context = multiprocessing.get_context("spawn")
    with single_threaded(), ProcessPoolExecutor(1, mp_context=context) as pool:
        return pool.submit(_greatest_mb, list(specs)).result()


def _greatest_mb(specs: list[EpisodeSpec]) -> float:
    for spec in specs:
        run_record(spec)
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
