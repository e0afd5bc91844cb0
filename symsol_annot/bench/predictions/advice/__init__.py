"""What mends a predictions file that is refused."""
