"""Mesh files of any program, read as a surface with parts: OBJ here, others by trimesh."""

import io
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from symsol_annot.errors import MissingExtraError, ObjectError
from symsol_annot.objects.exported_obj import ExportedObj
from symsol_annot.objects.finding.surface import Surface, make_surface
from symsol_annot.objects.obj_file import read_object_file

ENDINGS = ("obj", "stl", "ply", "off", "glb", "gltf")
MAX_FILE_BYTES = 2**28
MAX_SURFACE_TRIANGLES = 500_000


def read_surface(path: Path) -> Surface:
    """Read a mesh file; what it names materials or nodes are its parts, one body where it names none.

    Raises:
        ObjectError: it is missing, broken, too large, or no mesh; the message says what to do.
        MissingExtraError: trimesh is not installed, and the file is no OBJ.
    """
    ending = path.suffix.lower().removeprefix(".")
    if ending not in ENDINGS:
        raise ObjectError(
            f"{path}: expected a mesh file that ends in {', '.join(ENDINGS)}; export it as one of these, "
            "CAD files (STEP, IGES) with a chordal tolerance of a thousandth of the part's size"
        )
    data = read_object_file(path, MAX_FILE_BYTES)
    if ending == "obj":
        read = ExportedObj(data, str(path))
        vertices, triangles, part_of, names = read.vertices, read.triangles, read.material_of, read.materials
    else:
        vertices, triangles, part_of, names = _by_trimesh(path, data, ending)
    if len(triangles) > MAX_SURFACE_TRIANGLES:
        raise ObjectError(
            f"{path}: {len(triangles):,} triangles, at most {MAX_SURFACE_TRIANGLES:,} are read; simplify the mesh, for "
            "example by Blender's modifier 'Decimate' or by MeshLab's 'Quadric Edge Collapse Decimation'"
        )
    try:
        return make_surface(vertices, triangles, part_of, names or ("body",))
    except ObjectError as error:
        raise ObjectError(f"{path}: {error}") from None


def _by_trimesh(
    path: Path, data: bytes, ending: str
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.intp], npt.NDArray[np.intp], tuple[str, ...]]:
    try:
        import trimesh  # noqa: PLC0415 - an extra
    except ImportError:
        raise MissingExtraError(f"{path.name}: reading {ending.upper()}", "trimesh", "mesh") from None
    try:
        scene = trimesh.load_scene(io.BytesIO(data), file_type=ending, process=False)
        solids = [(name, *_placed(scene, name)) for name in sorted(scene.graph.nodes_geometry)]
    except Exception as error:  # noqa: BLE001 - trimesh raises what its readers meet
        raise ObjectError(f"{path}: cannot be read as {ending.upper()}: {type(error).__name__}: {error}") from None
    solids = [solid for solid in solids if len(solid[2])]
    if not solids:
        raise ObjectError(f"{path}: has no triangles: a point cloud or a curve has no surface to compare")
    counts = np.cumsum([0, *(len(points) for _, points, _ in solids)])
    triangles = [faces + offset for offset, (_, _, faces) in zip(counts[:-1], solids, strict=True)]
    part_of = np.repeat(np.arange(len(solids)), [len(faces) for _, _, faces in solids])
    names = tuple(name for name, _, _ in solids) if len(solids) > 1 else ("body",)
    return np.concatenate([points for _, points, _ in solids]), np.concatenate(triangles), part_of, names


def _placed(scene: Any, node: str) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.intp]]:
    """Return the vertices of a scene's node, where it stands, and its triangles; none where it is no mesh."""
    matrix, geometry = scene.graph[node]
    mesh = scene.geometry[geometry]
    faces = np.asarray(getattr(mesh, "faces", np.zeros((0, 3))), dtype=np.intp).reshape(-1, 3)
    points = np.asarray(mesh.vertices, dtype=np.float64)
    return points @ matrix[:3, :3].T + matrix[:3, 3], faces
