"""Urban episodes: their scenarios, the detector's behaviour, and the simulator `brink-drive@1`."""
