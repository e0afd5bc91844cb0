"""The nearest rendered views by their pixels: a baseline that needs no training, and no torch."""
