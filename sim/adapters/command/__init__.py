"""Programs as simulators: their definitions, how an episode runs one, and the signals that it logs."""
