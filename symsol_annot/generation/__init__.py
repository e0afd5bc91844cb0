"""Making a set: who draws its shards, and how they get into its folder."""
