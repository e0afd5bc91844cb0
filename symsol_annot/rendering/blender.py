"""The renderer on Blender's Python module: the only file that imports bpy.

Use it through `render_process.RenderProcess`: Blender writes to the terminal past Python, can take the
whole process down, and is not thread-safe, so it lives in a process of its own.
"""

import os
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from typing import Any, assert_never

import bpy
import numpy as np
import numpy.typing as npt
from PIL.SgiImagePlugin import SgiImageFile

from symsol_annot.errors import RenderError
from symsol_annot.objects.mesh import Mesh
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.engines import Drawing, Engine, engine_named
from symsol_annot.rendering.renderer import MARKING, Scene, View
from symsol_annot.rendering.shading import ColourIds, CornerLight
from symsol_annot.rendering.supersampling import view_of
from symsol_annot.rotations.so3 import Rotations, rotation_to_quat_wxyz
from symsol_annot.system.closing import Closing

_COLOURS = "colours"  # the mesh's attribute
_SENSOR_WIDTH = 36.0
_CLIP_MARGIN = 1.5  # bounding-sphere radii in front of and behind the object's centre
_WINDOW_STEP = 8  # sides of windows are multiples of this many pixels: few sizes, few reallocations


class BlenderRenderer(Closing):
    """Draws one scene in this process, which it takes over: one at a time."""

    def __init__(self, scene: Scene) -> None:
        mesh, settings, self._camera = scene.mesh, scene.settings, scene.camera
        self._engine = engine_named(settings.engine)
        self._vertices, self._marking_vertices = mesh.vertices, mesh.marking_vertices
        self._n, self._points_per_pixel = settings.samples_per_axis, settings.points_per_pixel
        self._lattice = self._camera.lattice(self._n)
        self._ids = ColourIds(settings)
        self._blank = np.full((self._lattice.height, self._lattice.width, 3), self._ids.background)
        self._frame = _FrameFile()
        bpy.ops.wm.read_factory_settings(use_empty=True)
        self._blender_scene = bpy.context.scene
        self._light = CornerLight(mesh, self._lattice, settings)
        self._object = _add_object(self._blender_scene, mesh)
        self._blender_camera = _add_camera(self._blender_scene, self._camera)
        _set_up_output(self._blender_scene, self._frame.path)
        _set_up_engine(self._blender_scene, self._object.data, self._engine, settings.background_colour)
        self.render(np.eye(3))  # opens the graphics device: it fails here or not at all

    @property
    def versions(self) -> dict[str, str]:
        """Blender, and the OpenGL it draws with."""
        found = {"bpy": bpy.app.version_string}
        if self._engine.needs_opengl:
            import gpu  # knows the device once something was drawn

            found["opengl"] = f"{gpu.platform.renderer_get()}; {gpu.platform.version_get()}"
        return found

    def render(self, R_m2c: Rotations) -> View:
        """Draw the window that the object spans, and make a view of it.

        Where the marking is counted in a window of its own, that window is drawn into it: a vertex can round to
        another sub-pixel there, and then a lattice point would differ between picture and count.
        """
        self._turn(R_m2c)
        whole, counted = self._windows(R_m2c)
        frame = self._blank.copy()
        for window in dict.fromkeys((whole, counted)):  # once, where they are one
            frame[window.lattice_points(self._n)] = self._draw(window)
        drawn = frame[whole.lattice_points(self._n)]
        ids = self._ids.of(drawn)
        if not ids.any():
            raise RenderError("a frame came back empty: the object is not in it")
        view = view_of(drawn, ids, self._n)
        rgb = self._blank[: self._camera.height, : self._camera.width].copy()
        segmentation = np.zeros(rgb.shape[:2], np.uint8)
        rgb[whole.pixels], segmentation[whole.pixels] = view.rgb, view.segmentation
        return View(rgb, segmentation, view.marking_pixels)

    def marking_pixels(self, R_m2c: Rotations) -> npt.NDArray[np.float64]:
        """Count the lattice points on the marking, under each rotation in the window that its vertices span."""
        counts = [self._points_on_marking(R) for R in R_m2c]
        return np.array(counts, dtype=np.float64) / self._points_per_pixel

    def _points_on_marking(self, R_m2c: Rotations) -> int:
        if not len(self._marking_vertices):
            return 0
        self._turn(R_m2c)
        _, counted = self._windows(R_m2c)
        return int(np.count_nonzero(self._ids.of(self._draw(counted)) == MARKING))

    def _windows(self, R_m2c: Rotations) -> tuple["_Window", "_Window"]:
        """Return the window of the whole object, and that of its marking, seen or not, unless it is hardly smaller."""
        whole = self._window_of(self._vertices @ R_m2c.T)
        if not len(self._marking_vertices):
            return whole, whole
        marking = self._window_of(self._marking_vertices @ R_m2c.T)
        return whole, marking if 2 * marking.area <= whole.area else whole

    def _window_of(self, points: npt.NDArray[np.float64]) -> "_Window":
        """Return the window (in steps of whole pixels) that holds world points (k, 3), with a pixel around them."""
        corners = self._camera.project(points)
        low, high = np.floor(corners.min(axis=0)) - 1, np.ceil(corners.max(axis=0)) + 1
        size = np.array([self._camera.width, self._camera.height])
        sides = np.minimum(np.ceil((high - low) / _WINDOW_STEP) * _WINDOW_STEP, size)
        left, top = np.clip(low, 0, size - sides).astype(int).tolist()
        return _Window(left, top, *sides.astype(int).tolist())

    def close(self) -> None:
        """Let go of the frame's file."""
        self._frame.close()

    def _turn(self, R_m2c: Rotations) -> None:
        """Turn the object, and give its corners the colours that they have in the camera's light."""
        self._object.rotation_quaternion = rotation_to_quat_wxyz(R_m2c)
        self._object.data.color_attributes[_COLOURS].data.foreach_set("color", self._light.colours(R_m2c).reshape(-1))
        self._object.data.update_tag()

    def _draw(self, window: "_Window") -> npt.NDArray[np.uint8]:
        """Return the colours of a window's lattice points: (n height + 1, n width + 1, 3) u8 in sRGB.

        Blender's own border rendering draws the whole frame first; a shifted lens draws the window alone.
        """
        rows, columns = window.lattice_points(self._n)
        width, height = columns.stop - columns.start, rows.stop - rows.start
        longest = max(width, height)
        self._blender_camera.lens = self._lattice.focal_px * _SENSOR_WIDTH / longest
        self._blender_camera.shift_x = (columns.start + width / 2 - self._lattice.width / 2) / longest
        self._blender_camera.shift_y = -(rows.start + height / 2 - self._lattice.height / 2) / longest
        self._blender_scene.render.resolution_x, self._blender_scene.render.resolution_y = width, height
        bpy.ops.render.render(write_still=True)
        return self._frame.read(width, height)


@dataclass(frozen=True)
class _Window:
    """A rectangle of pixels; top and left counted from the image's upper left corner."""

    left: int
    top: int
    width: int
    height: int

    @property
    def area(self) -> int:
        return self.width * self.height

    @property
    def pixels(self) -> tuple[slice, slice]:
        """Its rows and columns in the image."""
        return slice(self.top, self.top + self.height), slice(self.left, self.left + self.width)

    def lattice_points(self, n: int) -> tuple[slice, slice]:
        """Its rows and columns in the lattice of n points per axis of a pixel, edges included."""
        rows, columns = self.pixels
        return slice(n * rows.start, n * rows.stop + 1), slice(n * columns.start, n * columns.stop + 1)


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
                frame = np.asarray(image)
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


def _set_up_engine(scene: Any, data: Any, engine: Engine, background_colour: tuple[float, float, float]) -> None:
    """Choose the engine, and let it show the corners' colours: back faces culled, one colour for each lattice point."""
    scene.render.engine = engine.blender_name
    for path, value in engine.scene_settings.items():
        owner, _, attribute = path.rpartition(".")
        setattr(attrgetter(owner)(scene), attribute, value)
    match engine.drawing:
        case Drawing.VERTEX_COLOURS:
            scene.world.color = background_colour
        case Drawing.EMISSION:
            scene.world.use_nodes = True
            background = scene.world.node_tree.nodes["Background"].inputs["Color"]
            background.default_value = (*background_colour, 1.0)
            data.materials.append(_emitter())
        case _:
            assert_never(engine.drawing)


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
