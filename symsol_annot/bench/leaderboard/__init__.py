"""Results that were sent in, checked, and their page."""
