"""BOP, the benchmark of object poses: sets in the format that its toolkit reads, its results as predictions."""
