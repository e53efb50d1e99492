"""How well many workers are used: simulated ones against a real coordinator."""
