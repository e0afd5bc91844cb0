"""The predictions file: its format, its reader, its writers."""
