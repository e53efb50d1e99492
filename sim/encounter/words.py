"""Scripts in words: who does what, from where, for how long."""

import math
from collections.abc import Mapping, Sequence
from typing import Final

from sim.episode import Json

_ACTIONS: Final = {
    "keep": "goes on",
    "accelerate": "accelerates",
    "decelerate": "slows down",
    "brake": "brakes hard",
    "change_left": "moves to its left",
    "change_right": "moves to its right",
    "cut_in": "cuts in",
    "cross": "crosses the road",
}


def words_of_script(script: Mapping[str, Json]) -> str:
    """Return a road user's script as a line of words."""
    stretches = script["stretches"]
    assert isinstance(stretches, list)
    steps = [stretch for stretch in stretches if isinstance(stretch, Mapping)]
    first = steps[0]
    return f"{script['kind']} {_start(first)}: {', then '.join(_acts(steps))}"


def _start(first: Mapping[str, Json]) -> str:
    s_m, d_m, heading = (float(str(first[name])) for name in ("s_m", "d_m", "heading_rad"))
    along = f"{abs(s_m):.0f} m {'ahead' if s_m >= 0 else 'behind'}"
    side = "" if abs(d_m) < 1.0 else f", {abs(d_m):.1f} m to the {'left' if d_m > 0 else 'right'}"
    speed = float(str(first["speed_mps"]))
    comes = ""
    if math.cos(heading) < -0.5:
        comes = ", oncoming"
    elif abs(math.sin(heading)) > 0.5:
        comes = ", crossing"
    return f"{along}{side}{comes} at {speed:.0f} m/s"


def _acts(steps: Sequence[Mapping[str, Json]]) -> list[str]:
    """Return what is done, equal neighbours joined."""
    joined: list[tuple[str, float]] = []
    for step in steps:
        action, lasts_s = str(step["action"]), float(str(step["lasts_s"]))
        if joined and joined[-1][0] == action:
            joined[-1] = (action, joined[-1][1] + lasts_s)
        else:
            joined.append((action, lasts_s))
    return [f"{_ACTIONS.get(action, action.replace('_', ' '))} {lasts_s:.1f} s" for action, lasts_s in joined]
