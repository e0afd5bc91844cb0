"""Blender's graphics device, opened without a window."""

import bpy
import gpu

from symsol_annot.rendering.engines import Engine

_SIDE = 16  # pixels


def open_device() -> None:
    """Open the device that Blender's module `gpu` draws with: outside Blender's own program, a first render does.

    Where there is no OpenGL, Blender ends the process here.
    """
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.collection.objects.link(camera)
    scene.camera, scene.render.engine = camera, "BLENDER_WORKBENCH"
    scene.render.resolution_x = scene.render.resolution_y = _SIDE
    scene.render.resolution_percentage = 100
    scene.display.render_aa = "OFF"
    bpy.ops.render.render()


def versions(engine: Engine) -> dict[str, str]:
    """Return the software that decides an engine's pixels: Blender, and the OpenGL that it draws with."""
    found = {"bpy": bpy.app.version_string}
    if engine.needs_opengl:
        found["opengl"] = f"{gpu.platform.renderer_get()}; {gpu.platform.version_get()}"
    return found
