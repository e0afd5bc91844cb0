"""HDF5 files of unknown origin, opened in a process with limits."""
