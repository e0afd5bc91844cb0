"""Mesh files of any program: their triangles, and all that tells their parts: materials, colours, nodes."""
