"""Blender as a renderer, in the process that it lives in: the only room that imports bpy and gpu.

Use it through `render_process.RenderProcess`: Blender writes to the terminal past Python, can take the whole process
down, and is not thread-safe. One scene is drawn at a time.
"""
