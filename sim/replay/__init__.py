"""Replays of episodes: still images, videos, and plots over time."""

from brink.sim.replay.pair import DrivePair, Side
from brink.sim.replay.render import render, render_bytes, render_pair, render_pair_maps
from brink.sim.replay.scene import ReplayError

__all__ = ["DrivePair", "ReplayError", "Side", "render", "render_bytes", "render_pair", "render_pair_maps"]
