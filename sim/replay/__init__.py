"""Replays of episodes: a still picture, a film, plots over time."""

from sim.replay.errors import ReplayError
from sim.replay.render import render, render_bytes, render_png_bytes
from sim.replay.timeline import timeline_figure
from sim.replay.top_down import FramePainter

__all__ = ["FramePainter", "ReplayError", "render", "render_bytes", "render_png_bytes", "timeline_figure"]
