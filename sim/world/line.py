"""Reference lines: smooth plane curves of straights and arcs, with stations along them and offsets across them.

A line starts at station 0 and continues straight beyond both ends, so that every station and every nearby point has
coordinates. Offsets are positive to the left of the direction of travel.
"""

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

RUN_OUT_M = 2000.0
"""Length of the straight extension beyond each end of a line."""

_TWO_PI = 2.0 * math.pi


@dataclass(frozen=True, slots=True)
class Piece:
    """A straight or an arc: length in m, signed curvature in 1/m, positive to the left."""

    length_m: float
    curvature_1pm: float = 0.0


class ReferenceLine:
    """A smooth curve of straights and arcs. Immutable.

    Args:
        x_m: Start point.
        y_m: Start point.
        yaw_rad: Direction at the start.
        pieces: At least one, each longer than 0.
    """

    __slots__ = ("_inner_starts", "_rows", "length_m", "pieces", "start")

    def __init__(self, x_m: float, y_m: float, yaw_rad: float, pieces: Sequence[Piece]) -> None:
        if not pieces or any(piece.length_m <= 0 for piece in pieces):
            raise ValueError(f"pieces: expected at least one, each longer than 0 m, got {pieces!r}")
        self.start = (x_m, y_m, yaw_rad)
        self.pieces = tuple(pieces)
        self.length_m = math.fsum(piece.length_m for piece in pieces)
        cos_yaw, sin_yaw = math.cos(yaw_rad), math.sin(yaw_rad)
        x_m -= RUN_OUT_M * cos_yaw
        y_m -= RUN_OUT_M * sin_yaw
        station_m = -RUN_OUT_M
        rows: list[tuple[float, float, float, float, float, float, float, float]] = []
        for piece in (Piece(RUN_OUT_M), *pieces, Piece(RUN_OUT_M)):
            rows.append(
                (
                    station_m,
                    piece.length_m,
                    x_m,
                    y_m,
                    yaw_rad,
                    piece.curvature_1pm,
                    math.cos(yaw_rad),
                    math.sin(yaw_rad),
                )
            )
            x_m, y_m, yaw_rad = _advance(x_m, y_m, yaw_rad, piece.curvature_1pm, piece.length_m)
            station_m = 0.0 if len(rows) == 1 else station_m + piece.length_m
        self._rows = tuple(rows)
        self._inner_starts = tuple(row[0] for row in rows[1:])

    def pose_at(self, station_m: float, offset_m: float = 0.0) -> tuple[float, float, float]:
        """Return (x_m, y_m, yaw_rad) at a station and offset."""
        row = self._rows[bisect_right(self._inner_starts, station_m)]
        start_m, _, x_m, y_m, yaw_rad, curvature, cos_yaw, sin_yaw = row
        along_m = station_m - start_m
        if curvature == 0.0:
            return (
                x_m + along_m * cos_yaw - offset_m * sin_yaw,
                y_m + along_m * sin_yaw + offset_m * cos_yaw,
                yaw_rad,
            )
        heading = yaw_rad + curvature * along_m
        cos_end, sin_end = math.cos(heading), math.sin(heading)
        return (
            x_m + (sin_end - sin_yaw) / curvature - offset_m * sin_end,
            y_m - (cos_end - cos_yaw) / curvature + offset_m * cos_end,
            heading,
        )

    def curvature_at(self, station_m: float) -> float:
        """Return the signed curvature in 1/m."""
        return self._rows[bisect_right(self._inner_starts, station_m)][5]

    def station_after(self, station_m: float, offset_m: float, distance_m: float) -> float:
        """Return the station reached after a distance beside the line, which is longer outside a bend.

        Args:
            station_m: Station at the start.
            offset_m: Distance from the line, less than the radius on the inside of a bend.
            distance_m: Length of the way, negative against the direction of travel.
        """
        index = bisect_right(self._inner_starts, station_m)
        ahead = distance_m > 0.0
        while True:
            start_m, length_m, *_ = row = self._rows[index]
            stretch = 1.0 - row[5] * offset_m
            to_end_m = start_m + (length_m if ahead else 0.0) - station_m
            last = index + 1 == len(self._rows) if ahead else index == 0
            if last or abs(distance_m) <= abs(to_end_m) * stretch:
                return station_m + distance_m / stretch
            distance_m -= to_end_m * stretch
            station_m += to_end_m
            index += 1 if ahead else -1

    def project(self, x_m: float, y_m: float, near_station_m: float) -> tuple[float, float]:
        """Return (station, offset) of the closest point on the line near a known station.

        The search moves piece by piece from the known station, so the result is local: a line may return close to an
        earlier part of itself.

        Args:
            x_m: Point to project.
            y_m: Point to project.
            near_station_m: Station at which the search starts.
        """
        rows = self._rows
        index = bisect_right(self._inner_starts, near_station_m)
        came_from = -1
        while True:
            start_m, length_m, x0_m, y0_m, yaw_rad, curvature, cos_yaw, sin_yaw = rows[index]
            dx, dy = x_m - x0_m, y_m - y0_m
            if curvature == 0.0:
                along_m = dx * cos_yaw + dy * sin_yaw
                offset_m = dy * cos_yaw - dx * sin_yaw
            else:
                radius_m = 1.0 / curvature
                centre_x, centre_y = -radius_m * sin_yaw, radius_m * cos_yaw
                from_x, from_y = dx - centre_x, dy - centre_y
                distance_m = math.sqrt(from_x * from_x + from_y * from_y)
                side = 1.0 if curvature > 0.0 else -1.0
                turned = math.atan2(side * from_y, side * from_x) - (yaw_rad - 0.5 * math.pi)
                turned = (turned + math.pi) % _TWO_PI - math.pi
                along_m = turned * radius_m
                offset_m = radius_m - side * distance_m
            step = -1 if along_m < 0.0 else (1 if along_m > length_m else 0)
            following = index + step
            if step == 0 or following == came_from or not 0 <= following < len(rows):
                return start_m + along_m, offset_m
            came_from, index = index, following

    def parallel(self, offset_m: float) -> Self:
        """Return the parallel line at an offset.

        Raises:
            ValueError: The offset reaches the centre of an arc.
        """
        pieces = []
        for piece in self.pieces:
            shrink = 1.0 - piece.curvature_1pm * offset_m
            if shrink <= 0:
                raise ValueError(
                    f"offset_m: {offset_m} reaches the centre of an arc with a curvature of {piece.curvature_1pm} 1/m"
                )
            pieces.append(Piece(piece.length_m * shrink, piece.curvature_1pm / shrink))
        x_m, y_m, yaw_rad = self.pose_at(0.0, offset_m)
        return type(self)(x_m, y_m, yaw_rad, pieces)

    def backwards(self) -> Self:
        """Return the same curve, travelled from end to start."""
        x_m, y_m, yaw_rad = self.pose_at(self.length_m)
        pieces = [Piece(piece.length_m, -piece.curvature_1pm) for piece in reversed(self.pieces)]
        return type(self)(x_m, y_m, yaw_rad + math.pi, pieces)

    def up_to(self, station_m: float, *then: Piece) -> Self:
        """Return the line from its start to a station > 0, followed by the given pieces."""
        pieces: list[Piece] = []
        left_m = station_m
        for piece in (*self.pieces, Piece(RUN_OUT_M)):
            taken_m = min(left_m, piece.length_m)
            if taken_m > 0:
                pieces.append(Piece(taken_m, piece.curvature_1pm))
            left_m -= taken_m
        return type(self)(*self.start, [*pieces, *then])

    def pieces_from(self, station_m: float) -> tuple[Piece, ...]:
        """Return the rest of the line from a station on, at least 1 m."""
        pieces: list[Piece] = []
        skip_m = station_m
        for piece in self.pieces:
            skipped_m = min(skip_m, piece.length_m)
            skip_m -= skipped_m
            if piece.length_m > skipped_m:
                pieces.append(Piece(piece.length_m - skipped_m, piece.curvature_1pm))
        return tuple(pieces) or (Piece(1.0),)


def _advance(
    x_m: float, y_m: float, yaw_rad: float, curvature_1pm: float, length_m: float
) -> tuple[float, float, float]:
    if curvature_1pm == 0.0:
        return x_m + length_m * math.cos(yaw_rad), y_m + length_m * math.sin(yaw_rad), yaw_rad
    end_rad = yaw_rad + curvature_1pm * length_m
    return (
        x_m + (math.sin(end_rad) - math.sin(yaw_rad)) / curvature_1pm,
        y_m - (math.cos(end_rad) - math.cos(yaw_rad)) / curvature_1pm,
        end_rad,
    )
