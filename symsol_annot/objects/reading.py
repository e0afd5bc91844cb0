"""The surface of anything that has one: a mesh file, an object's folder, a built-in object."""

from pathlib import Path

from symsol_annot.errors import ObjectError
from symsol_annot.objects.finding.surface import Surface, surface_of_mesh
from symsol_annot.objects.mesh_files.reading import ENDINGS, read_surface
from symsol_annot.objects.spec import builtin_names, load_object


def read_any_surface(name_or_path: str) -> Surface:
    """Return the surface of a built-in object by its name, of an object's folder, or of a mesh file.

    Raises:
        ObjectError: there is none, or it is broken.
        MissingExtraError: trimesh is not installed, and the file is no OBJ.
    """
    path = Path(name_or_path)
    if name_or_path in builtin_names() or path.is_dir():
        return surface_of_mesh(load_object(name_or_path).mesh)
    if not path.exists():
        raise ObjectError(
            f"{path}: no such file; expected a mesh ({', '.join(ENDINGS)}), an object's folder, "
            f"or one of the built-in objects {', '.join(builtin_names())}"
        )
    return read_surface(path)
