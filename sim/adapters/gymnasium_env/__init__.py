"""The simulator `gymnasium@1`: a policy in any Gymnasium environment, on observations that are perturbed."""
