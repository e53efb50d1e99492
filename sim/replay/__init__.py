"""Replays of episodes: a still picture, a film, plots over time."""

from sim.replay.errors import ReplayError
from sim.replay.render import render, render_bytes, render_png_bytes

__all__ = ["ReplayError", "render", "render_bytes", "render_png_bytes"]
