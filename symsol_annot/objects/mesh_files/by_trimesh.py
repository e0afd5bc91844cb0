"""Mesh files that trimesh reads: STL, PLY, OFF, GLB and glTF, and DAE where pycollada is installed."""

import io
import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from symsol_annot.errors import MissingExtraError, ObjectError
from symsol_annot.objects.mesh_files.face_colours import (
    Bytes,
    Colours,
    colours_in_texture,
    colours_of_corners,
    no_colours,
    packed,
    to_picture,
)
from symsol_annot.objects.mesh_files.mesh_file import Indices, Material, MeshFile, Points
from symsol_annot.objects.mesh_files.neighbouring_files import NeighbouringFiles

_NO_MATERIAL = Material("")


@dataclass(frozen=True, eq=False)
class _Solid:
    """A node of a scene that has faces: where they stand, and what they are made of."""

    node: str
    vertices: Points
    triangles: Indices
    material: Material
    colour_of: Colours


def read_by_trimesh(path: Path, data: bytes, ending: str) -> MeshFile:
    """Return what the bytes of a file hold.

    Args:
        path: where they come from, for messages; textures and buffers are read beside it.
        data: its bytes.
        ending: of the file, in small letters.

    Raises:
        ObjectError: they are no such file, name a file that is not there, or hold no triangles.
        MissingExtraError: trimesh or, for DAE, pycollada is not installed.
    """
    try:
        import trimesh  # noqa: PLC0415 - an extra
    except ImportError:
        raise MissingExtraError(f"{path.name}: reading {ending.upper()}", "trimesh", "mesh") from None
    if ending not in trimesh.available_formats():  # DAE alone needs a package of its own
        raise ObjectError(
            f"{path}: reading {ending.upper()} needs pycollada, which is not installed: `pip install pycollada`; or "
            "export the mesh as GLB"
        )
    files: Any = NeighbouringFiles(path.parent)  # a resolver, though not by its class
    log = logging.getLogger("trimesh")
    was_disabled, log.disabled = log.disabled, True  # it prints tracebacks of textures that are not there
    try:
        scene = trimesh.load_scene(io.BytesIO(data), file_type=ending, process=False, resolver=files)
        solids = [_solid(scene, name, files) for name in sorted(scene.graph.nodes_geometry)]
    except Exception as error:  # noqa: BLE001 - trimesh raises what its readers meet
        what = f"the file {files.missing[0]!r}, which it names, is not beside it" if files.missing else _in_words(error)
        raise ObjectError(f"{path}: cannot be read as {ending.upper()}: {what}") from None
    finally:
        log.disabled = was_disabled
    solids = [solid for solid in solids if len(solid.triangles)]
    if not solids:
        raise ObjectError(f"{path}: has no triangles: a point cloud or a curve has no surface to compare")
    return _joined(solids)


def _in_words(error: Exception) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"


def _joined(solids: list[_Solid]) -> MeshFile:
    starts = np.cumsum([0, *(len(solid.vertices) for solid in solids)])
    counts = [len(solid.triangles) for solid in solids]
    materials = tuple(dict.fromkeys(solid.material for solid in solids))
    return MeshFile(
        np.concatenate([solid.vertices for solid in solids]),
        np.concatenate([solid.triangles + start for solid, start in zip(solids, starts[:-1], strict=True)]),
        np.repeat([materials.index(solid.material) for solid in solids], counts),
        materials,
        np.repeat(np.arange(len(solids)), counts),
        tuple(solid.node for solid in solids),
        np.concatenate([solid.colour_of for solid in solids]),
    )


def _solid(scene: Any, node: str, files: NeighbouringFiles) -> _Solid:
    """Return a node of a scene, where it stands; a mirrored one has its faces wound the other way round."""
    matrix, geometry = scene.graph[node]
    mesh = scene.geometry[geometry]
    triangles = np.asarray(getattr(mesh, "faces", np.zeros((0, 3))), dtype=np.intp).reshape(-1, 3)
    vertices = np.asarray(mesh.vertices, dtype=np.float64).reshape(-1, 3)
    vertices = vertices @ matrix[:3, :3].T + matrix[:3, 3]
    if len(triangles) and not (triangles.min() >= 0 and triangles.max() < len(vertices)):
        raise ValueError(f"a face has a corner that is none of the {len(vertices)} vertices")
    visual = getattr(mesh, "visual", None)
    material, colour_of = _look(visual, triangles, files) if len(triangles) else (_NO_MATERIAL, no_colours(0))
    wound = triangles[:, ::-1] if np.linalg.det(matrix[:3, :3]) < 0 else triangles
    return _Solid(node, vertices, wound, material, colour_of)


def _look(visual: Any, triangles: Indices, files: NeighbouringFiles) -> tuple[Material, Colours]:
    """Return the material of a mesh, and the colours of its faces."""
    kind = getattr(visual, "kind", None)
    none = no_colours(len(triangles))
    if kind == "face":
        return _NO_MATERIAL, packed(np.asarray(visual.face_colors)[:, :3])
    if kind == "vertex":
        return _NO_MATERIAL, colours_of_corners(np.asarray(visual.vertex_colors)[:, :3], triangles)
    if kind != "texture":
        return _NO_MATERIAL, none
    material = visual.material
    missing = files.missing[0] if files.missing else None
    found = Material(str(getattr(material, "name", None) or ""), _colour_of(material), missing)
    picture, uv = _picture_of(material), getattr(visual, "uv", None)
    if picture is None or uv is None:
        return found, none
    return found, colours_in_texture(picture, np.asarray(uv, dtype=np.float64)[triangles])


def _picture_of(material: Any) -> Bytes | None:
    image = getattr(material, "baseColorTexture", None)
    if image is None:
        image = getattr(material, "image", None)
    return None if image is None else to_picture(image)


def _colour_of(material: Any) -> tuple[float, float, float] | None:
    """Return the linear RGB of a material, which glTF's base colour is already and so, mostly, is an exporter's."""
    colour = getattr(material, "baseColorFactor", None)
    if colour is None:
        colour = getattr(material, "diffuse", None)
    if colour is None:
        return None
    red, green, blue = (round(float(value) / 255.0, 4) for value in np.asarray(colour)[:3])
    return red, green, blue
