"""The renderer on Blender's Python module: the only file that imports bpy.

Use it through `render_process.RenderProcess`: Blender writes to the terminal past Python, can take the
whole process down, and is not thread-safe, so it lives in a process of its own.
"""

import os
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import bpy
import numpy as np
import numpy.typing as npt

from symsol_annot.errors import RenderError
from symsol_annot.mesh import MATERIALS, Mesh
from symsol_annot.scene import BODY, MARKING, Camera, RenderSettings, View, box_filter
from symsol_annot.so3 import Rotations, rotation_to_quat_wxyz

_ENGINE_IDS = {"workbench": "BLENDER_WORKBENCH", "cycles": "CYCLES", "eevee": "BLENDER_EEVEE_NEXT"}
_SENSOR_WIDTH = 36.0
_CLIP_MARGIN = 1.5  # bounding-sphere radii in front of and behind the object's centre
_ID_COLOURS = {BODY: (0.0, 1.0, 0.0), MARKING: (1.0, 0.0, 0.0)}
_WINDOW_STEP = 16  # sides of windows are multiples of this: few sizes, few reallocations
_WINDOW_MARGIN = 2  # pixels around what a window holds, so that its corner shows the background


class BlenderRenderer:
    """Draws one mesh through one camera in this process, which it takes over: one at a time."""

    def __init__(self, mesh: Mesh, camera: Camera, settings: RenderSettings) -> None:
        self._camera = camera
        self._settings = settings
        self._vertices, self._marking_vertices = mesh.vertices, mesh.marking_vertices
        n = settings.samples_per_axis
        self._lattice = _Window(0, 0, camera.width * n, camera.height * n)
        self._frame = _FrameFile()
        bpy.ops.wm.read_factory_settings(use_empty=True)
        self._scene = bpy.context.scene
        self._materials = [bpy.data.materials.new(name) for name in MATERIALS]
        self._object = _add_object(self._scene, mesh, self._materials)
        self._camera_data = _add_camera(self._scene, camera)
        _set_up_output(self._scene, self._frame.path)
        self._shading: _Shading = (_WorkbenchShading if settings.engine == "workbench" else _NodeShading)(
            self._scene, self._materials, settings
        )
        self.render(np.eye(3))  # opens the graphics device: it fails here or not at all

    @property
    def versions(self) -> dict[str, str]:
        """Blender, and the OpenGL it draws with."""
        found = {"bpy": bpy.app.version_string}
        if self._settings.engine != "cycles":
            import gpu  # knows the device once something was drawn

            found["opengl"] = f"{gpu.platform.renderer_get()}; {gpu.platform.version_get()}"
        return found

    def render(self, R_m2c: Rotations) -> View:
        """Draw the RGB on the anti-aliasing lattice and average it; take the segmentation at pixel centres.

        Where the marking is counted in a window of its own, that window is drawn into the RGB: a vertex can
        round to another sub-pixel there, and then a sample would differ between the two.
        """
        n = self._settings.samples_per_axis
        self._turn(R_m2c)
        self._shading.show_looks()
        samples = self._draw_object(R_m2c, scale=n)
        window = self._marking_window(R_m2c)
        if window is not None and window != self._lattice:
            samples[window.rows, window.columns] = self._draw(window, scale=n)
        self._shading.show_ids()
        segmentation = _decode_ids(self._draw_object(R_m2c, scale=1))
        if not np.any(segmentation):
            raise RenderError("a frame came back empty: the object is not in it")
        return View(box_filter(samples, n), segmentation)

    def marking_pixels(self, R_m2c: Rotations) -> npt.NDArray[np.float64]:
        """Count the marking's samples, each rotation in the window of the lattice that its vertices span."""
        self._shading.show_ids()
        counts = [self._marking_samples(R) for R in R_m2c]
        return np.array(counts, dtype=np.float64) / self._settings.samples_per_pixel

    def _marking_samples(self, R_m2c: Rotations) -> int:
        window = self._marking_window(R_m2c)
        if window is None:
            return 0
        self._turn(R_m2c)
        ids = _decode_ids(self._draw(window, scale=self._settings.samples_per_axis))
        return int(np.count_nonzero(ids == MARKING))

    def _marking_window(self, R_m2c: Rotations) -> "_Window | None":
        """Return the square of the lattice that holds the marking, seen or not; the whole lattice if it is large."""
        if not len(self._marking_vertices):
            return None
        corners = self._settings.samples_per_axis * self._camera.project(self._marking_vertices @ R_m2c.T)
        low = np.floor(corners.min(axis=0)).astype(int) - _WINDOW_MARGIN
        high = np.ceil(corners.max(axis=0)).astype(int) + _WINDOW_MARGIN
        side = int(-(-(high - low).max() // _WINDOW_STEP)) * _WINDOW_STEP
        if 2 * side > min(self._lattice.width, self._lattice.height):
            return self._lattice
        left, top = np.clip(low, 0, [self._lattice.width - side, self._lattice.height - side]).tolist()
        return _Window(left, top, side, side)

    def _draw_object(self, R_m2c: Rotations, scale: int) -> npt.NDArray[np.uint8]:
        """Draw the window that the object spans, and fill the rest of the enlarged image with its corner's colour."""
        shape = (self._camera.height * scale, self._camera.width * scale)
        corners = scale * self._camera.project(self._vertices @ R_m2c.T)
        low = np.maximum(np.floor(corners.min(axis=0)).astype(int) - _WINDOW_MARGIN, 0)
        high = np.ceil(corners.max(axis=0)).astype(int) + _WINDOW_MARGIN
        sides = np.minimum(-(-(high - low) // _WINDOW_STEP) * _WINDOW_STEP, shape[::-1])
        left, top = np.minimum(low, shape[::-1] - sides).tolist()
        window = _Window(left, top, *sides.tolist())
        drawn = self._draw(window, scale)
        frame = np.empty((*shape, 3), np.uint8)
        frame[...] = drawn[0, 0]
        frame[window.rows, window.columns] = drawn
        return frame

    def close(self) -> None:
        """Let go of the frame's file."""
        self._frame.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _turn(self, R_m2c: Rotations) -> None:
        self._object.rotation_quaternion = rotation_to_quat_wxyz(R_m2c)

    def _draw(self, window: "_Window", scale: int) -> npt.NDArray[np.uint8]:
        """Draw a window of the image enlarged `scale` times: (height, width, 3) u8, a sample at each centre.

        Blender's own border rendering draws the whole frame first; a shifted lens draws the window alone.
        """
        longest = max(window.width, window.height)
        full_width, full_height = self._camera.width * scale, self._camera.height * scale
        self._camera_data.lens = self._camera.focal_px * scale * _SENSOR_WIDTH / longest
        self._camera_data.shift_x = (window.left + window.width / 2 - full_width / 2) / longest
        self._camera_data.shift_y = -(window.top + window.height / 2 - full_height / 2) / longest
        self._scene.render.resolution_x, self._scene.render.resolution_y = window.width, window.height
        bpy.ops.render.render(write_still=True)
        return self._frame.read(window.width, window.height)


@dataclass(frozen=True)
class _Window:
    """A rectangle of pixels; top and left counted from the image's upper left corner."""

    left: int
    top: int
    width: int
    height: int

    @property
    def rows(self) -> slice:
        return slice(self.top, self.top + self.height)

    @property
    def columns(self) -> slice:
        return slice(self.left, self.left + self.width)


class _FrameFile:
    """Where Blender writes a frame: memory with a path, so that nothing is left behind whatever happens."""

    def __init__(self) -> None:
        if hasattr(os, "memfd_create"):
            self._descriptor = os.memfd_create("symsol-annot-frame")
            self.path = f"/proc/self/fd/{self._descriptor}"
        else:  # macOS, Windows
            import tempfile

            self._descriptor, self.path = tempfile.mkstemp(prefix="symsol-annot-", suffix=".bmp")

    def read(self, width: int, height: int) -> npt.NDArray[np.uint8]:
        """Return the frame just written as (height, width, 3) u8: a BMP's rows run upwards, in BGR, padded to 4."""
        data = Path(self.path).read_bytes()
        offset = int.from_bytes(data[10:14], "little")
        found = tuple(int.from_bytes(data[start : start + 4], "little") for start in (18, 22))
        stride = (3 * width + 3) // 4 * 4
        if data[:2] != b"BM" or found != (width, height) or len(data) < offset + stride * height:
            raise RenderError(f"Blender wrote no {width}x{height} frame, but {len(data)} bytes of {found}")
        rows = np.frombuffer(data, np.uint8, stride * height, offset).reshape(height, stride)[::-1]
        frame = np.empty((height, width, 3), np.uint8)
        for channel in range(3):  # one by one: numpy copies long strides fast and short ones slowly
            frame[..., channel] = rows[:, 2 - channel : 3 * width : 3]
        return frame

    def close(self) -> None:
        os.close(self._descriptor)
        if not self.path.startswith("/proc/"):
            Path(self.path).unlink()


def _decode_ids(frame: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    """Return the ids of a frame drawn in _ID_COLOURS on black; any other colour is an error."""
    ids = BODY * (frame[..., 1] == 255).astype(np.uint8) + MARKING * (frame[..., 0] == 255).astype(np.uint8)
    if np.any((frame != 0) & (frame != 255)) or np.any(frame[..., 2]) or ids.max() > MARKING:
        stray = np.unique(frame.reshape(-1, 3), axis=0)
        raise RenderError(f"a segmentation holds colours that are no ids: {stray[:8].tolist()}")
    return ids


def _add_object(scene: Any, mesh: Mesh, materials: list[Any]) -> Any:
    data = bpy.data.meshes.new("object")
    data.from_pydata(mesh.vertices.tolist(), [], mesh.triangles.tolist())
    for material in materials:
        data.materials.append(material)
    data.polygons.foreach_set("material_index", mesh.is_marking.astype(np.int32))
    normals = data.attributes.new("custom_normal", "FLOAT_VECTOR", "CORNER")  # kept as they are, in float32
    normals.data.foreach_set("vector", mesh.corner_normals.astype(np.float32).reshape(-1))
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
    scene.render.image_settings.file_format = "BMP"
    scene.render.image_settings.color_mode = "RGB"
    scene.render.resolution_percentage = 100
    scene.render.dither_intensity = 0.0
    scene.render.use_compositing = scene.render.use_sequencer = False
    scene.render.use_high_quality_normals = True
    scene.render.use_persistent_data = True
    scene.world = bpy.data.worlds.new("world")


class _Shading:
    """Switches a scene between its looks and flat id colours; switching to what is on costs nothing."""

    def __init__(self, scene: Any, materials: list[Any], settings: RenderSettings) -> None:
        self._scene, self._materials, self._settings = scene, materials, settings
        self._shown = ""

    def show_looks(self) -> None:
        """Draw what the RGB shows."""
        if self._shown != "looks":
            self._shown = "looks"
            self._scene.view_settings.view_transform = "Standard"
            self._apply(
                [self._settings.body_colour, self._settings.marking_colour], self._settings.background_colour, lit=True
            )

    def show_ids(self) -> None:
        """Draw what the segmentation shows."""
        if self._shown != "ids":
            self._shown = "ids"
            self._scene.view_settings.view_transform = "Raw"
            self._apply([_ID_COLOURS[BODY], _ID_COLOURS[MARKING]], (0.0, 0.0, 0.0), lit=False)

    def _apply(
        self, colours: list[tuple[float, float, float]], background: tuple[float, float, float], *, lit: bool
    ) -> None:
        raise NotImplementedError


class _WorkbenchShading(_Shading):
    """Blender's OpenGL engine: one studio light along the camera's axis, back faces culled, no anti-aliasing."""

    def __init__(self, scene: Any, materials: list[Any], settings: RenderSettings) -> None:
        super().__init__(scene, materials, settings)
        scene.render.engine = _ENGINE_IDS["workbench"]
        scene.display.render_aa = "OFF"
        shading = scene.display.shading
        shading.color_type = "MATERIAL"
        shading.show_backface_culling = True
        shading.show_specular_highlight = False
        shading.show_cavity = shading.show_object_outline = shading.show_shadows = shading.show_xray = False
        system = bpy.context.preferences.system
        system.use_studio_light_edit = True
        system.light_ambient = (settings.ambient,) * 3
        for light in system.solid_lights:
            light.use = False
        head = system.solid_lights[0]
        head.use, head.smooth, head.direction = True, 0.0, (0.0, 0.0, 1.0)
        head.diffuse_color, head.specular_color = (settings.diffuse,) * 3, (0.0, 0.0, 0.0)

    def _apply(
        self, colours: list[tuple[float, float, float]], background: tuple[float, float, float], *, lit: bool
    ) -> None:
        self._scene.display.shading.light = "STUDIO" if lit else "FLAT"
        self._scene.world.color = background
        for material, colour in zip(self._materials, colours, strict=True):
            material.diffuse_color = (*colour, 1.0)


class _NodeShading(_Shading):
    """Cycles and EEVEE: surfaces that emit what Workbench's light would show, one sample at each centre.

    The object turns and the camera stays, so the cosine to the light is -z of the world normal.
    """

    def __init__(self, scene: Any, materials: list[Any], settings: RenderSettings) -> None:
        super().__init__(scene, materials, settings)
        scene.render.engine = _ENGINE_IDS[settings.engine]
        scene.render.filter_size = 0.0
        if settings.engine == "cycles":
            scene.cycles.device = "CPU"
            scene.cycles.samples, scene.cycles.use_adaptive_sampling = 1, False
            scene.cycles.use_denoising = False
            scene.cycles.max_bounces = scene.cycles.transparent_max_bounces = 8
            scene.cycles.pixel_filter_type, scene.cycles.filter_width = "BOX", 0.01
            scene.cycles.seed = 0
            scene.render.threads_mode, scene.render.threads = "FIXED", 1
        else:
            scene.eevee.taa_render_samples = 1
        scene.world.use_nodes = True
        self._background = scene.world.node_tree.nodes["Background"].inputs["Color"]
        self._surfaces = [_emitter(material) for material in materials]

    def _apply(
        self, colours: list[tuple[float, float, float]], background: tuple[float, float, float], *, lit: bool
    ) -> None:
        self._background.default_value = (*background, 1.0)
        ambient, diffuse = (self._settings.ambient, self._settings.diffuse) if lit else (1.0, 0.0)
        for surface, colour in zip(self._surfaces, colours, strict=True):
            surface["colour"].default_value = (*colour, 1.0)
            surface["ambient"].default_value, surface["diffuse"].default_value = ambient, diffuse


def _emitter(material: Any) -> dict[str, Any]:
    """Give a material nodes that emit colour x (ambient + diffuse x max(0, -n_z)), and let back faces through."""
    material.use_nodes = True
    material.use_backface_culling = True
    if hasattr(material, "cycles"):
        material.cycles.emission_sampling = "NONE"
    tree = material.node_tree
    tree.nodes.clear()

    def math(operation: str, *links: Any) -> Any:
        node = tree.nodes.new("ShaderNodeMath")
        node.operation = operation
        for socket, link in zip(node.inputs, links, strict=False):
            if link is not None:
                tree.links.new(link, socket)
        return node

    geometry = tree.nodes.new("ShaderNodeNewGeometry")
    split = tree.nodes.new("ShaderNodeSeparateXYZ")
    tree.links.new(geometry.outputs["Normal"], split.inputs[0])
    cosine = math("MULTIPLY", split.outputs["Z"])
    cosine.inputs[1].default_value = -1.0
    lit = math("MAXIMUM", cosine.outputs[0])
    lit.inputs[1].default_value = 0.0
    shade = math("MULTIPLY_ADD", lit.outputs[0])  # lit x diffuse + ambient
    emission = tree.nodes.new("ShaderNodeEmission")
    tree.links.new(shade.outputs[0], emission.inputs["Strength"])
    transparent = tree.nodes.new("ShaderNodeBsdfTransparent")
    mix = tree.nodes.new("ShaderNodeMixShader")
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(geometry.outputs["Backfacing"], mix.inputs[0])
    tree.links.new(emission.outputs[0], mix.inputs[1])
    tree.links.new(transparent.outputs[0], mix.inputs[2])
    tree.links.new(mix.outputs[0], output.inputs["Surface"])
    return {"colour": emission.inputs["Color"], "diffuse": shade.inputs[1], "ambient": shade.inputs[2]}
