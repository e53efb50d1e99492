"""The physics engine: the bodies of an episode, and exact clearances between them.

One client per process, without graphics, emptied and refilled for each episode; `physicsClientId` is always passed.
Bodies are upright boxes on level ground, so a clearance is a horizontal distance between rectangles, found by the
engine's closest-point query. Two bodies without mass never report contacts; a contact is therefore a clearance of
zero or less.
"""

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple, NewType

import pybullet

from brink.sim.provenance import versions_with

BodyId = NewType("BodyId", int)
EngineError: type[Exception] = pybullet.error
"""Raised by the engine when it fails."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Block:
    """An upright box on the ground: its size, the centre of its footprint, and its heading."""

    length_m: float
    width_m: float
    height_m: float
    x_m: float
    y_m: float
    yaw_rad: float


class Closest(NamedTuple):
    """Relative position of two bodies.

    Attributes:
        clearance_m: Distance; negative by the depth of an overlap.
        normal_x: Unit vector from the second body to the first.
        normal_y: Unit vector from the second body to the first.
    """

    clearance_m: float
    normal_x: float
    normal_y: float


class Engine:
    """A PyBullet client. Use `process_engine` unless a test needs its own."""

    def __init__(self) -> None:
        self._client = int(pybullet.connect(pybullet.DIRECT))

    @property
    def client(self) -> int:
        """Id of the physics client, which the wheeled ego needs."""
        return self._client

    def reset(self) -> None:
        """Remove all bodies."""
        pybullet.resetSimulation(physicsClientId=self._client)

    def close(self) -> None:
        """Disconnect the client."""
        pybullet.disconnect(physicsClientId=self._client)

    def add_blocks(self, blocks: Sequence[Block]) -> list[BodyId]:
        """Put upright boxes on the ground; they move only through `move` and push nothing.

        Boxes of the same size are created in one call, at a tenth of the cost of creating them one by one.

        Returns:
            The id of each block, in the order of the blocks.
        """
        alike: dict[tuple[float, float, float], list[int]] = {}
        for index, block in enumerate(blocks):
            alike.setdefault((block.length_m, block.width_m, block.height_m), []).append(index)
        ids = [BodyId(-1)] * len(blocks)
        for (length_m, width_m, height_m), members in alike.items():
            shape = pybullet.createCollisionShape(
                pybullet.GEOM_BOX,
                halfExtents=(0.5 * length_m, 0.5 * width_m, 0.5 * height_m),
                physicsClientId=self._client,
            )
            made = pybullet.createMultiBody(
                baseMass=0.0,
                baseCollisionShapeIndex=shape,
                batchPositions=[(blocks[i].x_m, blocks[i].y_m, 0.5 * height_m) for i in members],
                physicsClientId=self._client,
            )
            for index, body in zip(members, made, strict=True):
                ids[index] = BodyId(body)
                pybullet.setCollisionFilterGroupMask(body, -1, 0, 0, physicsClientId=self._client)
                block = blocks[index]
                self.move(ids[index], block.x_m, block.y_m, block.yaw_rad, height_m)
        return ids

    def move(self, body: BodyId, x_m: float, y_m: float, yaw_rad: float, height_m: float) -> None:
        """Move a block to a new pose.

        Args:
            body: Id of the block.
            x_m: Centre of its footprint.
            y_m: Centre of its footprint.
            yaw_rad: Heading.
            height_m: Height of the block.
        """
        pybullet.resetBasePositionAndOrientation(
            body,
            (x_m, y_m, 0.5 * height_m),
            (0.0, 0.0, math.sin(0.5 * yaw_rad), math.cos(0.5 * yaw_rad)),
            physicsClientId=self._client,
        )

    def closest(self, one: BodyId, other: BodyId, within_m: float) -> Closest | None:
        """Return the relative position of two bodies, or None if they are more than `within_m` apart.

        Args:
            one: The first body.
            other: The second body.
            within_m: Maximum clearance to report.
        """
        points = pybullet.getClosestPoints(one, other, within_m, physicsClientId=self._client)
        if not points:
            return None
        nearest = points[0] if len(points) == 1 else min(points, key=_distance_m)
        return Closest(float(nearest[8]), float(nearest[7][0]), float(nearest[7][1]))


def _distance_m(point: tuple[Any, ...]) -> float:
    return float(point[8])


@cache
def process_engine() -> Engine:
    """Return the engine of this process."""
    return Engine()


@cache
def wheels_engine() -> Engine:
    """Return the engine of this process in which a car on wheels moves alone: bodies of others would slow it down."""
    return Engine()


def discard_engine() -> None:
    """Discard the engines of this process, which may be broken; new ones are created when they are needed."""
    for made in (process_engine, wheels_engine):
        engine = made() if made.cache_info().currsize else None
        made.cache_clear()
        if engine is not None:
            with suppress(EngineError):
                engine.close()


@cache
def bullet_versions() -> Mapping[str, str]:
    """Return the versions of everything that determines an episode in this physics engine."""
    api = str(pybullet.getAPIVersion(physicsClientId=process_engine().client))
    return {**versions_with("pybullet"), "pybullet_api": api}
