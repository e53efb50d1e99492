"""Shared by all measurements: figures with targets, progress, percentiles, CPU time and memory of processes."""

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import numpy as np

Progress: TypeAlias = Callable[[str, int, int], None]
"""Called with the name of a part of a measurement, its completed steps and its total steps."""


def silent(part: str, done: int, total: int) -> None:
    """Report no progress."""


_TICKS_PER_S = os.sysconf("SC_CLK_TCK")


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """A measured figure and its target.

    Attributes:
        what: Name of the figure.
        value: Measured value.
        target: The target in words; empty if there is none.
        met: Whether the target is met; None without a target.
        note: Sample sizes and further figures.
    """

    what: str
    value: float
    target: str
    met: bool | None
    note: str = ""


def untargeted(what: str, value: float, note: str = "") -> Row:
    """Return a `Row` without a target."""
    return Row(what=what, value=value, target="", met=None, note=note)


def at_least(what: str, value: float, least: float | None, note: str = "") -> Row:
    """Return a `Row` whose target is a lower bound, if there is one."""
    if least is None:
        return untargeted(what, value, note)
    return Row(what=what, value=value, target=f"at least {least:g}", met=value >= least, note=note)


def at_most(what: str, value: float, most: float | None, note: str = "") -> Row:
    """Return a `Row` whose target is an upper bound, if there is one."""
    if most is None:
        return untargeted(what, value, note)
    return Row(what=what, value=value, target=f"at most {most:g}", met=value <= most, note=note)


def under(what: str, value: float, bound: float, note: str = "") -> Row:
    """Return a `Row` whose target is a strict upper bound: a value equal to the bound misses the target."""
    return Row(what=what, value=value, target=f"under {bound:g}", met=value < bound, note=note)


def counted(progress: Progress, part: str, total: int) -> Iterator[int]:
    """Yield 0 to ``total - 1`` and report each completed step.

    Args:
        progress: Progress callback.
        part: Name of the part that is measured.
        total: Number of steps.
    """
    for number in range(total):
        progress(part, number, total)
        yield number
    progress(part, total, total)


def percentile(values: Sequence[float], percent: int) -> float:
    """Return a percentile of at least one value, interpolated linearly between neighbouring values."""
    return float(np.percentile(values, percent))


def cpu_seconds(pid: int) -> float:
    """Return the user and system CPU time of a process, in seconds."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / _TICKS_PER_S


def memory_mib(pid: int | str) -> float:
    """Return the resident memory of a process in MiB; 0 if it has ended. ``"self"`` is this process."""
    for line in Path(f"/proc/{pid}/status").read_text(encoding="ascii", errors="replace").splitlines():
        if line.startswith("VmRSS:"):
            return int(line.split()[1]) / 1024
    return 0.0


def children_of(pid: int) -> list[int]:
    """Return the ids of a process's children; empty if the process has ended."""
    found: list[int] = []
    try:
        for task in Path(f"/proc/{pid}/task").iterdir():
            found += [int(child) for child in (task / "children").read_text(encoding="ascii").split()]
    except OSError:
        return []
    return found
