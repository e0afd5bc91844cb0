"""The HDF5 shard: its header, its writer and its reader."""
