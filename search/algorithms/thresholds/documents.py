"""Storage of the state of `edge@2`, and validation of stored states."""

from collections.abc import Set
from dataclasses import asdict
from typing import Any

from brink.search.algorithms.ledger import Ledger
from brink.search.algorithms.thresholds.parts import Parts
from brink.search.algorithms.thresholds.state import (
    Hunt,
    Job,
    Purpose,
    Stage,
    ThresholdConfig,
    ThresholdState,
)
from brink.search.document import Document
from brink.search.errors import DocumentError


def content_of(state: ThresholdState) -> dict[str, Any]:
    """Return the header entries that store a state, without its ledger."""
    return {
        "hunts": [asdict(hunt) for hunt in state.hunts],
        "jobs": [list(job) for job in state.jobs],
        "explored": list(state.explored),
    }


def restored_state(ledger: Ledger, config: ThresholdConfig, document: Document) -> ThresholdState:
    """Return the state that `content_of` stored.

    Raises:
        DocumentError: The document is corrupt, or does not match the ledger.
    """
    try:
        hunts = tuple(_hunt(one) for one in document.header["hunts"])
        jobs = tuple(Job(Purpose(a), int(b), int(c)) for a, b, c in document.header["jobs"])
        explored = tuple(int(number) for number in document.header["explored"])
    except (KeyError, TypeError, ValueError) as error:
        raise DocumentError(f"hunts, jobs, explored: {type(error).__name__}: {error}") from None
    if len(jobs) != ledger.in_flight + len(ledger.queue):
        raise DocumentError(
            f"jobs: expected one for each of {ledger.in_flight + len(ledger.queue)} candidates, got {len(jobs)}"
        )
    simulated = set(ledger.archive.numbers.tolist())
    parts = Parts(ledger.space)
    _check("explored", set(explored), simulated)
    _check("jobs", {job.hunt for job in jobs if job.purpose is not Purpose.EXPLORE}, set(range(len(hunts))))
    for hunt in hunts:
        ends = {hunt.opposite, hunt.safe, hunt.unsafe, hunt.start, hunt.end} - {-1}
        told = {number for _, _, number in hunt.told}
        _check("hunts", {hunt.anchor, hunt.held, *hunt.trials} | ends | told, simulated)
        _check("hunts", {hunt.seed}, set(range(ledger.spent + ledger.in_flight)))
        _check("hunts", {*hunt.moved} | ({hunt.unit} - {-1}), set(range(len(parts.units))))
        _check("hunts", set(hunt.needed), set(range(len(parts.blocks))))
    limits = {Purpose.DROP: len(parts.blocks), Purpose.CHECK: 2} | dict.fromkeys(
        (Purpose.MOVE, Purpose.APPROACH), len(parts.units)
    )
    for job in jobs:
        limit = limits.get(job.purpose, 1)
        _check("jobs", {job.subject}, set(range(limit)))
    return ThresholdState(config=config, ledger=ledger, hunts=hunts, jobs=jobs, explored=explored)


def _hunt(stored: dict[str, Any]) -> Hunt:
    values: dict[str, Any] = {
        name: tuple(int(one) for one in stored[name]) for name in ("needed", "moved", "trials")
    }
    values |= {
        name: int(stored[name]) for name in ("unit", "opposite", "safe", "unsafe", "start", "end", "failures")
    }
    return Hunt(
        anchor=int(stored["anchor"]),
        seed=int(stored["seed"]),
        held=int(stored["held"]),
        stage=Stage(stored["stage"]),
        from_safe=bool(stored["from_safe"]),
        window=bool(stored["window"]),
        told=tuple((int(Purpose(a)), int(b), int(c)) for a, b, c in stored["told"]),
        **values,
    )


def _check(name: str, named: Set[int], known: Set[int]) -> None:
    if unknown := named - known:
        raise DocumentError(f"{name}: {min(unknown)} is none of this campaign's")
