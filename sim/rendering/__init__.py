"""Camera images of the driving world, with an id mask that tells which body each pixel shows."""

from brink.sim.rendering.canvas import PixelBox, VisibleBody, visible_bodies
from brink.sim.rendering.renderer import Renderer
from brink.sim.rendering.scene import (
    Body,
    BodyKind,
    Building,
    Frame,
    Furniture,
    FurnitureKind,
    Ground,
    InvalidCamera,
    InvalidScene,
    Lamp,
    Light,
    Material,
    PictureCamera,
    RenderingError,
    StreetScene,
    Tree,
    Viewpoint,
)

__all__ = [
    "Body",
    "BodyKind",
    "Building",
    "Frame",
    "Furniture",
    "FurnitureKind",
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
