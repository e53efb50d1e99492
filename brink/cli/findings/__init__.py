"""What campaigns find beyond the boundary: said, written and drawn at the end of a run, and by commands."""
