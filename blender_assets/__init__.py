"""The built-in objects, a folder each with object.toml and mesh.obj, and `build`, the script that makes them."""
