"""Access to a coordinator from Python."""
