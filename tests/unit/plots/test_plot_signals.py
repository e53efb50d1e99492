"""Signals of episodes over time."""

from typing import Any

import numpy as np

from brink.plots.signals import Recorded, figure_signals

TIME_S = np.arange(0, 5, 0.5)
REQUIREMENTS: dict[str, dict[str, Any]] = {
    "keep-gap": {"signal": "gap_m", "above": 1.5, "unit": "m"},
    "smooth": {"stl": "always abs(jerk) < 2", "unit": "m/s3"},
}


def side(label: str, colour: str, violated_at_s: dict[str, float]) -> Recorded:
    return Recorded(
        label=label,
        colour=colour,
        time_s=TIME_S,
        signals={"gap_m": 4 - TIME_S, "speed_mps": TIME_S},
        margins={"keep-gap": 2.5 - TIME_S, "smooth": np.full(len(TIME_S), np.inf)},
        violated_at_s=violated_at_s,
    )


def test_both_sides_share_an_axis_with_the_threshold_and_the_moment_of_the_violation() -> None:
    sides = [side("safe", "blue", {}), side("unsafe", "red", {"keep-gap": 3.0})]
    gap, smooth, speed = figure_signals(sides, REQUIREMENTS, "a pair", "its facts").axes
    titles = [axes.get_title(loc="left") for axes in (gap, smooth, speed)]
    assert titles == ["keep-gap: gap_m (m)", "smooth: always abs(jerk) < 2 (m/s3)", "speed_mps"]
    lines = [(line.get_color(), *np.array(line.get_data())[:, :2].tolist()) for line in gap.lines]
    assert ("blue", [0.0, 0.5], [4.0, 3.5]) in lines
    assert ("red", [0.0, 0.5], [4.0, 3.5]) in lines
    assert any(ydata == [1.5, 1.5] for _, _, ydata in lines), "the threshold"
    assert ("red", [3.0, 3.0], [0, 1]) in lines, "the moment"
    assert "violated at 3.00 s" in "".join(text.get_text() for text in gap.texts)
    assert not [text for text in speed.texts if "violated" in text.get_text()]
