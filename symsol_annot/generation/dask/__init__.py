"""Shards made on a Dask cluster."""
