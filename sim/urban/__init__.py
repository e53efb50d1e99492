"""Urban episodes: the detector's behaviour, the episode loop, and the simulator `brink-drive@3`."""
