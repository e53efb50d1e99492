"""Errors of the pictures.

SimulatorError
└── RenderingError          root of what this package raises on purpose
    ├── InvalidScene        final: a body, a building or a surface cannot be drawn; fix it
    └── InvalidCamera       final: no picture of this size or with this view can be made
"""

from brink.sim.errors import SimulatorError


class RenderingError(SimulatorError):
    """Root of everything that the pictures raise on purpose."""


class InvalidScene(RenderingError):
    """Something that is to be drawn has an impossible size, place or id."""


class InvalidCamera(RenderingError):
    """The camera has an impossible size, place or field of view."""
