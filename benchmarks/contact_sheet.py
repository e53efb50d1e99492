"""Render sample images and contact sheets: ``python -m benchmarks.contact_sheet --out FOLDER``."""

import argparse
import math
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from benchmarks.sample_street import EGO, fallen_tree, person, sample_street, sample_traffic, vehicle
from brink.sim.rendering.renderer import Renderer
from brink.sim.rendering.scene import Body, BodyKind, Light, Picture, PictureCamera, StreetScene
from brink.sim.rendering.street import street_from_road
from brink.sim.world.road import build_road
from brink.sim.world.scenario import RoadCurve, TimeOfDay, Weather

_CAMERA = PictureCamera(width_px=640, height_px=360)
_COLUMNS = 3


def main() -> None:
    """Write all images, and contact sheets that show them side by side."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.contact_sheet", description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="output folder, created if missing")
    parser.add_argument("--seed", type=int, default=3, help="seed of textures, clouds and the sun's position")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    for name, pictures in (("light", _lights(arguments.seed)), ("cases", _cases(arguments.seed))):
        for caption, picture in pictures:
            _write(arguments.out / f"{name}-{caption}.png", picture)
        _write(arguments.out / f"{name}.png", _sheet([_titled(*pair) for pair in pictures]))


def _lights(seed: int) -> list[tuple[str, Picture]]:
    street = sample_street(parked=14, houses=12, trees=9)
    pictures = []
    for time in TimeOfDay:
        for weather in (Weather.CLEAR, Weather.CLOUDY, Weather.WET, Weather.SOFT_RAIN, Weather.HARD_RAIN):
            renderer = Renderer(street, Light(time_of_day=time, weather=weather), _CAMERA, seed)
            pictures.append((f"{time}-{weather}", renderer.frame(EGO, sample_traffic(), 1.0).image))
    return pictures


def _cases(seed: int) -> list[tuple[str, Picture]]:
    street = sample_street(parked=0)
    noon = Light(time_of_day=TimeOfDay.NOON, weather=Weather.CLEAR)
    renderer = Renderer(street, noon, _CAMERA, seed)
    dusk = Renderer(street, Light(time_of_day=TimeOfDay.SUNSET, weather=Weather.CLOUDY), _CAMERA, seed)
    scenes: list[tuple[str, Renderer, Sequence[Body]]] = [
        (f"steps-out-at-{distance_m}-m", renderer, _stepping_out(float(distance_m)))
        for distance_m in (6, 12, 20)
    ]
    turned = BodyKind.OVERTURNED_VEHICLE
    scenes += [
        (
            "oncoming",
            renderer,
            [vehicle(i, 9.0 + 11.0 * i, 1.75, yaw_rad=math.pi, van=i == 2) for i in (1, 2, 3)],
        ),
        ("van-beside", renderer, [vehicle(1, 3.4, 0.6, van=True), vehicle(2, 5.0, -4.2)]),
        ("behind-van", renderer, [vehicle(1, 13.0, -1.2, van=True), person(2, 17.0, -1.4, yaw_rad=1.5)]),
        ("fallen-tree", renderer, [fallen_tree(1, 13.0, -1.0, yaw_rad=1.3), vehicle(2, 22.0, -1.75)]),
        ("fallen-tree-dusk", dusk, [fallen_tree(2, 11.0, -0.5, yaw_rad=-1.2)]),
        ("overturned-1", renderer, [vehicle(1, 12.0, -1.5, yaw_rad=0.9, look=1, kind=turned)]),
        ("overturned-2", renderer, [vehicle(1, 12.0, -1.5, yaw_rad=-0.8, look=2, kind=turned)]),
        ("overturned-3", dusk, [vehicle(1, 12.0, -1.5, yaw_rad=2.0, look=3, kind=turned)]),
    ]
    pictures = [(name, drawn.frame(EGO, bodies, 1.0).image) for name, drawn, bodies in scenes]
    for curve, road_id in ((RoadCurve.LEFT, 0), (RoadCurve.STRAIGHT, 0), (RoadCurve.CROSSROAD, 1)):
        road = street_from_road(build_road(curve, road_id, 1), seed=seed)
        pictures.append((f"road-{curve}", _on(road, noon, seed)))
    return pictures


def _on(street: StreetScene, light: Light, seed: int) -> Picture:
    return Renderer(street, light, _CAMERA, seed).frame(EGO, [vehicle(1, 20.0, -1.75)], 0.0).image


def _stepping_out(distance_m: float) -> list[Body]:
    """Return a person between two parked cars, with the gap `distance_m` ahead of the camera."""
    x_m = distance_m + 1.3
    return [
        vehicle(1, x_m - 3.0, -4.6),
        vehicle(2, x_m + 3.0, -4.6, look=77),
        person(3, x_m, -3.3, yaw_rad=math.pi / 2, phase=1.2),
    ]


def _titled(caption: str, picture: Picture) -> Picture:
    titled = picture.copy()
    cv2.putText(titled, caption, (8, 18), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (0, 0, 0), 3, cv2.LINE_AA)
    cv2.putText(titled, caption, (8, 18), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (255, 255, 255), 1, cv2.LINE_AA)
    return titled


def _sheet(pictures: list[Picture]) -> Picture:
    blank = np.zeros_like(pictures[0])
    padded = pictures + [blank] * (-len(pictures) % _COLUMNS)
    rows = [np.hstack(padded[first : first + _COLUMNS]) for first in range(0, len(padded), _COLUMNS)]
    return np.vstack(rows)


def _write(path: Path, picture: Picture) -> None:
    if not cv2.imwrite(str(path), picture[..., ::-1]):
        raise OSError(f"{path}: cannot be written")


if __name__ == "__main__":
    main()
