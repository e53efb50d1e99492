"""Errors of learned components."""

from sim.errors import SimulatorError


class DetectorError(SimulatorError):
    """A detector cannot be loaded, or cannot take a picture."""
