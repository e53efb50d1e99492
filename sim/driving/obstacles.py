"""From image boxes to obstacles on the route: localisation, tracking and prediction.

**Localisation** places a box on the ground. Each part of the box determines one quantity:

- **Bottom edge**: the distance. The edge is projected back to the ground as the obstacle's nearest point.
- **Height**: the distance of a box whose bottom edge lies above the horizon, or so little below it that the place
  would be farther than `max_ground_range_m`, where one pixel corresponds to ten metres. Such a box is placed where an
  object of its label's assumed height would look that tall.
- **Left and right edges**: the lateral position and extent at that distance, and so whether the obstacle stands in
  the lane, at its edge, or outside. A body of the label's usual size, aligned with the lane (known from the map), is
  shifted sideways until its image matches the box, so that the visible side of a vehicle does not count as width. The
  obstacle is wider or narrower than usual by as much as the box differs from that image.
- **Label**: the assumed height, length and width.

A box that the image border cuts on one side is placed by its other edge alone.

**Tracking** assigns each place to the track of the same label whose predicted position is nearest within a gate that
widens with distance, or whose last box it overlaps. A track is tentative at its first hit, confirmed after
`birth_hits`, and dropped after `death_misses` misses in a row (a tentative one at the first miss); between hits it
moves at its velocity. So a box must appear twice to matter, and matters for half a second after it disappears. An
alpha-beta filter in world coordinates estimates position and velocity. Its gains are those of least squares for the
first hits and fall to the steady state of the tracking index (Kalata 1984), which accounts for the noise of distant
places: the same motion in the image changes the estimate less for a distant obstacle. The planner's idea of an
obstacle's velocity therefore follows from how its box moves and grows between frames, together with the ego's motion.

**Prediction** holds velocity constant along and across the route for three seconds, not in the plane: on a bend, a
vehicle that keeps its lane is predicted to keep it; on a straight the two are equivalent.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from operator import itemgetter
from typing import NamedTuple, Protocol

from brink.sim.driving.camera import Camera
from brink.sim.driving.interface import Box, EgoState, ObstacleLabel, Route
from brink.sim.driving.settings import LocalisationSettings, PredictionSettings, TrackingSettings


class Place(NamedTuple):
    """Position of a box on the ground.

    Attributes:
        label: Label of the box.
        x_m: Centre of the assumed body.
        y_m: Centre of the assumed body.
        width_m: Extent across the lane.
        length_m: Extent along the lane.
        sigma_m: Standard deviation of the distance.
        is_cut: Whether the obstacle may extend beyond the left or right image border.
        box: The box.
    """

    label: ObstacleLabel
    x_m: float
    y_m: float
    width_m: float
    length_m: float
    sigma_m: float
    is_cut: bool
    box: Box


class Localiser(Protocol):
    """Places boxes on the ground."""

    def locate(self, ego: EgoState, boxes: tuple[Box, ...]) -> list[Place]:
        """Return the position of each box that can be placed on the ground, in the order of the boxes."""


class GroundPlaneLocaliser:
    """Places boxes by back-projection on level ground, using lane directions from the map.

    Args:
        route: Provides lane directions.
        camera: Camera that the boxes come from.
        settings: Assumed sizes and limits.
    """

    __slots__ = ("_camera", "_route", "_settings")

    def __init__(self, route: Route, camera: Camera, settings: LocalisationSettings) -> None:
        self._route = route
        self._camera = camera
        self._settings = settings

    def locate(self, ego: EgoState, boxes: tuple[Box, ...]) -> list[Place]:
        """Return one place for each box of positive, finite extent, in the order of the boxes."""
        if not boxes:
            return []
        settings, camera, route = self._settings, self._camera, self._route
        cos_yaw, sin_yaw = math.cos(ego.yaw_rad), math.sin(ego.yaw_rad)
        camera_x = ego.x_m + camera.forward_m * cos_yaw
        camera_y = ego.y_m + camera.forward_m * sin_yaw
        noise = settings.pixel_noise_px / (camera.focal_px * camera.height_m)
        first_px, last_px = settings.border_px, camera.width_px - settings.border_px
        places = []
        # The body's pitch moves rows; it is known from the acceleration but for its swinging.
        shift_px = -camera.focal_px * settings.pitch_rad_per_mps2 * ego.accel_mps2
        for seen in boxes:
            label, x_min, x_max, y_min, y_max = seen
            box = Box(label, x_min, x_max, y_min + shift_px, y_max + shift_px)
            near = self.depth_m(box)
            if near is None:
                continue
            # Tangents of the directions to the box's edges, positive to the left.
            left = (camera.centre_x_px - x_min) / camera.focal_px
            right = (camera.centre_x_px - x_max) / camera.focal_px
            if label is ObstacleLabel.PERSON:
                length = width = settings.person_size_m
                turn_rad = 0.0
            else:
                length, width = settings.vehicle_length_m, settings.vehicle_width_m
                ahead, aside = near + 0.5 * length, 0.5 * (left + right) * near
                station_m, _ = route.project(
                    camera_x + ahead * cos_yaw - aside * sin_yaw,
                    camera_y + ahead * sin_yaw + aside * cos_yaw,
                    ego.station_m + near,
                )
                turn_rad = route.pose_at(station_m)[2] - ego.yaw_rad
            is_cut = x_min <= first_px or x_max >= last_px
            if is_cut and right > 0.0:
                depth, aside = _from_inner_edge(near, right, left, length, width)
            elif is_cut and left < 0.0:
                depth, aside = _from_inner_edge(near, -left, -right, length, width)
                aside = -aside
            else:
                depth, aside, width, length = _fitted(near, left, right, length, width, turn_rad)
            places.append(
                Place(
                    label,
                    camera_x + depth * cos_yaw - aside * sin_yaw,
                    camera_y + depth * sin_yaw + aside * cos_yaw,
                    max(width, settings.min_extent_m),
                    max(length, settings.min_extent_m),
                    noise * near * near,
                    is_cut,
                    box,
                )
            )
        return places

    def depth_m(self, box: Box) -> float | None:
        """Return the depth of a box's nearest point; None if the box has no positive, finite extent."""
        return depth_m(box, self._camera, self._settings)


def depth_m(box: Box, camera: Camera, settings: LocalisationSettings) -> float | None:
    """Return the depth of a box's nearest point; None if the box has no positive, finite extent."""
    label, x_min, x_max, y_min, y_max = box
    height = y_max - y_min
    # Written so that a NaN fails the test.
    if not (height > 0 and x_max > x_min and math.isfinite(height + x_max - x_min + y_max + x_max)):
        return None
    depth = camera.ground_depth_m(y_max)
    if depth is None or depth > settings.max_ground_range_m:
        is_person = label is ObstacleLabel.PERSON
        tall = settings.person_height_m if is_person else settings.vehicle_height_m
        depth = min(camera.focal_px * tall / height, settings.max_ground_range_m)
    return max(depth, settings.min_range_m)


def _fitted(
    near: float, left: float, right: float, length: float, width: float, turn_rad: float
) -> tuple[float, float, float, float]:
    """Fit a body to the left and right edges of its image.

    Args:
        near: Depth of its nearest point.
        left: Tangent of the direction to the left edge of its image.
        right: Tangent of the direction to the right edge of its image.
        length: Its usual length.
        width: Its usual width.
        turn_rad: Direction of its lane, relative to the camera's axis.

    Returns:
        Depth and lateral position (positive to the left) of its centre, its width across and length along the lane.
    """
    cos_turn, sin_turn = math.cos(turn_rad), math.sin(turn_rad)
    ahead_1, aside_1 = 0.5 * length * cos_turn, 0.5 * length * sin_turn
    ahead_2, aside_2 = -0.5 * width * sin_turn, 0.5 * width * cos_turn
    depth = near + abs(ahead_1) + abs(ahead_2)
    middle = 0.5 * (left + right)
    aside = middle * depth
    near_1, near_2 = ahead_1 + ahead_2, ahead_1 - ahead_2
    side_1, side_2 = aside_1 + aside_2, aside_1 - aside_2
    depth_1, depth_2, depth_3, depth_4 = depth + near_1, depth - near_1, depth + near_2, depth - near_2
    seen_left = seen_right = 0.0
    # The middle of the image moves almost in proportion to the body: two iterations leave less than a centimetre.
    for _ in range(2):
        tangents = (
            (aside + side_1) / depth_1,
            (aside - side_1) / depth_2,
            (aside + side_2) / depth_3,
            (aside - side_2) / depth_4,
        )
        seen_left, seen_right = max(tangents), min(tangents)
        aside += (middle - 0.5 * (seen_left + seen_right)) * depth
    wider = (left - right - seen_left + seen_right) * near
    return depth, aside, width + wider * abs(cos_turn), length + wider * abs(sin_turn)


def _from_inner_edge(
    near: float, inner: float, border: float, length: float, width: float
) -> tuple[float, float]:
    """Return depth and lateral position of the centre of a body that the image border cuts off.

    Its inner edge is the far end of its inner side. If that side would be outside the image at the nearest depth, the
    nearest visible point is not the body's near end but the point where its inner side enters the image.

    Args:
        near: Depth of the nearest visible point.
        inner: Tangent of the direction to the inner edge, >= 0.
        border: Tangent of the direction to the image border, > `inner`.
        length: The body's usual length.
        width: The body's usual width.
    """
    aside, far = inner * (near + length), near + length
    if aside > border * near:
        aside, far = border * near, border * near / inner
    return far - 0.5 * length, aside + 0.5 * width


class Track:
    """One obstacle over time.

    Args:
        number: Unique in the episode, counting from 1.
        place: The first place.

    Attributes:
        x_m: Centre of its body.
        y_m: Centre of its body.
        standing_since_s: Time at which it stopped; None if it moves or is too new to tell.
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
    """Turns the places of detections into tracks."""

    def update(self, time_s: float, places: Sequence[Place]) -> list[Track]:
        """Process the places of one perception step and return the confirmed tracks, oldest first."""


class AlphaBetaTracker:
    """Associates places with the nearest tracks greedily and smooths them with alpha-beta filters."""

    __slots__ = ("_born", "_settings", "_time_s", "_tracks")

    def __init__(self, settings: TrackingSettings) -> None:
        self._settings = settings
        self._tracks: list[Track] = []
        self._time_s = 0.0
        self._born = 0

    def update(self, time_s: float, places: Sequence[Place]) -> list[Track]:
        """Process the places of one perception step and return the confirmed tracks, oldest first."""
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
        """Return a mapping from track index to place index, for the tracks that have a place."""
        settings = self._settings
        pairs: list[tuple[float, int, int]] = []
        for column, place in enumerate(places):
            label, x_m, y_m, _, _, sigma_m, _, box = place
            x_min_px, x_max_px = box.x_min_px, box.x_max_px
            gate = settings.gate_m + settings.gate_per_sigma * sigma_m
            gate_squared = gate * gate
            for row, track in enumerate(self._tracks):
                if track.label is not label:
                    continue
                dx, dy = x_m - track.x_m, y_m - track.y_m
                squared = dx * dx + dy * dy
                if squared <= gate_squared:
                    pairs.append((squared / gate_squared, row, column))
                # Most are side by side in the image: two comparisons are faster than a call.
                elif (
                    x_min_px < track.box.x_max_px
                    and track.box.x_min_px < x_max_px
                    and overlap(box, track.box) >= settings.min_overlap
                ):
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
                # While the ego passes a standing vehicle, less and less of it is visible; that is not motion.
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
    """Return the position gain and the velocity gain of the n-th hit, n >= 2."""
    index = settings.manoeuvre_mps2 * elapsed_s * elapsed_s / (settings.floor_sigma_m + sigma_m)
    root = (4.0 + index - math.sqrt(index * (8.0 + index))) / 4.0
    steady_alpha = 1.0 - root * root
    steady_beta = 2.0 * (1.0 - root) ** 2  # = 2 (2 - alpha) - 4 sqrt(1 - alpha), with root = sqrt(1 - alpha)
    young = hits * (hits + 1.0)
    alpha = max(2.0 * (2.0 * hits - 1.0) / young, steady_alpha, settings.min_position_gain)
    beta = max(6.0 / young, steady_beta, settings.min_velocity_gain)
    return min(alpha, 1.0), min(beta, 1.0)


def overlap(a: Box, b: Box) -> float:
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


# Not frozen: creating a frozen one takes three times as long.
@dataclass(slots=True, kw_only=True, eq=False)
class RoadObstacle:
    """A tracked obstacle in route coordinates. Treat as immutable.

    Attributes:
        track: Number of the track.
        label: Label of the track.
        near_m: Station of its near end.
        far_m: Station of its far end.
        right_m: Offset of its right end, < `left_m`.
        left_m: Offset of its left end.
        along_mps: Speed along the route, negative if it comes towards the ego.
        across_mps: Speed across the route, positive to the left.
        standing_s: How long it has been standing, 0 if it moves.
        horizon_s: Prediction horizon.
    """

    track: int
    label: ObstacleLabel
    near_m: float
    far_m: float
    right_m: float
    left_m: float
    along_mps: float = 0.0
    across_mps: float = 0.0
    standing_s: float = 0.0
    horizon_s: float = 3.0

    def overlaps(self, right_m: float, left_m: float) -> bool:
        """Return whether the obstacle currently overlaps a range of lateral offsets."""
        return self.left_m > right_m and self.right_m < left_m

    def time_in(self, right_m: float, left_m: float) -> tuple[float, float] | None:
        """Return when the obstacle will enter and leave a range of offsets; None if not within the horizon."""
        speed = self.across_mps
        if speed == 0.0:
            return (0.0, self.horizon_s) if self.overlaps(right_m, left_m) else None
        if speed > 0:
            enters, leaves = (right_m - self.left_m) / speed, (left_m - self.right_m) / speed
        else:
            enters, leaves = (left_m - self.right_m) / speed, (right_m - self.left_m) / speed
        if leaves <= 0 or enters >= self.horizon_s:
            return None
        return max(enters, 0.0), min(leaves, self.horizon_s)


def by_distance(obstacle: RoadObstacle) -> tuple[float, int]:
    """Return a sort key that puts the nearest obstacle first."""
    return obstacle.near_m, obstacle.track


class Predictor(Protocol):
    """Maps tracks to the route and predicts their motion."""

    def predict(
        self, time_s: float, ego: EgoState, tracks: Sequence[Track], age_s: float = 0.0
    ) -> list[RoadObstacle]:
        """Return one obstacle for each track, in the order of the tracks.

        Args:
            time_s: Current time.
            ego: State of the ego.
            tracks: Confirmed tracks.
            age_s: How old the tracks are.
        """


class ConstantVelocityPredictor:
    """Predicts that obstacles keep their velocity along and across the route."""

    __slots__ = ("_route", "_settings")

    def __init__(self, route: Route, settings: PredictionSettings) -> None:
        self._route = route
        self._settings = settings

    def predict(
        self, time_s: float, ego: EgoState, tracks: Sequence[Track], age_s: float = 0.0
    ) -> list[RoadObstacle]:
        """Return one obstacle for each track, in the order of the tracks.

        Args:
            time_s: Current time.
            ego: State of the ego.
            tracks: Confirmed tracks; their station hints are updated.
            age_s: How old the tracks are.
        """
        route, horizon_s = self._route, self._settings.horizon_s
        obstacles = []
        for track in tracks:
            x_m, y_m = track.x_m + age_s * track.vx_mps, track.y_m + age_s * track.vy_mps
            hint_m = track.station_hint_m
            if hint_m is None:
                dx, dy = x_m - ego.x_m, y_m - ego.y_m
                hint_m = ego.station_m + math.sqrt(dx * dx + dy * dy)
            station_m, middle_m = route.project(x_m, y_m, hint_m)
            track.station_hint_m = station_m
            since_s = track.standing_since_s
            along = across = 0.0
            standing_s = 0.0 if since_s is None else time_s - since_s
            # A slow person matters; the velocity of a standing vehicle is noise.
            if since_s is None or track.label is ObstacleLabel.PERSON:
                yaw_rad = route.pose_at(station_m)[2]
                cos_yaw, sin_yaw = math.cos(yaw_rad), math.sin(yaw_rad)
                along = track.vx_mps * cos_yaw + track.vy_mps * sin_yaw
                across = track.vy_mps * cos_yaw - track.vx_mps * sin_yaw
            half_m, half_length_m = 0.5 * track.width_m, 0.5 * track.length_m
            obstacles.append(
                RoadObstacle(
                    track=track.number,
                    label=track.label,
                    near_m=station_m - half_length_m,
                    far_m=station_m + half_length_m,
                    right_m=middle_m - half_m,
                    left_m=middle_m + half_m,
                    along_mps=along,
                    across_mps=across,
                    standing_s=standing_s,
                    horizon_s=horizon_s,
                )
            )
        return obstacles
