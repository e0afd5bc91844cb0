"""Sealed tests: a secret and its commitment, images without labels, and what shows later that nobody cheated."""
