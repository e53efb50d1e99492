"""The search algorithms that come with Brink."""
