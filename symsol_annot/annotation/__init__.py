"""The symmetry set of an image."""
