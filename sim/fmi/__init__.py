"""Functional Mock-up Units (FMI 2 and 3, co-simulation): what they say of themselves, and how they are stepped."""

from brink.sim.fmi.instance import FmuFailed, Instance, Reader
from brink.sim.fmi.model import FmuError, Model, Variable, builds_for_here, builds_in, read_model

__all__ = (
    "FmuError",
    "FmuFailed",
    "Instance",
    "Model",
    "Reader",
    "Variable",
    "builds_for_here",
    "builds_in",
    "read_model",
)
