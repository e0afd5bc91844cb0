"""The reference models and their losses."""
