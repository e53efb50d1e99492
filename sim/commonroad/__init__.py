"""Recorded traffic in the format of CommonRoad: files, roads, the world, and the simulator `commonroad@1`."""
