"""M hypotheses per image (chapters 4 and 5)."""
