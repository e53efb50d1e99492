"""What the tests of the coordinator share: databases, a small problem, workers in process, real processes."""
