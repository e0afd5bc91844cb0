"""The engine `opengl`: a shader of our own, drawn by Blender's module `gpu` into a buffer that numpy reads.

Each point of the lattice gets one 32-bit number: the part that is seen there in the high 16 bits, and how much of its
light it gets, max(0, -n_z) of the normal's z, in the low ones. Colours are looked up in a table, so no id is told from
a colour. Vertices are projected and rounded in float64 (`projection`); their coordinates in OpenGL's clip space, over a
viewport whose side is a power of two, are exact in float32, and so is all that decides which points a triangle holds.
Float32 are the depth test, 2 fn / z being linear in the picture, and the light: normals are divided by their corners'
depths, so that interpolating in the picture is interpolating on the surface.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from itertools import product
from typing import Any

import bpy  # noqa: F401 - the module gpu is a part of it, and can be imported after it alone
import gpu
import numpy as np
import numpy.typing as npt

from symsol_annot.errors import RenderError
from symsol_annot.rendering.blender import device
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.engines import engine_named
from symsol_annot.rendering.frames.balls import BallPicture
from symsol_annot.rendering.frames.flat_faces import with_few_slivers
from symsol_annot.rendering.frames.projection import doubled_areas, projected
from symsol_annot.rendering.frames.shading import srgb_bytes
from symsol_annot.rendering.frames.supersampling import (
    lanes_of,
    part_pixels_of,
    pixel_averages,
    refuse_strays,
    segmentation_of,
)
from symsol_annot.rendering.renderer import LabelWindow, LitWindow, Scene, View
from symsol_annot.rendering.windows import Window
from symsol_annot.rotations.so3 import Rotations
from symsol_annot.system.closing import Closing

Floats = npt.NDArray[np.float64]
Words = npt.NDArray[np.uint32]

_SHADES = 1 << 16
_TILE = 2048  # lattice points; wider lattices are drawn in tiles
_MAX_VIEWPORT = 1 << 14  # what every device can; a picture may reach beyond it by as much again
_CLIP_MARGIN = 1.5  # bounding-sphere radii in front of and behind the object's centre
_AT_ONCE = 32  # rotations that are projected together

_VERTEX = "void main() { gl_Position = vec4(corner.xyz, 1.0); turned = normal * corner.w; id = part; }"
_FRAGMENT = """
void main() {
  float light = clamp(dot(toward, turned) * inversesqrt(dot(turned, turned)), 0.0, 1.0);
  word = (uint(id) << 16) | uint(light * 65535.0 + 0.5);
}
"""
_ID_VERTEX = "void main() { gl_Position = vec4(corner.xyz, 1.0); id = part; }"
_ID_FRAGMENT = "void main() { word = uint(id) << 16; }"


class OpenGLRenderer(Closing):
    """Draws one scene in this process, which it takes over."""

    def __init__(self, scene: Scene) -> None:
        device.open_device()
        scene = replace(scene, mesh=with_few_slivers(scene.mesh))
        mesh, settings, self._camera = scene.mesh, scene.settings, scene.camera
        self._mesh, self._parts, self._n = mesh, mesh.parts, settings.samples_per_axis
        self._per_pixel, self._has_depth = settings.points_per_pixel, settings.depth
        self._engine = engine_named(settings.engine)
        self._lattice = self._camera.lattice(self._n)
        self._marking_triangles = mesh.triangles[mesh.is_marking]
        self._marking_vertices = np.unique(self._marking_triangles)
        self._is_breaking = np.isin(np.arange(mesh.parts + 1), mesh.breaking)
        first = min(mesh.breaking, default=mesh.parts + 1)
        self._first_breaking = first if self._is_breaking[first:].all() else None  # None: others have higher ids
        size = (self._camera.height, self._camera.width, 3)
        self._blank = np.broadcast_to(srgb_bytes(np.array(settings.background_colour)), size).copy()
        self._table = _colour_table(scene)
        self._colours = lanes_of(self._table)
        self._canvas = _Canvas(self._lattice)
        self._ball = BallPicture.seen_by(self._lattice) if scene.is_ball else None
        self._lit, self._labelled = _LitShape(scene), _LabelledShape(scene)
        self.render(np.eye(3))  # compiles the shaders: it fails here or not at all

    @property
    def versions(self) -> dict[str, str]:
        """Blender, and the OpenGL it draws with."""
        return device.versions(self._engine)

    def render(self, R_m2c: Rotations) -> View:
        """Draw the window that the object spans, and make a view of it."""
        points, z = projected(self._mesh.vertices, R_m2c, self._lattice)
        corners = points if self._ball is None else self._ball.window.corners
        window = Window.around(corners / self._n, self._camera.width, self._camera.height)
        batch = self._lit.batch(self._canvas.clip_space(points, z), R_m2c)
        with self._canvas.bound():
            words, depths = self._canvas.draw(batch, window.lattice(self._n), with_depth=self._has_depth)
        words = self._with_ball(words, window.lattice(self._n))
        ids = _ids_in(words)
        part_pixels = part_pixels_of(ids, self._n, self._parts)
        rgb = self._blank.copy()
        rgb[window.slices] = pixel_averages(self._colours.take(words), self._n)
        segmentation = np.zeros(rgb.shape[:2], np.uint8)
        segmentation[window.slices] = segmentation_of(ids, self._n)
        if depths is None:
            return View(rgb, segmentation, part_pixels)
        depth = np.zeros(segmentation.shape, np.float32)
        at_centres = (slice(self._n // 2, None, self._n),) * 2
        if self._ball is None:
            depth[window.slices] = self._canvas.z_of(depths[at_centres])
        else:
            depth[window.slices] = self._ball.cut(window.lattice(self._n)).z[at_centres]
        depth[segmentation == 0] = 0.0
        return View(rgb, segmentation, part_pixels, depth)

    def marking_pixels(self, R_m2c: Rotations) -> Floats:
        """Count the lattice points on the marking under each rotation; nothing is drawn where it faces away."""
        counts = np.zeros(len(R_m2c))
        if self._marking_triangles.size:
            for i, words, _ in self._around_the_marking(R_m2c, only_drawn=True):
                if self._first_breaking is None:
                    counts[i] = np.count_nonzero(self._is_breaking.take(words >> np.uint32(16)))
                else:
                    counts[i] = np.count_nonzero(words >= np.uint32(self._first_breaking << 16))
        return counts / self._per_pixel

    def label_windows(self, R_m2c: Rotations) -> list[LabelWindow]:
        """Return what lies around the marking under each rotation."""
        if not self._marking_triangles.size:
            raise RenderError("an object without a marking has nothing to compare")
        return [LabelWindow(window, _ids_in(words)) for _, words, window in self._around_the_marking(R_m2c)]

    def lit_windows(self, R_m2c: Rotations) -> list[LitWindow]:
        """Return what lies around the marking under each rotation, and its colours."""
        if not self._marking_triangles.size:
            raise RenderError("an object without a marking has nothing to compare")
        drawn = self._around_the_marking(R_m2c, lit=True)
        return [LitWindow(window, _ids_in(words), self._table.take(words, axis=0)) for _, words, window in drawn]

    def close(self) -> None:
        """Nothing is held that does not end with the process."""

    def _with_ball(self, words: Words, window: Window) -> Words:
        """Return the words of a window of the lattice, of a ball with the sphere's outline and light."""
        return words if self._ball is None else self._ball.cut(window).drawn_over(words)

    def _around_the_marking(
        self, R_m2c: Rotations, *, only_drawn: bool = False, lit: bool = False
    ) -> Iterator[tuple[int, Words, Window]]:
        """Yield the number of each rotation, and the words of the window around the marking's vertices, shown or not.

        Args:
            R_m2c: (n, 3, 3).
            only_drawn: whether rotations are left out under which no triangle of the marking faces the camera.
            lit: whether the words tell the light as well; else it is 0.
        """
        for start in range(0, len(R_m2c), _AT_ONCE):
            points, z = projected(self._mesh.vertices, R_m2c[start : start + _AT_ONCE], self._lattice)
            places = self._canvas.clip_space(points, z)
            windows = Window.around_each(points[:, self._marking_vertices], self._lattice.width, self._lattice.height)
            is_drawn = (doubled_areas(points, self._marking_triangles) < 0).any(axis=1) | (not only_drawn)
            with self._canvas.bound():
                for i in np.flatnonzero(is_drawn).tolist():
                    R = R_m2c[start + i]
                    batch = self._lit.batch(places[i], R) if lit else self._labelled.batch(places[i])
                    words, _ = self._canvas.draw(batch, windows[i])
                    words = self._with_ball(words, windows[i])
                    refuse_strays(int(words.max()) >> 16, self._parts)
                    yield start + i, words, windows[i]


class _Shape:
    """A mesh in the device's terms: its corners, each about once, with what a shader is told of them.

    Args:
        scene: whose mesh it is.
        shader: draws it.
        attributes: of the corners of triangles (3 T, k) f4, beside their places, by name.
    """

    def __init__(self, scene: Scene, shader: Any, attributes: dict[str, npt.NDArray[np.float32]]) -> None:
        corners = scene.mesh.triangles.reshape(-1)
        _, first, numbers = np.unique(
            np.column_stack([corners, *attributes.values()]), axis=0, return_index=True, return_inverse=True
        )
        self.shader, self._vertices = shader, corners[first]
        self._attributes = {name: np.ascontiguousarray(values[first]) for name, values in attributes.items()}
        self._order = gpu.types.GPUIndexBuf(type="TRIS", seq=numbers.reshape(-1, 3).astype(np.int32))
        self._format = gpu.types.GPUVertFormat()
        self._format.attr_add(id="corner", comp_type="F32", len=4, fetch_mode="FLOAT")
        for name, values in self._attributes.items():
            self._format.attr_add(id=name, comp_type="F32", len=values.shape[1], fetch_mode="FLOAT")

    def batch_of(self, places: npt.NDArray[np.float32]) -> Any:
        """Return what is to be drawn for vertices at places (V, 4)."""
        buffer = gpu.types.GPUVertBuf(format=self._format, len=len(self._vertices))
        buffer.attr_fill("corner", places[self._vertices])
        for name, values in self._attributes.items():
            buffer.attr_fill(name, values)
        batch = gpu.types.GPUBatch(type="TRIS", buf=buffer, elem=self._order)
        batch.program_set(self.shader)
        return batch


class _LitShape(_Shape):
    """Tells part and light."""

    def __init__(self, scene: Scene) -> None:
        interface = gpu.types.GPUStageInterfaceInfo("lit")
        interface.smooth("VEC3", "turned")
        interface.flat("FLOAT", "id")
        info = gpu.types.GPUShaderCreateInfo()
        info.push_constant("VEC3", "toward")
        info.vertex_in(1, "VEC3", "normal")
        normals = scene.mesh.corner_normals.reshape(-1, 3).astype(np.float32)
        shader = _shader(info, interface, _VERTEX, _FRAGMENT)
        super().__init__(scene, shader, {"normal": normals, "part": _parts_of_corners(scene)})

    def batch(self, places: npt.NDArray[np.float32], R_m2c: Rotations) -> Any:
        """Return what is to be drawn for vertices at places (V, 4), lit along the camera's axis."""
        batch = self.batch_of(places)
        self.shader.bind()
        self.shader.uniform_float("toward", tuple((-R_m2c[2]).tolist()))
        return batch


class _LabelledShape(_Shape):
    """Tells the part alone."""

    def __init__(self, scene: Scene) -> None:
        interface = gpu.types.GPUStageInterfaceInfo("labelled")
        interface.flat("FLOAT", "id")
        shader = _shader(gpu.types.GPUShaderCreateInfo(), interface, _ID_VERTEX, _ID_FRAGMENT)
        super().__init__(scene, shader, {"part": _parts_of_corners(scene)})

    def batch(self, places: npt.NDArray[np.float32]) -> Any:
        """Return what is to be drawn for vertices at places (V, 4)."""
        return self.batch_of(places)


def _parts_of_corners(scene: Scene) -> npt.NDArray[np.float32]:
    return np.repeat(scene.mesh.part_ids, 3).astype(np.float32)[:, None]


def _shader(info: Any, interface: Any, vertex: str, fragment: str) -> Any:
    info.vertex_in(0, "VEC4", "corner")
    info.vertex_in(2, "FLOAT", "part")
    info.vertex_out(interface)
    info.fragment_out(0, "UINT", "word")
    info.vertex_source(vertex)
    info.fragment_source(fragment)
    return gpu.shader.create_from_info(info)


class _Canvas:
    """The buffers that are drawn into: one tile of the lattice, of which each window is drawn at its own place.

    So a point's number does not hang on the window that it is drawn in, not by a bit.
    """

    def __init__(self, lattice: Camera) -> None:
        width, height = lattice.width, lattice.height
        self._near, self._far = lattice.distance - _CLIP_MARGIN, lattice.distance + _CLIP_MARGIN
        size = (min(width, _TILE), min(height, _TILE))
        starts = product(range(0, height, size[1]), range(0, width, size[0]))
        self._tiles = [Window(left, top, *size) for top, left in starts]
        self._side = min(1 << (max(width, height) - 1).bit_length(), _MAX_VIEWPORT)
        self._words = gpu.types.GPUTexture(size, format="R32UI")
        self._depths = gpu.types.GPUTexture(size, format="DEPTH_COMPONENT32F")
        self._buffer = gpu.types.GPUFrameBuffer(depth_slot=self._depths, color_slots=[self._words])

    def clip_space(self, points: Floats, z: Floats) -> npt.NDArray[np.float32]:
        """Return OpenGL's x, y and z of projected vertices (..., V, 2), with 1 / z last: (..., V, 4); x, y exact."""
        near, far = self._near, self._far
        places = np.empty((*z.shape, 4), np.float32)
        places[..., :2] = points * (2.0 / self._side) - 1.0
        places[..., 2] = (far + near - 2.0 * far * near / z) / (far - near)
        places[..., 3] = 1.0 / z
        return places

    def z_of(self, depths: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        """Return the z along the camera's axis of depths in [0, 1] as the device has them."""
        near, far = self._near, self._far
        in_clip_space = 2.0 * depths.astype(np.float64) - 1.0
        return (2.0 * far * near / (far + near - (far - near) * in_clip_space)).astype(np.float32)

    @contextmanager
    def bound(self) -> Iterator[None]:
        """Make the device draw into the buffers, as `draw` wants it."""
        with self._buffer.bind():
            gpu.state.color_mask_set(True, True, True, True)  # a render leaves it shut
            gpu.state.depth_mask_set(True)
            gpu.state.blend_set("NONE")
            gpu.state.depth_test_set("LESS_EQUAL")
            gpu.state.face_culling_set("FRONT")  # with v downwards, what faces the camera runs clockwise
            gpu.state.scissor_test_set(True)
            yield

    def draw(
        self, batch: Any, window: Window, *, with_depth: bool = False
    ) -> tuple[Words, npt.NDArray[np.float32] | None]:
        """Draw a batch, and return the words and the device's depths (height, width) of a window."""
        if len(self._tiles) == 1:
            return self._draw_in(self._tiles[0], batch, window, with_depth=with_depth)
        words = np.zeros((window.height, window.width), np.uint32)
        depths = np.ones(words.shape, np.float32) if with_depth else None
        for tile in self._tiles:
            part = window.within(tile)
            if part:
                place = part.seen_from(window).slices
                words[place], of_part = self._draw_in(tile, batch, part, with_depth=with_depth)
                if depths is not None:
                    depths[place] = of_part
        return words, depths

    def _draw_in(
        self, tile: Window, batch: Any, window: Window, *, with_depth: bool
    ) -> tuple[Words, npt.NDArray[np.float32] | None]:
        """Draw a window that lies in one tile."""
        rectangle = (window.left - tile.left, window.top - tile.top, window.width, window.height)
        gpu.state.viewport_set(-tile.left, -tile.top, self._side, self._side)
        gpu.state.scissor_set(*rectangle)
        self._buffer.clear(color=(0.0, 0.0, 0.0, 0.0), depth=1.0)
        batch.draw()
        words = _array(self._buffer.read_color(*rectangle, 1, 0, "UINT"), window, np.uint32)
        return words, _array(self._buffer.read_depth(*rectangle), window, np.float32) if with_depth else None


def _ids_in(words: Words) -> npt.NDArray[np.uint8]:
    return (words >> np.uint32(16)).astype(np.uint8)


def _array(read: Any, window: Window, dtype: npt.DTypeLike) -> npt.NDArray[Any]:
    """Return what was read of a window as an array (height, width) over the same memory."""
    read.dimensions = window.area
    return np.frombuffer(memoryview(read), dtype).reshape(window.height, window.width)


def _colour_table(scene: Scene) -> npt.NDArray[np.uint8]:
    """Return the sRGB ((P + 1) 65536, 3) of each word: the background's, and of each part the colour in each light."""
    settings = scene.settings
    light = settings.ambient + settings.diffuse * np.linspace(0.0, 1.0, _SHADES)
    lit = srgb_bytes(light[:, None] * scene.part_colours[:, None])
    background = np.broadcast_to(srgb_bytes(np.array(settings.background_colour)), lit.shape[1:])
    return np.concatenate([background[None], lit]).reshape(-1, 3)
