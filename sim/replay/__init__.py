"""Replays of episodes: still images, videos, and plots over time."""

from brink.sim.replay.render import render, render_bytes
from brink.sim.replay.scene import ReplayError

__all__ = ["ReplayError", "render", "render_bytes"]
