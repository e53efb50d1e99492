"""A coordinator with a large archive, and one that runs for long."""
