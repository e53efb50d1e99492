"""Time a frame of the renderer at each size, in CPU time: ``python benchmarks/rendering_cost.py``."""

import argparse
import statistics
import time

import cv2

from brink.sim.rendering.canvas import visible_bodies
from brink.sim.rendering.renderer import Renderer
from brink.sim.rendering.sample import EGO, sample_street, sample_traffic
from brink.sim.rendering.scene import Light, PictureCamera, Viewpoint
from brink.sim.world.scenario import TimeOfDay, Weather

SIZES = ((320, 192, 5.0), (640, 360, 8.0), (800, 600, None), (1280, 720, 17.0))
LIGHTS = (
    (TimeOfDay.NOON, Weather.CLEAR),
    (TimeOfDay.SUNSET, Weather.CLOUDY),
    (TimeOfDay.NIGHT, Weather.CLEAR),
    (TimeOfDay.NOON, Weather.HARD_RAIN),
    (TimeOfDay.NIGHT, Weather.HARD_RAIN),
)


def measure(renderer: Renderer, frames: int) -> tuple[float, float]:
    """Return the median ms of a frame and of its labels, while the ego drives and people walk."""
    drawing, labelling = [], []
    for number in range(-3, frames):
        viewpoint = Viewpoint(x_m=EGO.x_m + 0.05 * number, y_m=EGO.y_m, yaw_rad=0.0)
        bodies = sample_traffic(0.1 * number)
        begun = time.process_time_ns()
        frame = renderer.frame(viewpoint, bodies, 0.1 * number)
        drawn = time.process_time_ns()
        visible_bodies(frame)
        labelled = time.process_time_ns()
        if number >= 0:
            drawing.append((drawn - begun) / 1e6)
            labelling.append((labelled - drawn) / 1e6)
    return statistics.median(drawing), statistics.median(labelling)


def main() -> None:
    """Print a table: size, light, median ms of frame and labels, target."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=60, help="how many frames each median is over")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    street = sample_street()
    print(f"{'size':>9} {'light':>18} {'frame ms':>9} {'labels ms':>10} {'target ms':>10}")
    for width_px, height_px, target in SIZES:
        for time_of_day, weather in LIGHTS:
            camera = PictureCamera(width_px=width_px, height_px=height_px)
            renderer = Renderer(street, Light(time_of_day=time_of_day, weather=weather), camera, 3)
            frame_ms, labels_ms = measure(renderer, arguments.frames)
            size, light = f"{width_px}x{height_px}", f"{time_of_day} {weather}"
            wanted = "-" if target is None else f"{target:g}"
            verdict = "" if target is None else ("met" if frame_ms <= target else "MISSED")
            print(f"{size:>9} {light:>18} {frame_ms:>9.2f} {labels_ms:>10.2f} {wanted:>10} {verdict}")


if __name__ == "__main__":
    main()
