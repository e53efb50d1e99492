"""Safety requirements: robustness over time, judged on exact facts of the world."""
