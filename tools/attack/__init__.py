"""What files of unknown origin must not do: damaged and hostile input for every reader, and how each attempt ends."""
