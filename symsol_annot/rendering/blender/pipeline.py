"""The engines of Blender's render pipeline: workbench, cycles and eevee.

A frame is drawn twice: once in its colours, and once in one grey per part, which tells what was hit.
"""

import os
from operator import attrgetter
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import numpy.typing as npt
from PIL.SgiImagePlugin import SgiImageFile

from symsol_annot.errors import RenderError
from symsol_annot.objects.mesh import Mesh
from symsol_annot.rendering.blender import device
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.engines import Drawing, Engine, engine_named
from symsol_annot.rendering.frames.shading import CornerLight, linear, srgb_bytes
from symsol_annot.rendering.frames.supersampling import (
    lanes_of,
    part_pixels_of,
    pixel_averages,
    refuse_strays,
    segmentation_of,
)
from symsol_annot.rendering.renderer import LabelWindow, LitWindow, Scene, View
from symsol_annot.rendering.windows import Window
from symsol_annot.rotations.so3 import Rotations, rotation_to_quat_wxyz
from symsol_annot.system.closing import Closing

Bytes = npt.NDArray[np.uint8]

_COLOURS = "colours"  # the mesh's attribute
_SENSOR_WIDTH = 36.0
_CLIP_MARGIN = 1.5  # bounding-sphere radii in front of and behind the object's centre
_WINDOW_STEP = 8  # sides of windows are multiples of this many pixels: few sizes, few reallocations


class PipelineRenderer(Closing):
    """Draws one scene in this process, which it takes over."""

    def __init__(self, scene: Scene) -> None:
        mesh, settings, self._camera = scene.mesh, scene.settings, scene.camera
        self._engine, self._mesh = engine_named(settings.engine), mesh
        self._n, self._points_per_pixel = settings.samples_per_axis, settings.points_per_pixel
        self._lattice = self._camera.lattice(self._n)
        self._background_colour = settings.background_colour
        self._background = srgb_bytes(np.array(settings.background_colour))
        self._frame = _FrameFile()
        bpy.ops.wm.read_factory_settings(use_empty=True)
        self._blender_scene = bpy.context.scene
        self._light = CornerLight(mesh, scene.part_colours, self._lattice, settings)
        self._greys = _greys(mesh)
        self._object = _add_object(self._blender_scene, mesh)
        self._blender_camera = _add_camera(self._blender_scene, self._camera)
        _set_up_output(self._blender_scene, self._frame.path)
        _set_up_engine(self._blender_scene, self._object.data, self._engine)
        self.render(np.eye(3))  # opens the graphics device: it fails here or not at all

    @property
    def versions(self) -> dict[str, str]:
        """Blender, and the OpenGL it draws with."""
        return device.versions(self._engine)

    def render(self, R_m2c: Rotations) -> View:
        """Draw the window that the object spans, and make a view of it.

        Where the marking is counted in a window of its own, that window is drawn into it: a vertex can round to
        another sub-pixel there, and then a lattice point would differ between picture and count.
        """
        self._object.rotation_quaternion = rotation_to_quat_wxyz(R_m2c)
        whole, counted = self._windows(R_m2c)
        colours = self._frame_of((whole, counted), self._light.colours(R_m2c), self._background_colour)
        ids = self._frame_of((whole, counted), self._greys, (0.0, 0.0, 0.0))[..., 0]
        part_pixels = part_pixels_of(ids, self._n, self._mesh.parts)
        rgb = np.full((self._camera.height, self._camera.width, 3), self._background)
        segmentation = np.zeros(rgb.shape[:2], np.uint8)
        rgb[whole.slices] = pixel_averages(lanes_of(colours), self._n)
        segmentation[whole.slices] = segmentation_of(ids, self._n)
        return View(rgb, segmentation, part_pixels)

    def marking_pixels(self, R_m2c: Rotations) -> npt.NDArray[np.float64]:
        """Count the lattice points on the marking, under each rotation in the window that its vertices span."""
        if not len(self._mesh.marking_vertices):
            return np.zeros(len(R_m2c))
        counts = [np.count_nonzero(np.isin(labels.ids, self._mesh.breaking)) for labels in self.label_windows(R_m2c)]
        return np.array(counts, dtype=np.float64) / self._points_per_pixel

    def label_windows(self, R_m2c: Rotations) -> list[LabelWindow]:
        """Return what lies around the marking under each rotation."""
        if not len(self._mesh.marking_vertices):
            raise RenderError("an object without a marking has nothing to compare")
        self._paint(self._greys, (0.0, 0.0, 0.0))
        found = []
        for R in R_m2c:
            self._object.rotation_quaternion = rotation_to_quat_wxyz(R)
            _, counted = self._windows(R)
            ids = self._draw(counted)[..., 0]
            refuse_strays(int(ids.max()), self._mesh.parts)
            found.append(LabelWindow(counted.lattice(self._n), ids))
        return found

    def lit_windows(self, R_m2c: Rotations) -> list[LitWindow]:
        """Return what lies around the marking under each rotation, and its colours."""
        found = []
        for R, labels in zip(R_m2c, self.label_windows(R_m2c), strict=True):
            self._object.rotation_quaternion = rotation_to_quat_wxyz(R)
            self._paint(self._light.colours(R), self._background_colour)
            found.append(LitWindow(labels.window, labels.ids, self._draw(self._windows(R)[1])))
        return found

    def close(self) -> None:
        """Let go of the frame's file."""
        self._frame.close()

    def _windows(self, R_m2c: Rotations) -> tuple[Window, Window]:
        """Return the window of the whole object, and that of its marking, seen or not, unless it is hardly smaller."""
        whole = self._window_of(self._mesh.vertices @ R_m2c.T)
        if not len(self._mesh.marking_vertices):
            return whole, whole
        marking = self._window_of(self._mesh.marking_vertices @ R_m2c.T)
        return whole, marking if 2 * marking.area <= whole.area else whole

    def _window_of(self, points: npt.NDArray[np.float64]) -> Window:
        """Return the window of pixels that holds world points (k, 3)."""
        camera = self._camera
        return Window.around(camera.project(points), camera.width, camera.height, step=_WINDOW_STEP)

    def _frame_of(
        self, windows: tuple[Window, Window], colours: npt.NDArray[np.float32], background: tuple[float, float, float]
    ) -> Bytes:
        """Return the first window in such colours (T, 3, 4) of corners, with the second drawn into it anew."""
        self._paint(colours, background)
        frame = np.zeros((self._lattice.height, self._lattice.width, 3), np.uint8)
        for window in dict.fromkeys(windows):  # once, where they are one
            frame[window.lattice(self._n).slices] = self._draw(window)
        return frame[windows[0].lattice(self._n).slices]

    def _paint(self, colours: npt.NDArray[np.float32], background: tuple[float, float, float]) -> None:
        """Give the mesh's corners linear colours (T, 3, 4), and the world its own."""
        self._object.data.color_attributes[_COLOURS].data.foreach_set("color", colours.reshape(-1))
        self._object.data.update_tag()
        world = self._blender_scene.world
        world.color = background
        if world.use_nodes:
            world.node_tree.nodes["Background"].inputs["Color"].default_value = (*background, 1.0)

    def _draw(self, window: Window) -> Bytes:
        """Return the colours of a window's lattice points: (n height + 1, n width + 1, 3) u8 in sRGB.

        Blender's own border rendering draws the whole frame first; a shifted lens draws the window alone.
        """
        points = window.lattice(self._n)
        longest = max(points.width, points.height)
        self._blender_camera.lens = self._lattice.focal_px * _SENSOR_WIDTH / longest
        self._blender_camera.shift_x = (points.left + points.width / 2 - self._lattice.width / 2) / longest
        self._blender_camera.shift_y = -(points.top + points.height / 2 - self._lattice.height / 2) / longest
        render = self._blender_scene.render
        render.resolution_x, render.resolution_y = points.width, points.height
        bpy.ops.render.render(write_still=True)
        return self._frame.read(points.width, points.height)


class _FrameFile:
    """Where Blender writes a frame: memory with a path, so that nothing is left behind whatever happens."""

    def __init__(self) -> None:
        if hasattr(os, "memfd_create"):
            self._descriptor = os.memfd_create("symsol-annot-frame")
            self.path = f"/proc/self/fd/{self._descriptor}"
        else:  # macOS, Windows
            import tempfile

            self._descriptor, self.path = tempfile.mkstemp(prefix="symsol-annot-", suffix=".sgi")

    def read(self, width: int, height: int) -> npt.NDArray[np.uint8]:
        """Return the frame just written as (height, width, 3) u8."""
        try:
            with Path(self.path).open("rb") as file, SgiImageFile(file) as image:
                frame = np.array(image)
        except (OSError, SyntaxError) as error:  # Pillow's word for another format
            raise RenderError(f"Blender wrote no frame that can be read: {error}") from None
        if frame.shape != (height, width, 3):
            raise RenderError(f"Blender wrote a frame of shape {frame.shape}, expected {(height, width, 3)}")
        return frame

    def close(self) -> None:
        os.close(self._descriptor)
        if not self.path.startswith("/proc/"):
            Path(self.path).unlink()


def _add_object(scene: Any, mesh: Mesh) -> Any:
    data = bpy.data.meshes.new("object")
    data.from_pydata(mesh.vertices.tolist(), [], mesh.triangles.tolist())
    data.color_attributes.active_color = data.color_attributes.new(_COLOURS, "FLOAT_COLOR", "CORNER")
    data.update()
    made = bpy.data.objects.new("object", data)
    made.rotation_mode = "QUATERNION"
    scene.collection.objects.link(made)
    return made


def _add_camera(scene: Any, camera: Camera) -> Any:
    """Stand the camera on the negative z axis. Blender's looks along its own -z, y up: hence a half turn about x."""
    data = bpy.data.cameras.new("camera")
    data.sensor_fit, data.sensor_width = "AUTO", _SENSOR_WIDTH
    data.clip_start, data.clip_end = camera.distance - _CLIP_MARGIN, camera.distance + _CLIP_MARGIN
    stand = bpy.data.objects.new("camera", data)
    stand.location = (0.0, 0.0, -camera.distance)
    stand.rotation_mode = "QUATERNION"
    stand.rotation_quaternion = (0.0, 1.0, 0.0, 0.0)
    scene.collection.objects.link(stand)
    scene.camera = stand
    return data


def _set_up_output(scene: Any, path: str) -> None:
    scene.render.filepath = path
    scene.render.use_file_extension = False
    scene.render.image_settings.file_format = "IRIS"  # written faster than any other that loses nothing
    scene.render.image_settings.color_mode = "RGB"
    scene.render.resolution_percentage = 100
    scene.render.dither_intensity = 0.0
    scene.view_settings.view_transform = "Standard"
    scene.render.use_compositing = scene.render.use_sequencer = False
    scene.render.use_persistent_data = True
    scene.world = bpy.data.worlds.new("world")


def _set_up_engine(scene: Any, data: Any, engine: Engine) -> None:
    """Choose the engine, and let it show the corners' colours: back faces culled, one colour for each lattice point."""
    scene.render.engine = engine.blender_name
    for path, value in engine.scene_settings.items():
        owner, _, attribute = path.rpartition(".")
        setattr(attrgetter(owner)(scene), attribute, value)
    if engine.drawing is Drawing.EMISSION:
        scene.world.use_nodes = True
        data.materials.append(_emitter())


def _greys(mesh: Mesh) -> npt.NDArray[np.float32]:
    """Return the colours (T, 3, 4) of corners in which each part's grey, in sRGB, is its id of 255."""
    greys = np.ones((len(mesh.triangles), 3, 4), np.float32)
    greys[..., :3] = linear(mesh.part_ids / 255.0)[:, None, None]
    return greys


def _emitter() -> Any:
    """Return a material that emits the corners' colours and lets back faces through."""
    material = bpy.data.materials.new("emitter")
    material.use_nodes = True
    material.use_backface_culling = True
    if hasattr(material, "cycles"):
        material.cycles.emission_sampling = "NONE"
    tree = material.node_tree
    tree.nodes.clear()
    kinds = ("VertexColor", "Emission", "BsdfTransparent", "NewGeometry", "MixShader", "OutputMaterial")
    colours, emission, transparent, geometry, mix, output = (tree.nodes.new(f"ShaderNode{kind}") for kind in kinds)
    colours.layer_name = _COLOURS
    tree.links.new(colours.outputs["Color"], emission.inputs["Color"])
    tree.links.new(geometry.outputs["Backfacing"], mix.inputs[0])
    tree.links.new(emission.outputs[0], mix.inputs[1])
    tree.links.new(transparent.outputs[0], mix.inputs[2])
    tree.links.new(mix.outputs[0], output.inputs["Surface"])
    return material
