"""Problems: each connects a search space to a simulator and a verdict."""
