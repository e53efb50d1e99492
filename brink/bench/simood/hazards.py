"""A0 to A4: a safe baseline, hazards of single perturbations, of pairs, and of orders."""

import csv
import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path

from brink.bench.figures import Row
from brink.bench.simood.places import (
    ACCIDENT,
    DANGEROUS_STOP,
    Chain,
    Places,
    highest,
    shares,
    singles,
    words,
)
from brink.bench.telling import Told
from brink.bench.trials import Record, Records
from brink.server.problems.aeb_crossing import AebCrossingParams
from brink.sim.episode import EpisodeSpec
from brink.sim.perturbations import CATALOGUE

"""Called with what is being measured, how much of it is done, and how much there is."""

CLEAN_PLACES = range(20)
SWEEP_PLACES = range(3)
JUDGED_PLACES = range(5)
OBSTACLE_PLACES = range(10)
MOST = 0.2
"""Hazardous in at most one place of five is safe; in at least four of five, hazardous."""


class Hazards:
    """Runs the episodes of A0 to A4.

    Args:
        records: Runs specifications and keeps what came out.
        folder: Where tables go.
        told: Told how far it is.
    """

    def __init__(self, records: Records, folder: Path, told: Told) -> None:
        self._records = records
        self._folder = folder
        self._told = told
        self._places = Places()

    def baseline(self) -> list[Row]:
        """A0: over 20 clean places no accident and no dangerous stop; without braking, 20 accidents."""
        rows = []
        for mode in ("detector", "oracle"):
            specs = [self._places.episode(place, mode=mode) for place in CLEAN_PLACES]
            seen = self._run(f"A0 {mode}", specs)
            for what, name in (("accidents", ACCIDENT), ("dangerous stops", DANGEROUS_STOP)):
                count = sum(record.robustness[name] < 0 for record in seen)
                rows.append(_row(f"A0 {what}, {mode}", count, "0", count == 0, f"{len(seen)} clean places"))
        off = self._run(
            "A0 braking off",
            [self._places.episode(place, mode="oracle", braking=False) for place in CLEAN_PLACES],
        )
        hit = sum(record.robustness[ACCIDENT] < 0 for record in off)
        rows.append(_row("A0 accidents, braking off", hit, "20", hit == len(off), f"{len(off)} places"))
        return rows

    def catalogue(self) -> list[Row]:
        """A1: 15 genes in 175 levels; the tests hold what each must do to a picture."""
        levels = sum(gene.levels for gene in CATALOGUE.values())
        return [
            _row("A1 genes", len(CATALOGUE), "15", len(CATALOGUE) == 15, ""),
            _row("A1 levels", levels, "175", levels == 175, f"{len(singles())} of them do something"),
        ]

    def sweep(self) -> list[Row]:
        """A2: every gene at every level, alone, in three places; fallen trees and overturned vehicles."""
        seen = self._hazards("A2 singles", singles(), SWEEP_PLACES)
        self._write_sweep(seen)
        accidents = sum(record.robustness[ACCIDENT] < 0 for records in seen.values() for record in records)
        stops = sum(record.robustness[DANGEROUS_STOP] < 0 for records in seen.values() for record in records)
        of = f"{sum(map(len, seen.values()))} episodes; table in {self._folder / 'singles.csv'}"
        rows = [
            _row("A2 accidents of singles", accidents, "at least 1", accidents >= 1, of),
            _row("A2 dangerous stops of singles", stops, "at least 1", stops >= 1, of),
        ]
        for obstacle in ("novelty", "anomaly"):
            places = Places(AebCrossingParams(obstacle=obstacle))
            records = self._run(f"A2 {obstacle}", [places.episode(place) for place in OBSTACLE_PLACES])
            hit = sum(record.features["collided_with"] == obstacle for record in records)
            rows.append(
                _row(
                    f"A2 collisions with the {obstacle}",
                    hit,
                    "at least 1",
                    hit >= 1,
                    f"{len(records)} places",
                )
            )
        return rows

    def pairs(self) -> list[Row]:
        """A3 and A4: pairs of which each part is safe, and pairs whose order decides."""
        alone = shares(_unsafe(self._hazards("A2 singles", singles(), SWEEP_PLACES)))
        harmless = highest(alone, 0.0)
        steps = [(gene, level) for gene, level in harmless.items()]
        ordered = list(itertools.permutations(steps, 2))
        screened = _unsafe(self._hazards("A3 pairs, one place", ordered, range(1)))
        promising = [chain for chain, unsafe in screened.items() if unsafe[0] or screened[chain[::-1]][0]]
        judged = shares(_unsafe(self._hazards("A3 pairs, five places", promising, JUDGED_PLACES)))
        parts = shares(_unsafe(self._hazards("A3 their parts", [(step,) for step in steps], JUDGED_PLACES)))
        together = [
            chain
            for chain, share in judged.items()
            if share >= 1 - MOST and all(parts[(step,)] <= MOST for step in chain)
        ]
        turned = [
            chain
            for chain, share in judged.items()
            if share >= 1 - MOST and judged.get(chain[::-1], 1.0) <= MOST
        ]
        self._write_pairs(judged, parts)
        of = f"{len(ordered)} ordered pairs of harmless levels, {len(promising)} of them in five places"
        return [
            _row(
                "A3 pairs hazardous only together",
                len(together),
                "at least 1",
                bool(together),
                _best(together, of),
            ),
            _row(
                "A4 pairs hazardous in one order", len(turned), "at least 1", bool(turned), _best(turned, of)
            ),
        ]

    def _hazards(
        self, what: str, chains: Sequence[Chain], places: Sequence[int]
    ) -> dict[Chain, list[Record]]:
        specs = [self._places.episode(place, chain) for chain in chains for place in places]
        seen = self._run(what, specs)
        width = len(places)
        return {chain: seen[index * width : (index + 1) * width] for index, chain in enumerate(chains)}

    def _run(self, what: str, specs: Sequence[EpisodeSpec]) -> list[Record]:
        return self._records.run(specs, lambda done, total: self._told(what, done, total))

    def _write_sweep(self, seen: Mapping[Chain, Sequence[Record]]) -> None:
        with (self._folder / "singles.csv").open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(["gene", "level", "places", "accidents", "dangerous_stops", "mean_alpha"])
            for ((gene, level),), records in seen.items():
                alphas = [record.objectives["alpha"] for record in records if "alpha" in record.objectives]
                writer.writerow([
                    gene, level, len(records), sum(r.robustness[ACCIDENT] < 0 for r in records),
                    sum(r.robustness[DANGEROUS_STOP] < 0 for r in records),
                    round(sum(alphas) / max(1, len(alphas)), 4),
                ])  # fmt: skip

    def _write_pairs(self, judged: Mapping[Chain, float], parts: Mapping[Chain, float]) -> None:
        with (self._folder / "pairs.csv").open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(
                ["first", "second", "hazardous_share", "first_alone", "second_alone", "other_order"]
            )
            for chain, share in sorted(judged.items(), key=lambda item: -item[1]):
                first, second = ((step,) for step in chain)
                other = judged.get(chain[::-1])
                writer.writerow([words(first), words(second), share, parts[first], parts[second], other])


def _unsafe(seen: Mapping[Chain, Sequence[Record]]) -> dict[Chain, Sequence[bool]]:
    return {chain: [record.unsafe for record in records] for chain, records in seen.items()}


def _best(chains: Sequence[Chain], of: str) -> str:
    return f"{words(chains[0])}; of {of}" if chains else f"of {of}"


def _row(what: str, value: float, target: str, met: bool, note: str) -> Row:
    return Row(what=what, value=value, target=target, met=met, note=note)
