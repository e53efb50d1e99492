"""Search on numpy and scipy alone: spaces, distance, archives, algorithms, metrics."""
