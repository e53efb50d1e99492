"""Image perturbations: 15 genes in 175 levels, applied to camera frames."""

from brink.sim.perturbations.catalogue import CATALOGUE, find_gene, register
from brink.sim.perturbations.errors import (
    InvalidFrame,
    InvalidPerturbation,
    PerturbationError,
    PerturbationFailed,
    VisionMissing,
)
from brink.sim.perturbations.gene import Frame, Gene, Transform
from brink.sim.perturbations.perturbation import Perturbation, mean_intensity, parse_perturbations
from brink.sim.perturbations.pipeline import Mode, Pipeline, apply, generator

__all__ = [
    "CATALOGUE",
    "Frame",
    "Gene",
    "InvalidFrame",
    "InvalidPerturbation",
    "Mode",
    "Perturbation",
    "PerturbationError",
    "PerturbationFailed",
    "Pipeline",
    "Transform",
    "VisionMissing",
    "apply",
    "find_gene",
    "generator",
    "mean_intensity",
    "parse_perturbations",
    "register",
]
