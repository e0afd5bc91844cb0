"""BOP datasets, read as files of unknown origin."""
