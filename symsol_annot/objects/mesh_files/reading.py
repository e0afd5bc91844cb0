"""Mesh files of any program: OBJ is read here, others by trimesh."""

import re
import struct
from pathlib import Path

import numpy as np

from symsol_annot.errors import ObjectError
from symsol_annot.objects.finding.surface import Surface, make_surface
from symsol_annot.objects.mesh_files.by_trimesh import read_by_trimesh
from symsol_annot.objects.mesh_files.exported_obj import ExportedObj
from symsol_annot.objects.mesh_files.face_colours import (
    Bytes,
    Colours,
    colours_in_texture,
    colours_of_corners,
    no_colours,
    read_picture,
)
from symsol_annot.objects.mesh_files.mesh_file import Material, MeshFile
from symsol_annot.objects.mesh_files.neighbouring_files import NeighbouringFiles
from symsol_annot.objects.mesh_files.obj_materials import read_obj_materials
from symsol_annot.objects.obj_file import read_object_file

ENDINGS = ("obj", "stl", "ply", "off", "glb", "gltf", "dae")
MAX_FILE_BYTES = 2**28
MAX_SURFACE_TRIANGLES = 500_000
_STL_HEADER, _STL_TRIANGLE = 84, 50  # bytes
_COUNTS = {
    "ply": re.compile(rb"\Aply.{0,4000}?\nelement face (\d{1,18})\s", re.DOTALL),
    "off": re.compile(rb"\A\s*[A-Z]*OFF\s+\d{1,18}\s+(\d{1,18})\s"),
}


def read_mesh_file(path: Path, most_triangles: int = MAX_SURFACE_TRIANGLES) -> tuple[MeshFile, bytes]:
    """Return what a mesh file holds, and its bytes.

    Args:
        path: of the file; its format is that of its ending.
        most_triangles: how many it may have. A file that announces more is refused before it is read as a whole.

    Raises:
        ObjectError: it is missing, broken, too large, or no mesh; the message says what to do.
        MissingExtraError: trimesh is not installed, and the file is no OBJ.
    """
    ending = _ending_of(path)
    if ending not in ENDINGS:
        raise ObjectError(
            f"{path}: expected a mesh file that ends in {', '.join(ENDINGS)}; export it as one of these, "
            "CAD files (STEP, IGES) with a chordal tolerance of a thousandth of the part's size"
        )
    if not path.exists():
        raise ObjectError(f"{path}: no such file; expected a mesh ({', '.join(ENDINGS)})")
    data = read_object_file(path, MAX_FILE_BYTES)
    _refuse_too_many(path, _announced_triangles(data, ending), most_triangles)
    file = _read_obj(path, data) if ending == "obj" else read_by_trimesh(path, data, ending)
    _refuse_too_many(path, len(file.triangles), most_triangles)
    return file, data


def read_surface(path: Path) -> Surface:
    """Read a mesh file for its symmetries; what it names materials, else nodes, are its parts.

    Raises:
        ObjectError: as `read_mesh_file`.
        MissingExtraError: as `read_mesh_file`.
    """
    file, _ = read_mesh_file(path)
    part_of, names = file.material_of, tuple(material.name for material in file.materials)
    if len(names) == 1:
        part_of, names = file.node_of, file.nodes
    try:
        return make_surface(file.vertices, file.triangles, part_of, names if len(names) > 1 else ("body",))
    except ObjectError as error:
        raise ObjectError(f"{path}: {error}") from None


def _ending_of(path: Path) -> str:
    """Return the ending of a file's name in small letters, without the dot."""
    return path.suffix.lower().removeprefix(".")


def _refuse_too_many(path: Path, triangles: int, most: int) -> None:
    if triangles > most:
        raise ObjectError(
            f"{path}: {triangles:,} triangles, at most {most:,} are read; simplify the mesh, for "
            "example by Blender's modifier 'Decimate' or by MeshLab's 'Quadric Edge Collapse Decimation'"
        )


def _announced_triangles(data: bytes, ending: str) -> int:
    """Return how many faces a file's first bytes say that it has; 0 where they do not say it."""
    if ending == "stl" and len(data) >= _STL_HEADER:
        (count,) = struct.unpack_from("<I", data, _STL_HEADER - 4)
        return int(count) if len(data) == _STL_HEADER + _STL_TRIANGLE * count else 0
    found = _COUNTS[ending].search(data[:8192]) if ending in _COUNTS else None
    return int(found[1]) if found else 0


def _read_obj(path: Path, data: bytes) -> MeshFile:
    read = ExportedObj(data, str(path))
    if not len(read.triangles):
        raise ObjectError(f"{path}: has no triangles: a point cloud or a curve has no surface to compare")
    files = NeighbouringFiles(path.parent)
    described = read_obj_materials(read.libraries, files)
    materials: list[Material] = []
    colour_of = no_colours(len(read.triangles))
    if read.vertex_colours is not None:
        colour_of = colours_of_corners(read.vertex_colours, read.triangles)
    for number, name in enumerate(read.materials):
        about = described.get(name)
        picture = _picture(about.texture, files) if about and about.texture else None
        is_missing = about is not None and about.texture is not None and picture is None
        materials.append(
            Material(name, about.colour if about else None, about.texture if about and is_missing else None)
        )
        if picture is not None:
            colour_of = _with_texture(colour_of, picture, read, number)
    return MeshFile(
        read.vertices,
        read.triangles,
        read.material_of,
        tuple(materials),
        np.zeros(len(read.triangles), dtype=np.intp),
        ("mesh",),
        colour_of,
    )


def _picture(name: str, files: NeighbouringFiles) -> Bytes | None:
    data = files.read(name)
    return None if data is None else read_picture(data)


def _with_texture(colour_of: Colours, picture: Bytes, read: ExportedObj, material: int) -> Colours:
    """Return the colours of faces, of which those of a material are where they are in its texture."""
    is_of_it = read.material_of == material
    found = colour_of.copy()
    found[is_of_it] = colours_in_texture(picture, read.corner_uv[is_of_it])
    return found
