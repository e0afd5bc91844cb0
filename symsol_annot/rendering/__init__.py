"""Drawing one object under a rotation, by Blender in a process of its own."""
