"""Writing a predictions file."""
