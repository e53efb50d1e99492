"""Find where a driving system with a machine-learned component stops being safe."""

__version__ = "0.1.0"
