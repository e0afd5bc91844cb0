"""Predictions in other forms, frames and files."""
