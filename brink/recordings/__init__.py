"""Recordings of a detector with ground truth, in common formats, and the detector's errors in them."""
