"""Storage of the state of `edge@1`, and validation of stored states."""

from collections.abc import Set
from typing import Any

import numpy as np

from brink.search.algorithms.edge.prior import Prior
from brink.search.algorithms.edge.state import Bracket, EdgeConfig, EdgeState, Purpose, Status
from brink.search.algorithms.ledger import Ledger, stored_rows
from brink.search.document import Document
from brink.search.errors import DocumentError
from brink.search.pairs import Steps


def content_of(state: EdgeState) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the header entries and arrays that store a state, without its ledger."""
    brackets = [
        (b.safe, b.unsafe, b.seed, b.status, b.failures, b.safe_checks, b.unsafe_checks)
        for b in state.brackets
    ]
    arrays = {
        "brackets": np.reshape(brackets, (-1, 7)).astype(np.float64),
        "jobs": np.reshape(state.jobs, (-1, 3)).astype(np.float64),
        "seeds": np.reshape(sorted(state.seeds.items()), (-1, 2)).astype(np.float64),
        "tries": np.reshape(sorted(state.tries.items()), (-1, 2)).astype(np.float64),
        "resolved": np.reshape(state.resolved, (-1, 1)).astype(np.float64),
    }
    return {"partnered": state.partnered}, arrays


def restored_state(ledger: Ledger, config: EdgeConfig, document: Document) -> EdgeState:
    """Return the state that `content_of` stored.

    Raises:
        DocumentError: The document is corrupt, or does not match the ledger.
    """

    def table(name: str, width: int) -> list[tuple[int, ...]]:
        return [tuple(row) for row in stored_rows(document, name, width).astype(np.int64).tolist()]

    try:
        brackets = tuple(
            Bracket(safe=a, unsafe=b, seed=c, status=Status(d), failures=e, safe_checks=f, unsafe_checks=g)
            for a, b, c, d, e, f, g in table("brackets", 7)
        )
        jobs = tuple((Purpose(a), b, c) for a, b, c in table("jobs", 3))
    except ValueError as error:
        raise DocumentError(f"brackets, jobs: {error}") from None
    if len(jobs) != ledger.in_flight + len(ledger.queue):
        raise DocumentError(
            f"jobs: expected one for each of {ledger.in_flight + len(ledger.queue)} candidates, got {len(jobs)}"
        )
    seeds, tries = ({a: b for a, b in table(name, 2)} for name in ("seeds", "tries"))  # noqa: C416
    resolved = tuple(place for (place,) in table("resolved", 1))
    partnered = document.header.get("partnered")
    if not isinstance(partnered, int) or not 0 <= partnered <= ledger.spent:
        raise DocumentError(f"partnered: expected a number from 0 to {ledger.spent}, got {partnered!r:.80}")
    simulated = set(ledger.archive.numbers.tolist())
    unsafe = set(ledger.archive.numbers[ledger.archive.unsafe].tolist())
    numbered = set(range(ledger.spent + ledger.in_flight + len(ledger.queue)))
    _check_references("brackets", {n for b in brackets for n in (b.safe, b.unsafe)}, simulated)
    _check_references("brackets", {b.seed for b in brackets}, numbered)
    if any(b.safe in unsafe or b.unsafe not in unsafe for b in brackets):
        raise DocumentError("brackets: a side does not have the verdict of its side")
    _check_references("seeds", {n for both in seeds.items() for n in both}, numbered)
    _check_references("tries", tries.keys(), simulated)
    _check_references("resolved", set(resolved), set(range(len(brackets))))
    for purpose, of, side in jobs:
        if purpose is Purpose.PARTNER:
            _check_references("jobs", {of}, simulated)
        elif purpose in (Purpose.PROBE, Purpose.CHECK):
            _check_references("jobs", {of}, set(range(len(brackets))))
            _check_references("jobs", {side}, {0, 1})
    return EdgeState(
        config=config,
        ledger=ledger,
        brackets=brackets,
        jobs=jobs,
        seeds=seeds,
        tries=tries,
        partnered=partnered,
        resolved=resolved,
        prior=Prior.of(ledger.known, Steps(ledger.space), config.eps),
    )


def _check_references(name: str, named: Set[int], known: Set[int]) -> None:
    if unknown := named - known:
        raise DocumentError(f"{name}: {min(unknown)} is none of the solutions or brackets of this campaign")
