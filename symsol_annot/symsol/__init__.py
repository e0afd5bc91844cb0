"""The original SYMSOL's zip, imported as sets."""
