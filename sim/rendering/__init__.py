"""Pictures of the driving world: what a camera sees, and which pixel belongs to what."""
