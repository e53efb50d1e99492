"""The world around the ego: roads, weather, lights, traffic, pedestrians, and the ego's motion."""
