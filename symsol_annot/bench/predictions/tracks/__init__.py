"""The tracks of a predictions file: one object per track, with all that is known of it, in one table."""
