"""Finding the symmetries of a mesh: candidates from its convex hull, verified by surface distance."""
