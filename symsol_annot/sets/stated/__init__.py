"""What a set states of itself: the settings that made it, and what its parts break."""
