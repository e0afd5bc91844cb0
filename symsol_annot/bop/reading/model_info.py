"""What a BOP dataset says of one object: where its centre is, how large it is, and its symmetries."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from symsol_annot.bop.reading.json_files import JsonFile, is_there, number, numbers, read_table, typed
from symsol_annot.bop.reading.ply_vertices import PlyVertices, read_vertices
from symsol_annot.bop.reading.smallest_sphere import smallest_sphere
from symsol_annot.bop.reading.symmetries import symmetry_group
from symsol_annot.errors import DataError, SettingsError
from symsol_annot.rotations.so3 import Rotations

MODELS = "models"
MODELS_INFO_NAME = "models_info.json"
DIAMETERS_MM = (1e-3, 1e6)
_AXES = "xyz"
_RADIUS_TO_DIAMETER = (0.45, 0.65)  # of a smallest sphere: 0.5 to 0.612 (Jung's theorem), and what is measured


@dataclass(frozen=True, eq=False)
class ModelInfo:
    """An object of a BOP dataset, in model coordinates.

    Attributes:
        centre_mm: (3,) of the smallest sphere around its model; of its box where there is no model.
        radius_mm: of that sphere; half the diameter where there is no model.
        group: (G, 3, 3) its symmetries, the identity first.
        files: what was read.
    """

    centre_mm: npt.NDArray[np.float64]
    radius_mm: float
    group: Rotations
    files: tuple[JsonFile | PlyVertices, ...]


def read_model_info(root: Path, obj_id: int, diameter_mm: float | None = None) -> ModelInfo:
    """Read what a dataset says of an object in models/models_info.json and in models/obj_000001.ply.

    Either may be missing, and the first may have no entry of the object. Without an entry its group is the identity
    alone. Without both files, its centre is taken to be its origin.

    Args:
        root: the dataset's folder.
        obj_id: the object's id.
        diameter_mm: of the object, where neither file says it.

    Raises:
        DataError: a file is broken, or they contradict each other.
        SettingsError: nobody says the diameter, or it is no length.
    """
    path, model = root / MODELS / MODELS_INFO_NAME, root / MODELS / f"obj_{obj_id:06d}.ply"
    file = read_table(root, path, "a table with an entry per object") if is_there(path) else None
    what = f"{path}: object {obj_id}"
    info = typed(file.table, str(obj_id), dict, str(path)) if file and str(obj_id) in file.table else {}
    stated = number(info["diameter"], f"{what}: diameter") if "diameter" in info else diameter_mm
    if stated is not None:
        _check_diameter(stated, what, is_from_file="diameter" in info)
    box_centre_mm = _box_centre(info, what)
    ply = read_vertices(root, model) if is_there(model) else None
    if ply:
        centre_mm, radius_mm = smallest_sphere(ply.points)
        _check_diameter(2.0 * radius_mm, str(model), is_from_file=True)
        least, most = _RADIUS_TO_DIAMETER
        if "diameter" in info and not least <= radius_mm / float(info["diameter"]) <= most:
            raise DataError(
                f"{what}: its diameter is {float(info['diameter']):.6g} mm, but the smallest sphere around {model} has "
                f"a radius of {radius_mm:.6g}: expected {least:g} to {most:g} of the diameter; is one of them in "
                "another unit?"
            )
    elif stated is not None:
        centre_mm, radius_mm = box_centre_mm, stated / 2.0
    else:
        raise SettingsError(
            f"{what}: its size is not said, there or in {model.name}; give its diameter with --diameter-mm"
        )
    group = symmetry_group(info, centre_mm, 2.0 * radius_mm, what)
    return ModelInfo(centre_mm, radius_mm, group, tuple(read for read in (file, ply) if read))


def _check_diameter(diameter_mm: float, what: str, *, is_from_file: bool) -> None:
    least, most = DIAMETERS_MM
    if not least <= diameter_mm <= most:
        error = DataError if is_from_file else SettingsError
        raise error(f"{what}: diameter: expected {least:g} to {most:g} mm, found {diameter_mm:g}")


def _box_centre(info: dict[str, Any], what: str) -> npt.NDArray[np.float64]:
    names = [f"{side}_{axis}" for side in ("min", "size") for axis in _AXES]
    there = [name for name in names if name in info]
    if there and len(there) < len(names):
        missing = next(name for name in names if name not in info)
        raise DataError(f"{what}: has {there[0]} and no {missing}; expected min and size along x, y and z, or none")
    if not there:
        return np.zeros(3)
    box = numbers([info[name] for name in names], len(names), f"{what}: min and size")
    if box[3:].min() < 0:
        raise DataError(f"{what}: size: expected lengths of 0 or more, found {box[3:].tolist()}")
    return np.asarray(box[:3] + box[3:] / 2.0)
