"""The interface for driving systems of users: what a drive begins with, observations in, decisions out.

It has a version, `INTERFACE`, and is stable: attributes may be added, none changes or goes.
"""

from brink.sim.driving.camera import Camera
from brink.sim.driving.interface import (
    Box,
    Crossing,
    EgoState,
    LightReading,
    LightState,
    Observation,
    ObstacleLabel,
    PerceivedObstacle,
    Route,
    SeenObject,
)
from brink.sim.driving_systems.interface import (
    INTERFACE,
    CarLimits,
    Decision,
    DrivingSystem,
    Start,
    TrajectoryPoint,
)

__all__ = (
    "INTERFACE",
    "Box",
    "Camera",
    "CarLimits",
    "Crossing",
    "Decision",
    "DrivingSystem",
    "EgoState",
    "LightReading",
    "LightState",
    "Observation",
    "ObstacleLabel",
    "PerceivedObstacle",
    "Route",
    "SeenObject",
    "Start",
    "TrajectoryPoint",
)
