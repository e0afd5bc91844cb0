"""What a stranger's files must not do: damaged and hostile input for every reader, and how each attempt ends."""
