"""The built-in search algorithms."""
