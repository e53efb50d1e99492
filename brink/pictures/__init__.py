"""Replays of episodes: still images, videos, and plots over time."""

from brink.pictures.pair import DrivePair, Side
from brink.pictures.render import render, render_bytes, render_pair, render_pair_maps
from brink.pictures.scene import ReplayError

__all__ = ["DrivePair", "ReplayError", "Side", "render", "render_bytes", "render_pair", "render_pair_maps"]
