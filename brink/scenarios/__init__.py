"""Exchange: recorded drives in formats that other simulators read."""
