"""Replays of episodes: a still picture, a film, plots over time."""

from brink.sim.replay.render import render, render_bytes
from brink.sim.replay.scene import ReplayError

__all__ = ["ReplayError", "render", "render_bytes"]
