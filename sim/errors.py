"""Errors of the simulator package.

SimulatorError
├── InvalidEpisode      final: the specification can never run; fix it
│   └── DrivingSystemFailed  the driving system under test raised an error, or returned no valid decision
├── DefinitionError     final: the definition of a program is malformed, or the program is not here
├── PluginMissing       final here: a plug-in module cannot be imported, or a program is not installed
├── ExtraMissing        final: a simulator needs an optional extra that is not installed here
├── GuardFileError      final: a file is not a guard that this version can use; fit the guard again
└── SimulationCrashed   retryable: this run failed; running the same specification again may work
"""


class SimulatorError(Exception):
    """Base class of all errors that the simulator package raises deliberately."""


class InvalidEpisode(SimulatorError):
    """The specification can never be run by this simulator."""


class DrivingSystemFailed(InvalidEpisode):
    """The driving system under test raised an error, or returned no valid decision.

    It is final: the same drive would fail in the same way.
    """


class DefinitionError(SimulatorError):
    """The definition of a program is malformed, or the program is not on this machine.

    Attributes:
        field: The parameter at fault, such as ``files``.
    """

    def __init__(self, field: str, message: str) -> None:
        super().__init__(message)
        self.field = field


class PluginMissing(SimulatorError):
    """A module listed in ``BRINK_PLUGINS`` cannot be imported, or a user's program is not installed here."""


class ExtraMissing(SimulatorError, ImportError):
    """A simulator needs an optional extra that is not installed here. A worker then does not offer it."""


class GuardFileError(SimulatorError):
    """A file is not a guard, or is one of another version or for other features."""


class SimulationCrashed(SimulatorError):
    """The simulation failed; running the same specification again may work."""
