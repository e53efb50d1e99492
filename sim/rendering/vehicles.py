"""Owns vehicles as models, upright or overturned.

A vehicle is drawn in its box: it touches its length, its width, its height and the ground.
"""

from functools import lru_cache

import numpy as np

from brink.sim.rendering.bodywork import Bodywork
from brink.sim.rendering.looks import choice
from brink.sim.rendering.meshes import Mesh, mesh_of


@lru_cache(maxsize=512)
def vehicle_mesh(look: int, length_m: float, width_m: float, height_m: float) -> Mesh:
    """Return an upright vehicle that fills its box."""
    builder = Bodywork(look, length_m, width_m, height_m)
    return mesh_of(
        builder.faces(turned=False),
        floor=((0.0, 0.0, 1.0), builder.floor_m),
        belt=((0.0, 0.0, 1.0), builder.belt_m),
    )


@lru_cache(maxsize=64)
def overturned_mesh(look: int, length_m: float, width_m: float, height_m: float) -> Mesh:
    """Return a vehicle on its roof or on one of its sides that fills its box."""
    way = choice(look, 5, 3)
    if way == 0:
        builder = Bodywork(look, length_m, width_m, height_m)
        turn = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])
        shift = np.array([0.0, 0.0, height_m])
    else:
        side = 1.0 if way == 1 else -1.0
        builder = Bodywork(look, length_m, height_m, width_m)
        turn = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -side], [0.0, side, 0.0]])
        shift = np.array([0.0, side * width_m / 2, height_m / 2])
    faces = []
    for face in builder.faces(turned=True):
        corners = (np.array(face.corners) @ turn.T + shift).tolist()
        faces.append(face._replace(corners=corners))
    x, y, z = turn[:, 2].tolist()
    lift = float(turn[:, 2] @ shift)
    return mesh_of(faces, floor=((x, y, z), builder.floor_m + lift), belt=((x, y, z), builder.belt_m + lift))
