"""Errors of learned components."""

from brink.sim.errors import SimulatorError


class DetectorError(SimulatorError):
    """A detector cannot be loaded, or cannot take a picture."""


class DatasetError(SimulatorError):
    """A data set cannot be read: it is not there, or not what it should be."""
