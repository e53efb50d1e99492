"""The simulator: roads, road users, the driving system under test, requirements, episodes."""
