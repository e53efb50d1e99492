"""Replays of episodes: a still picture, a film, plots over time."""

from brink.sim.replay.errors import ReplayError
from brink.sim.replay.render import render, render_bytes, render_png_bytes

__all__ = ["ReplayError", "render", "render_bytes", "render_png_bytes"]
