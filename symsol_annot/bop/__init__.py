"""BOP, the benchmark of object poses: sets in its format, its results as predictions, its images as sets."""
