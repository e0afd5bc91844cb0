"""A classifier of rotations (chapters 6 and 7)."""
