"""Pictures to perturb, all perturbations that have an effect, and what they make of a picture."""

import hashlib
from functools import cache

import numpy as np
from drawn_street import draw_street

from brink.sim.perturbations import CATALOGUE, Frame, Perturbation, apply, generator

EFFECTIVE = [Perturbation(gene.name, level) for gene in CATALOGUE.values() for level in range(1, gene.levels)]


drawn = cache(draw_street)


def street(height: int = 180) -> Frame:
    return drawn(height).copy()


def night(height: int = 180) -> Frame:
    """Return the street with no value above 63 of 255."""
    return (drawn(height) // 4).astype(np.uint8)


def blocks(height: int = 180) -> Frame:
    """Return random colours in blocks of 6 px that include every value of every channel."""
    rng = np.random.default_rng(11)
    coarse = rng.integers(0, 256, (height // 6 + 1, height * 16 // 54 + 1, 3), dtype=np.uint8)
    return np.ascontiguousarray(coarse.repeat(6, axis=0).repeat(6, axis=1)[:height, : height * 16 // 9])


def grey(value: int, height: int = 720, width: int = 1280) -> Frame:
    return np.full((height, width, 3), value, dtype=np.uint8)


def perturb(frame: Frame, gene: str, level: int, *, seed: int = 0, field: int = 0, index: int = 0) -> Frame:
    return apply(frame, Perturbation(gene, level), generator(seed, field, index))


def digest(frame: Frame) -> str:
    return hashlib.sha256(np.ascontiguousarray(frame).tobytes()).hexdigest()
