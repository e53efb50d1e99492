"""A street at night in the rain, and the digest of a frame of it."""

from functools import cache

from benchmarks.sample_street import fallen_tree, sample_street, vehicle
from brink.sim.rendering import BodyKind, Light, PictureCamera, Renderer
from brink.sim.world.scenario import TimeOfDay, Weather

CAMERA = PictureCamera(width_px=320, height_px=192)
STREET = sample_street()
NIGHT_RAIN = Light(time_of_day=TimeOfDay.NIGHT, weather=Weather.HARD_RAIN)
UNUSUAL = (
    fallen_tree(51, 14.0, 1.5, yaw_rad=0.4),
    vehicle(52, 22.0, -1.0, yaw_rad=0.5, kind=BodyKind.OVERTURNED_VEHICLE),
)


@cache
def night() -> Renderer:
    """Return the renderer of the night, one for all tests."""
    return Renderer(STREET, NIGHT_RAIN, CAMERA, 5)
