"""What this program needs of a machine: files, locks, scratch folders, processes, text."""
