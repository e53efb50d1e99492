"""Errors of the perturbations.

SimulatorError
└── PerturbationError
    ├── InvalidPerturbation  final, an InvalidEpisode too: an unknown gene or level; fix the specification
    ├── InvalidFrame         what was given is not an RGB uint8 picture
    ├── PerturbationFailed   a transform broke, or returned something else than a picture; names the gene
    └── VisionMissing        OpenCV is not installed here
"""

from brink.sim.errors import InvalidEpisode, SimulatorError


class PerturbationError(SimulatorError):
    """Root of everything that the perturbations raise on purpose."""


class InvalidPerturbation(PerturbationError, InvalidEpisode):
    """No such gene, or no such level of it."""


class InvalidFrame(PerturbationError):
    """What was given is not an RGB uint8 picture of a usable size."""


class PerturbationFailed(PerturbationError):
    """A transform broke, or returned something else than a picture of the same size; names the gene."""


class VisionMissing(PerturbationError):
    """OpenCV is not installed on this machine."""
