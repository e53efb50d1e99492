"""Errors of the replay package.

SimulatorError
└── ReplayError         the picture or film that was asked for cannot be made; the message says what can
"""

from brink.sim.errors import SimulatorError


class ReplayError(SimulatorError, ValueError):
    """The picture or film that was asked for cannot be made from this trace."""
