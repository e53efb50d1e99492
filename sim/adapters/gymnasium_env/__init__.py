"""The simulator `gymnasium@1`: a policy in any Gymnasium environment, with perturbed observations."""
