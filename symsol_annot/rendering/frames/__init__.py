"""From a mesh to a frame, and from a frame to a view: what needs no Blender, whatever draws between."""
