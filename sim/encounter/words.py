"""Scripts in words: who does what, from where, for how long."""

import math
from collections.abc import Mapping
from typing import Final

from brink.sim.episode import Json

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
_TOLD: Final = 3


def words_of_script(script: Mapping[str, Json]) -> str:
    """Return a road user's script as a few words: where it starts, and what it does that is no mere going on."""
    stretches = script["stretches"]
    assert isinstance(stretches, list)
    steps = [stretch for stretch in stretches if isinstance(stretch, Mapping)]
    telling = dict.fromkeys(str(step["action"]) for step in steps if step["action"] != "keep")
    acts = [_ACTIONS.get(action, action.replace("_", " ")) for action in telling]
    shown = ", ".join(acts[:_TOLD]) or "goes on"
    return f"{script['kind']} {_start(steps[0])}: {shown}{', …' if len(acts) > _TOLD else ''}"


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
