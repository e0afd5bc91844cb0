"""Image sets in folders: their plan and manifest, loading, checking, counting."""
