"""Tracking: which place is which obstacle, how fast it moves, and since when it stands.

A place belongs to the track of its label whose expected position is nearest within a gate that widens with
distance, or whose last box it overlaps. Life cycle: tentative at the first hit, believed (confirmed) after
`birth_hits`, dropped after `death_misses` in a row (a tentative one at the first miss); while it is missed it goes on
at its velocity. So a box must show twice to matter, and matters for half a second after it has gone.

Position and velocity come from an alpha-beta filter in world coordinates. Its gains are those of least squares for
the first hits and fall to the steady state of the tracking index (Kalata 1984), which knows that far places are
noisy: the same box motion far away moves the estimate less than close by. How a box moves and grows between frames,
together with the ego's own motion, is thus what the planner believes the obstacle's velocity to be.
"""

import math
from collections.abc import Sequence
from operator import itemgetter
from typing import Protocol

from brink.sim.driving.interface import Box, ObstacleLabel
from brink.sim.driving.localisation import Place
from brink.sim.driving.settings import TrackingSettings


class Track:
    """One obstacle over time. `x_m`, `y_m` is the centre of its body.

    Attributes:
        number: Unique in the episode, counting from 1.
        standing_since_s: Since when it stands; None if it moves or is too young to tell.
    """

    __slots__ = (
        "box",
        "confirmed",
        "hits",
        "label",
        "length_m",
        "misses",
        "number",
        "standing_since_s",
        "station_hint_m",
        "vx_mps",
        "vy_mps",
        "width_m",
        "x_m",
        "y_m",
    )

    def __init__(self, number: int, place: Place) -> None:
        self.number = number
        self.label: ObstacleLabel = place.label
        self.x_m = place.x_m
        self.y_m = place.y_m
        self.vx_mps = 0.0
        self.vy_mps = 0.0
        self.width_m = place.width_m
        self.length_m = place.length_m
        self.box: Box = place.box
        self.hits = 1
        self.misses = 0
        self.confirmed = False
        self.standing_since_s: float | None = None
        self.station_hint_m: float | None = None


class Tracker(Protocol):
    """Turns places into tracks."""

    def update(self, time_s: float, places: Sequence[Place]) -> list[Track]:
        """Take the places of one perception step and return the confirmed tracks, oldest first."""
        ...


class AlphaBetaTracker:
    """Greedy nearest association, alpha-beta filters."""

    __slots__ = ("_born", "_settings", "_time_s", "_tracks")

    def __init__(self, settings: TrackingSettings) -> None:
        self._settings = settings
        self._tracks: list[Track] = []
        self._time_s = 0.0
        self._born = 0

    def update(self, time_s: float, places: Sequence[Place]) -> list[Track]:
        """Take the places of one perception step and return the confirmed tracks, oldest first."""
        tracks, settings = self._tracks, self._settings
        elapsed_s = max(time_s - self._time_s, 1e-3)
        self._time_s = time_s
        for track in tracks:
            track.x_m += track.vx_mps * elapsed_s
            track.y_m += track.vy_mps * elapsed_s
        matched = self._associate(places) if tracks and places else {}
        if tracks:
            kept = []
            for row, track in enumerate(tracks):
                column = matched.get(row)
                if column is not None:
                    self._correct(track, places[column], elapsed_s, time_s)
                    kept.append(track)
                else:
                    track.misses += 1
                    if track.confirmed and track.misses < settings.death_misses:
                        kept.append(track)
            tracks[:] = kept
        taken = set(matched.values())
        for column, place in enumerate(places):
            if column not in taken:
                self._born += 1
                track = Track(self._born, place)
                track.confirmed = settings.birth_hits <= 1
                tracks.append(track)
        return [track for track in tracks if track.confirmed]

    def _associate(self, places: Sequence[Place]) -> dict[int, int]:
        """Return the place of each track that has one, by their positions in the lists."""
        settings = self._settings
        pairs: list[tuple[float, int, int]] = []
        for column, place in enumerate(places):
            label, x_m, y_m, _, _, sigma_m, _, box = place
            gate = settings.gate_m + settings.gate_per_sigma * sigma_m
            gate_squared = gate * gate
            for row, track in enumerate(self._tracks):
                if track.label is not label:
                    continue
                dx, dy = x_m - track.x_m, y_m - track.y_m
                squared = dx * dx + dy * dy
                if squared <= gate_squared:
                    pairs.append((squared / gate_squared, row, column))
                elif _overlap(box, track.box) >= settings.min_overlap:
                    pairs.append((1.0 + squared / gate_squared, row, column))
        if len(pairs) > 1:
            pairs.sort(key=itemgetter(0, 1, 2))
        matched: dict[int, int] = {}
        taken: set[int] = set()
        for _, row, column in pairs:
            if row not in matched and column not in taken:
                matched[row] = column
                taken.add(column)
        return matched

    def _correct(self, track: Track, place: Place, elapsed_s: float, time_s: float) -> None:
        settings = self._settings
        _, x_m, y_m, width_m, length_m, sigma_m, is_cut, box = place
        track.hits += 1
        track.misses = 0
        alpha, beta = _gains(track.hits, elapsed_s, sigma_m, settings)
        dx, dy = x_m - track.x_m, y_m - track.y_m
        if is_cut:
            beta *= settings.cut_velocity_share
            reach = settings.gate_m + track.length_m
            is_still = track.standing_since_s is not None and track.label is ObstacleLabel.VEHICLE
            if is_still and dx * dx + dy * dy < reach * reach:
                # Passing what stands, less and less of it is in the picture; it has not moved for that.
                track.box = box
                return
        track.x_m += alpha * dx
        track.y_m += alpha * dy
        vx = track.vx_mps + beta * dx / elapsed_s
        vy = track.vy_mps + beta * dy / elapsed_s
        speed = math.sqrt(vx * vx + vy * vy)
        if speed > settings.max_speed_mps:
            vx *= settings.max_speed_mps / speed
            vy *= settings.max_speed_mps / speed
        track.vx_mps, track.vy_mps = vx, vy
        track.width_m += settings.extent_gain * (width_m - track.width_m)
        track.length_m += settings.extent_gain * (length_m - track.length_m)
        track.box = box
        if track.hits >= settings.birth_hits:
            track.confirmed = True
        if track.standing_since_s is None:
            if speed < settings.stands_below_mps and track.hits > 2:
                track.standing_since_s = time_s
        elif speed > settings.moves_above_mps:
            track.standing_since_s = None


def _gains(hits: int, elapsed_s: float, sigma_m: float, settings: TrackingSettings) -> tuple[float, float]:
    """Return the position and velocity gain of the n-th hit, n >= 2."""
    index = settings.manoeuvre_mps2 * elapsed_s * elapsed_s / (settings.floor_sigma_m + sigma_m)
    root = (4.0 + index - math.sqrt(index * (8.0 + index))) / 4.0
    steady_alpha = 1.0 - root * root
    steady_beta = 2.0 * (1.0 - root) ** 2  # = 2 (2 - alpha) - 4 sqrt(1 - alpha), with root = sqrt(1 - alpha)
    young = hits * (hits + 1.0)
    alpha = max(2.0 * (2.0 * hits - 1.0) / young, steady_alpha, settings.min_position_gain)
    beta = max(6.0 / young, steady_beta, settings.min_velocity_gain)
    return min(alpha, 1.0), min(beta, 1.0)


def _overlap(a: Box, b: Box) -> float:
    """Return the intersection over union of two boxes."""
    _, a_left, a_right, a_top, a_bottom = a
    _, b_left, b_right, b_top, b_bottom = b
    wide = (a_right if a_right < b_right else b_right) - (a_left if a_left > b_left else b_left)
    high = (a_bottom if a_bottom < b_bottom else b_bottom) - (a_top if a_top > b_top else b_top)
    if wide <= 0 or high <= 0:
        return 0.0
    shared = wide * high
    union = (a_right - a_left) * (a_bottom - a_top) + (b_right - b_left) * (b_bottom - b_top) - shared
    return shared / union
