"""Image perturbations: 15 genes in 175 levels, applied to camera frames."""
