"""Larger groups of what is left of a surface when some of its faces are taken away, and what is nearly round."""
