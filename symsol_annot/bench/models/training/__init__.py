"""Training the reference models."""
