"""A set as a folder of pages: images, their symmetry sets, and predictions over them, opened from disk."""
