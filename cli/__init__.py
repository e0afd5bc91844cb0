"""The command `symsol-annot`: a small module per command, which parses, calls the library and prints."""
