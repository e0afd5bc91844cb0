"""Sets as a host wants them: shards with their SHA-256, a Parquet mirror, a dataset card, Croissant, a citation."""
