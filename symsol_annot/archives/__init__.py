"""A set as one file: packed, downloaded, checked, and unpacked where it belongs."""
