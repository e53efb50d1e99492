"""Problems: what ties a search space to a simulator and a verdict."""
