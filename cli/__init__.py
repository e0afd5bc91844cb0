"""The command `symsol-annot`: a small module a command, which parses, calls the library and prints."""
