"""Objects: a mesh, its symmetry group, its marking."""
