"""The modular driving system under test: everything after the obstacle detector, from image boxes to commands."""
