"""Scores: from a predictions file to a report."""
