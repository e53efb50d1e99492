"""Image perturbations for camera frames: 15 genes with 175 levels."""

from brink.sim.perturbations.catalogue import (
    CATALOGUE,
    Frame,
    Gene,
    InvalidFrame,
    InvalidPerturbation,
    PerturbationError,
    PerturbationFailed,
    Transform,
    VisionMissing,
    find_gene,
    register,
)
from brink.sim.perturbations.pipeline import (
    Mode,
    Perturbation,
    Pipeline,
    apply,
    field_of,
    generator,
    parse_perturbations,
)

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
    "field_of",
    "find_gene",
    "generator",
    "parse_perturbations",
    "register",
]
