"""Traffic of hundreds of vehicles in SUMO, in which automated vehicles perceive what is ahead with errors."""
