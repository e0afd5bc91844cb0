"""The benchmark: predictions in, recall, precision and F-measure out. Scoring needs neither torch nor Blender."""
