"""Scoring what a program holds in memory: whole arrays, or batch by batch."""
