"""Pictures of the driving world: what a camera sees, and which pixel belongs to what."""

from brink.sim.rendering.errors import InvalidCamera, InvalidScene, RenderingError
from brink.sim.rendering.renderer import Renderer
from brink.sim.rendering.scene import (
    Body,
    BodyKind,
    Building,
    Frame,
    Ground,
    Lamp,
    Light,
    Material,
    PictureCamera,
    StreetScene,
    Tree,
    Viewpoint,
)
from brink.sim.rendering.visible import PixelBox, VisibleBody, visible_bodies

__all__ = [
    "Body",
    "BodyKind",
    "Building",
    "Frame",
    "Ground",
    "InvalidCamera",
    "InvalidScene",
    "Lamp",
    "Light",
    "Material",
    "PictureCamera",
    "PixelBox",
    "Renderer",
    "RenderingError",
    "StreetScene",
    "Tree",
    "Viewpoint",
    "VisibleBody",
    "visible_bodies",
]
