"""The SiMOOD criteria A0 to A9: a safe baseline, hazards of perturbations, searches on a data set, and their cost.

Outcomes of episodes are stored, and criteria share them.
"""

import contextlib
import itertools
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks.measurement import Progress, Row, at_least, at_most
from benchmarks.simood_costs import Costs
from benchmarks.simood_figures import draw_pairs, is_only_together
from benchmarks.simood_places import CONFIRMATION_PLACES, Criteria, NamedChain, Places, words_of
from benchmarks.simood_searches import Searches
from benchmarks.trials import Record, Records, code_fingerprint
from brink.search.analysis.combinations import HAZARDOUS, SAFE
from brink.search.analysis.statistics import a12
from brink.server.csv_text import csv_text
from brink.server.problems.aeb_crossing import AebCrossingParams
from brink.sim.aeb.dataset import Split, labelled_frames
from brink.sim.perception.detector import Picture
from brink.sim.perturbations import CATALOGUE, Perturbation, Pipeline

CRITERIA: Final = ("A0", "A1", "A2", "A3", "A4", "A5", "A6", "A7", "A8", "A9")
CODE: Final = ("sim",)
"""Code that determines the outcome of an episode; outcomes stored by other versions of the code are not used."""
ACCIDENT: Final = "no-collision@1"
DANGEROUS_STOP: Final = "no-dangerous-stop@1"

CLEAN_PLACES: Final = range(20)
OTHER_PLACES: Final = range(100, 140)
"""Places in which thresholds of the detector are tried, so that the default is not chosen in `CLEAN_PLACES`."""
THRESHOLDS: Final = (0.3, 0.4, 0.5, 0.6)
SWEEP_PLACES: Final = range(3)
OBSTACLE_PLACES: Final = range(10)
MAX_HARMFUL_GENES: Final = 3
RESAMPLES: Final = 2_000
MEASURES: Final = {"alpha": "mAP", "decision_accuracy": "decision accuracy"}
"""Objectives that are measured on the data set."""
DEFAULT_REPEATS: Final = 3
"""Searches with each configuration of tables II and III, and campaigns of A9; the paper has 10."""
DEFAULT_SEEDS: Final = 10
"""Searches of each kind that A5 compares."""


def measure_simood(
    criteria: Sequence[str],
    folder: Path,
    *,
    processes: int,
    progress: Progress,
    detector: str | None = None,
    threshold: float | None = None,
    repeats: int = DEFAULT_REPEATS,
    seeds: int = DEFAULT_SEEDS,
) -> list[Row]:
    """Measure the given criteria. Outcomes of episodes are stored in the folder and reused.

    Args:
        criteria: Some of `CRITERIA`; A3 and A4 are one measurement.
        folder: Folder for outcomes, tables and figures. Tables of a given detector or threshold are in a folder of
            that name below.
        processes: Number of processes that run episodes.
        progress: Progress callback.
        detector: Id or file of the detector; None for the problem's default.
        threshold: Minimum score of a detection; None for the problem's default.
        repeats: Searches with each configuration in A6, and campaigns in A9.
        seeds: Searches of each kind in A5.
    """
    params = AebCrossingParams()
    if detector is not None:
        params = replace(params, detector=detector)
    if threshold is not None:
        params = replace(params, threshold=threshold)
    chosen = [str(one) for one in (detector, threshold) if one is not None]
    tables = folder / re.sub(r"[^\w.@-]+", "-", "-".join(chosen)) if chosen else folder
    tables.mkdir(parents=True, exist_ok=True)
    file = folder / f"records-{code_fingerprint(CODE)}.jsonl"
    with contextlib.closing(Records(file, processes=processes)) as records:
        hazards = Hazards(records, tables, progress, params)
        searches = Searches(records, tables, progress, params, repeats=repeats, seeds=seeds)
        costs = Costs(records, tables, progress, params, campaign=searches.default_campaign)
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
            "A9": searches.interactions,
        }
        wanted = dict.fromkeys(measures[name] for name in CRITERIA if name in criteria)
        return [row for measure in wanted for row in measure()]


class Hazards(Criteria):
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
        rows.append(_equal("A0 accidents, braking off", count, len(off), f"{len(off)} places"))
        return [*rows, *map(self._at_threshold, THRESHOLDS)]

    def _at_threshold(self, threshold: float) -> Row:
        """Count unsafe clean drives at a threshold of the detector, in places used for nothing else."""
        places = Places(replace(self._params, threshold=threshold))
        records = self._run(f"A0 threshold {threshold:g}", [places.episode(place) for place in OTHER_PLACES])
        accidents, stops = (_violations(records, name) for name in (ACCIDENT, DANGEROUS_STOP))
        return Row(
            what=f"A0 unsafe clean drives at a threshold of {threshold:g}",
            value=sum(record.unsafe for record in records),
            target="",
            met=None,
            note=f"{accidents} accidents, {stops} dangerous stops in {len(records)} other places",
        )

    def catalogue(self) -> list[Row]:
        """Measure A1: 15 genes with 175 levels, each of which changes an image, the same way every time."""
        levels = sum(gene.levels for gene in CATALOGUE.values())
        (frame,) = labelled_frames(Split.TEST, 1, width_px=320)
        working = [chain for chain in _singles() if _works(chain, frame.picture)]
        return [
            _equal("A1 genes", len(CATALOGUE), 15, ""),
            _equal("A1 levels", levels, 175, ""),
            _equal(
                "A1 levels that change an image, the same way twice",
                len(working),
                len(_singles()),
                f"of the levels that should; the other {levels - len(_singles())} have no effect (ADR 22)",
            ),
        ]

    def sweep(self) -> list[Row]:
        """Measure A2: every gene at every level, alone, in three places; fallen trees and overturned vehicles."""
        singles = self._run_chains("A2 singles", _singles(), SWEEP_PLACES)
        evaluations = [self._places.evaluation(chain) for chain in singles]
        measured = dict(zip(singles, self._run("A2 singles on data", evaluations), strict=True))
        self._write_sweep(singles, measured)
        records = [record for of_chain in singles.values() for record in of_chain]
        note = f"{len(records)} episodes; table in {self._folder / 'singles.csv'}"
        rows = [
            at_least("A2 accidents of singles", _violations(records, ACCIDENT), 1, note),
            at_least("A2 dangerous stops of singles", _violations(records, DANGEROUS_STOP), 1, note),
            harmful_genes_row(_unsafe_shares(singles)),
            *prediction_rows(_unsafe_shares(singles), measured),
        ]
        for obstacle in ("novelty", "anomaly"):
            places = Places(replace(self._params, obstacle=obstacle))
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
        together = _unsafe_shares(
            self._run_chains("A3 pairs, five other places", promising, CONFIRMATION_PLACES)
        )
        parts = _unsafe_shares(
            self._run_chains("A3 their parts", [(step,) for step in steps], CONFIRMATION_PLACES)
        )
        only_together = [chain for chain, share in together.items() if is_only_together(chain, share, parts)]
        in_one_order = [
            chain
            for chain, share in together.items()
            if share >= HAZARDOUS and together.get(chain[::-1], 1.0) <= SAFE
        ]
        self._write_pairs(together, parts)
        draw_pairs(together, parts, self._folder / "pairs.png")
        note = (
            f"{len(ordered)} ordered pairs of harmless levels, {len(promising)} of them in five other places"
        )
        return [
            at_least(what, len(chains), 1, f"{words_of(chains[0])}; of {note}" if chains else f"of {note}")
            for what, chains in (
                ("A3 pairs hazardous only together", only_together),
                ("A4 pairs hazardous in one order", in_one_order),
            )
        ]

    def _write_sweep(
        self, singles: Mapping[NamedChain, Sequence[Record]], measured: Mapping[NamedChain, Record]
    ) -> None:
        rows = []
        for chain, records in singles.items():
            ((gene, level),) = chain
            alphas = [record.objectives["alpha"] for record in records if "alpha" in record.objectives]
            rows.append(
                {
                    "gene": gene,
                    "level": level,
                    "places": len(records),
                    "accidents": _violations(records, ACCIDENT),
                    "dangerous_stops": _violations(records, DANGEROUS_STOP),
                    "mean_alpha": round(sum(alphas) / max(1, len(alphas)), 4),
                    **{f"{name}_on_data": round(measured[chain].objectives[name], 4) for name in MEASURES},
                }
            )
        self._write("singles.csv", rows)

    def _write_pairs(self, together: Mapping[NamedChain, float], parts: Mapping[NamedChain, float]) -> None:
        rows: list[list[object]] = [
            ["first", "second", "hazardous_share", "first_alone", "second_alone", "other_order"]
        ]
        for chain, share in sorted(together.items(), key=lambda item: -item[1]):
            first, second = ((step,) for step in chain)
            other = together.get(chain[::-1])
            rows.append([words_of(first), words_of(second), share, parts[first], parts[second], other])
        (self._folder / "pairs.csv").write_text(csv_text(rows), encoding="utf-8", newline="")


def _equal(what: str, value: int, target: int, note: str) -> Row:
    return Row(what=what, value=value, target=str(target), met=value == target, note=note)


def _works(chain: NamedChain, picture: Picture) -> bool:
    """Return whether a chain changes an image, and does so reproducibly."""
    perturbations = tuple(Perturbation(gene, level) for gene, level in chain)
    first, second = (Pipeline(perturbations, seed=0)(picture, 0) for _ in range(2))
    return not np.array_equal(first, picture) and np.array_equal(first, second)


def _violations(records: Sequence[Record], requirement: str) -> int:
    return sum(record.robustness[requirement] < 0 for record in records)


def _unsafe_shares(records: Mapping[NamedChain, Sequence[Record]]) -> dict[NamedChain, float]:
    return {chain: sum(record.unsafe for record in found) / len(found) for chain, found in records.items()}


def harmful_genes_row(unsafe_shares: Mapping[NamedChain, float]) -> Row:
    """Return how many genes are harmful at their first level: unsafe in any street, alone.

    Args:
        unsafe_shares: Share of the streets in which each gene at each level is unsafe.
    """
    harmful = [name for name in CATALOGUE if unsafe_shares[((name, 1),)] > 0.0]
    return at_most(
        "A2 genes harmful at level 1",
        len(harmful),
        MAX_HARMFUL_GENES,
        f"of {len(CATALOGUE)}, unsafe in any of {len(SWEEP_PLACES)} streets: {', '.join(harmful) or 'none'}",
    )


def prediction_rows(
    unsafe_shares: Mapping[NamedChain, float], measured: Mapping[NamedChain, Record]
) -> list[Row]:
    """Return how well each measure on the data set predicts which chains are unsafe in any street.

    The figure is the area under the ROC curve: the probability that an unsafe chain measures worse than a safe one.
    Levels of a gene are alike, so the interval is a bootstrap over genes.

    Args:
        unsafe_shares: Share of the streets in which each chain is unsafe.
        measured: Evaluation of each chain on the data set.
    """
    rows = []
    for name, words in MEASURES.items():
        by_gene: dict[str, list[tuple[float, bool]]] = {}
        for chain, share in unsafe_shares.items():
            by_gene.setdefault(chain[0][0], []).append((measured[chain].objectives[name], share > 0))
        genes = list(by_gene.values())
        area = _area_under_curve(genes)
        if area is None:
            continue
        rng = np.random.default_rng(0)
        drawn = (
            _area_under_curve([genes[place] for place in rng.integers(len(genes), size=len(genes))])
            for _ in range(RESAMPLES)
        )
        low, high = np.percentile([one for one in drawn if one is not None], [2.5, 97.5])
        unsafe = sum(share > 0 for share in unsafe_shares.values())
        rows.append(
            Row(
                what=f"A2 hazard predicted by {words}",
                value=area,
                target="",
                met=None,
                note=f"area under the ROC curve, {unsafe} unsafe and {len(unsafe_shares) - unsafe} safe chains; 95% "
                f"interval over genes {low:.2f} to {high:.2f}",
            )
        )
    return rows


def _area_under_curve(genes: Sequence[Sequence[tuple[float, bool]]]) -> float | None:
    """Return the area for chains with their measure and whether they are unsafe; None if all are, or none is."""
    unsafe, safe = (
        [value for gene in genes for value, is_unsafe in gene if is_unsafe == wanted]
        for wanted in (True, False)
    )
    return a12(safe, unsafe) if unsafe and safe else None


def _singles() -> list[NamedChain]:
    """Return every gene at every level that has an effect: 160 chains."""
    return [((name, level),) for name, gene in CATALOGUE.items() for level in range(1, gene.levels)]


def _harmless_levels(unsafe_shares: Mapping[NamedChain, float]) -> dict[str, int]:
    """Return, for each gene, the highest level such that no level up to it is ever hazardous alone."""
    found: dict[str, int] = {}
    for name, gene in CATALOGUE.items():
        for level in range(1, gene.levels):
            if unsafe_shares[((name, level),)] > 0.0:
                break
            found[name] = level
    return found
