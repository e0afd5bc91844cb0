"""Importing: from a mesh file of any program to the folder of an object."""
