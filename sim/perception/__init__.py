"""Learned components: the detector, its training, adapters for those of users."""
