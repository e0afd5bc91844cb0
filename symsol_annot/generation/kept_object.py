"""The object of a set that was made from a mesh file, kept in the set's folder, so that the set can be drawn again."""

from collections.abc import Mapping
from pathlib import Path

from symsol_annot.errors import OutputError, output_errors
from symsol_annot.objects.importing.object_writing import written_object
from symsol_annot.objects.spec import ObjectSpec
from symsol_annot.system.files import make_folder
from symsol_annot.system.scratch import Scratch, temporary_errors

KEPT_OBJECT = "object"  # the folder's name in that of the set


def checked_object(files: Mapping[str, bytes]) -> ObjectSpec:
    """Return the object that files describe, read and checked as from a folder, which is gone afterwards.

    Raises:
        ObjectError: they are no object, or it has not the symmetries that it declares.
        OutputError: temporary files cannot be written.
    """
    with temporary_errors():
        scratch = Scratch()
    with scratch, written_object(scratch.path / KEPT_OBJECT, files) as (_, spec):
        return spec


def keep_object(set_folder: Path, files: Mapping[str, bytes]) -> None:
    """Put an object into the folder of its set, where it may be already.

    Raises:
        OutputError: another object is there, or the folder cannot be written.
    """
    folder = set_folder / KEPT_OBJECT
    with output_errors(folder):
        is_there = folder.exists() or folder.is_symlink()
        is_same = is_there and all(
            (folder / name).is_file() and (folder / name).read_bytes() == data for name, data in files.items()
        )
    if is_same:
        return
    if is_there:
        raise OutputError(
            f"{folder}: is there already, and is not the object of this set; move it away, or use another --out folder"
        )
    make_folder(set_folder)
    with written_object(folder, files):
        pass
