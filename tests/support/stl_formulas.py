"""Random formulas of signal temporal logic, random recordings, and the robustness that rtamt 0.4.10 computes.

``python -m support.stl_formulas`` in tests/ records it, where rtamt (BSD-3-Clause) is installed.
"""

import random
from collections.abc import Iterator
from pathlib import Path
from typing import Final, TypeAlias

Recording: TypeAlias = "tuple[list[float], dict[str, list[float]]]"

RECORDED: Final = Path(__file__).resolve().parents[1] / "data" / "stl_rtamt.json"
FORMULAS: Final = 2_000
SIGNALS: Final = ("x", "y", "z")


def cases() -> Iterator[tuple[str, Recording]]:
    """Return the formulas, each with one of forty unevenly sampled recordings."""
    rng = random.Random(1)
    recordings = [_recording(rng) for _ in range(40)]
    for _ in range(FORMULAS):
        yield _formula(rng, rng.randint(1, 4)), rng.choice(recordings)


def _recording(rng: random.Random) -> Recording:
    times = [0.0]
    for _ in range(rng.randint(5, 40)):
        times.append(round(times[-1] + rng.choice([0.1, 0.2, 0.25, 0.5, rng.uniform(0.01, 1.0)]), 3))
    signals: dict[str, list[float]] = {}
    for name in SIGNALS:
        value = rng.uniform(-1, 1)
        signals[name] = [value := round(value + rng.gauss(0, 0.7), 3) for _ in times]
    return times, signals


def _formula(rng: random.Random, depth: int) -> str:
    if depth == 0 or rng.random() < 0.1:
        left = rng.choice(["x", "y", "z", "x + y", "2 * x - z", "abs(y)", "x * y"])
        right = rng.choice([f"{rng.uniform(-2, 2):.2f}", "z", "y - 0.5"])
        return f"({left}) {rng.choice(['<', '<=', '>', '>='])} ({right})"
    kind = rng.choice(["not", "and", "or", "implies", *["always", "eventually", "until"] * 2])
    bounds = _bounds(rng) if kind in ("always", "eventually", "until") else ""
    if kind in ("not", "always", "eventually"):
        return f"{kind}{bounds} ({_formula(rng, depth - 1)})"
    return f"({_formula(rng, depth - 1)}) {kind}{bounds} ({_formula(rng, depth - 1)})"


def _bounds(rng: random.Random) -> str:
    if rng.random() < 0.25:
        return ""
    begin_s = rng.choice([0, 0, round(rng.uniform(0, 4), 1), round(rng.uniform(0, 4), 2)])
    return f"[{begin_s}:{round(begin_s + rng.uniform(0.1, 5), 2)}]"


def _by_rtamt(formula: str, recording: Recording) -> float:
    """Return the robustness at the first sample by rtamt's offline monitor of dense time."""
    import rtamt  # type: ignore[import-not-found]

    times, signals = recording
    monitor = rtamt.StlDenseTimeSpecification()
    for name in signals:
        monitor.declare_var(name, "float")
    monitor.spec = formula
    monitor.parse()
    named = [
        [name, [list(sample) for sample in zip(times, series, strict=True)]]
        for name, series in signals.items()
    ]
    (begins_s, robustness), *_ = monitor.evaluate(*named)
    assert begins_s == 0.0
    return float(robustness)


if __name__ == "__main__":
    answers = [_by_rtamt(formula, recording) for formula, recording in cases()]
    rows = [", ".join(f"{one:.9g}" for one in answers[i : i + 12]) for i in range(0, len(answers), 12)]
    RECORDED.write_text("[\n" + ",\n".join(rows) + "\n]\n", encoding="utf-8")
