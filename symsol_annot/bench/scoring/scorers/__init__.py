"""How each track is scored: what is measured of an image, and the metrics made of it."""
