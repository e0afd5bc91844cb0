"""What a set was made from, found again: its object, camera and settings."""

from pathlib import Path

from symsol_annot.errors import DataError
from symsol_annot.generation.kept_object import KEPT_OBJECT
from symsol_annot.objects.spec import ObjectSpec, builtin_names, load_object, read_object
from symsol_annot.sets.manifest import Manifest
from symsol_annot.sets.plan import SetPlan


def plan_behind(folder: Path, manifest: Manifest, given: ObjectSpec | None = None) -> SetPlan:
    """Return the plan that a set was made by, to draw its images again.

    Args:
        folder: the set's.
        manifest: the set's.
        given: the object, where it is neither built in nor kept in the set's folder.

    Raises:
        DataError: the set was imported or is sealed, or its object is not built in and was not given, or is another
            one here.
    """
    return SetPlan.behind(manifest, object_behind(folder, manifest, given))


def object_behind(folder: Path, manifest: Manifest, given: ObjectSpec | None = None) -> ObjectSpec:
    """Return the object that a set was made from.

    Args:
        folder: the set's, where an object that was made from a mesh file is kept.
        manifest: the set's.
        given: the object, where it is neither built in nor kept.

    Raises:
        DataError: as `plan_behind`.
    """
    if manifest.is_imported:
        command = manifest.imported.source.command
        raise DataError(f"{folder}: was imported, so it cannot be drawn again; `symsol-annot {command}` makes it anew")
    if manifest.is_sealed:
        raise DataError(f"{folder}: is sealed, so it can be drawn again by whoever has its secret alone; fetch it anew")
    name = manifest.settings.object
    if given and given.name == name:
        spec = given
    elif name in builtin_names():  # a manifest may name a path, and no object is taken from there
        spec = load_object(name)
    elif (folder / KEPT_OBJECT / "object.toml").is_file():
        spec = read_object(folder / KEPT_OBJECT)
    else:
        raise DataError(f"{folder}: its object {name!r} is not built in; give its folder with --object")
    if spec.digest != manifest.rendered.object_sha256:
        raise DataError(
            f"{folder}: was made from another {name} than the one here (their digests differ); "
            "give the object's folder with --object"
        )
    return spec
