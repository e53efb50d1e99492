"""Python access to a coordinator."""
