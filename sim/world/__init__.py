"""The world around the ego: roads, weather, lights, traffic, people, and the ego's own motion."""
