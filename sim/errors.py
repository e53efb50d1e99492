"""Errors of the simulator package.

SimulatorError
├── InvalidEpisode      final: the specification can never run; fix it
├── PluginMissing       final: a module that was named for its plug-ins cannot be imported
└── SimulationCrashed   retryable: this run broke; the same specification may run elsewhere
"""


class SimulatorError(Exception):
    """Root of everything that the simulator package raises on purpose."""


class InvalidEpisode(SimulatorError):
    """The specification cannot be run by this simulator, now or ever."""


class PluginMissing(SimulatorError):
    """A module that was named for its plug-ins cannot be imported."""


class SimulationCrashed(SimulatorError):
    """The run broke down; running the same specification again may work."""
