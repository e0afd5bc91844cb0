"""`symsol-annot import-object`: a mesh file of any program as an object."""

from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING

import click
from symsol_annot_cli.parameters import TOLERANCE, NearChoice, example
from symsol_annot_cli.terminal import say

from symsol_annot.errors import RenderError
from symsol_annot.objects.spec import ObjectSpec, builtin_names
from symsol_annot.system.text.names import OBJECT_NAME_RULE, is_object_name

if TYPE_CHECKING:  # these take scipy
    from symsol_annot.objects.importing.bop_models import BopSymmetries
    from symsol_annot.objects.importing.importing import ImportedObject, ImportOptions

SHEET_NAME = "views.png"
_PARTS = ("auto", "material", "colour", "node", "component", "none")  # as objects.importing.parting has them


@click.command(
    "import-object",
    epilog=example(
        "symsol-annot import-object mug.stl --out mug",
        "symsol-annot import-object models --id 3 --out obj3",
        "symsol-annot render --object mug --train 0 --test 100",
    ),
)
@click.argument("path", metavar="FILE", type=click.Path(path_type=Path))
@click.option("--out", "folder", type=click.Path(path_type=Path), required=True, help="The object's new folder.")
@click.option("--name", help="Name of the object.  [default: the folder's name]")
@click.option(
    "--parts",
    type=NearChoice(_PARTS),
    default=_PARTS[0],
    show_default=True,
    help="What tells the parts. auto: materials where there are several, else colours, else the scene's nodes, else "
    "components where the group needs it.",
)
@click.option("--body", help="Which part is the body, whose symmetries are found.  [default: the largest by area]")
@TOLERANCE
@click.option(
    "--round-within",
    type=click.FloatRange(0, 0.018),
    help="Take facets for round where they are no farther from it than this part of the radius.",
)
@click.option("--id", "number", type=click.IntRange(0), help="Number of the model, in a folder of BOP's models.")
@click.option("--ignore-bop", is_flag=True, help="Take the symmetries of the mesh, whatever models_info.json states.")
def import_object(
    path: Path,
    folder: Path,
    name: str | None,
    parts: str,
    body: str | None,
    tolerance: float,
    round_within: float | None,
    number: int | None,
    *,
    ignore_bop: bool,
) -> None:
    """Make an object of a mesh file: its parts told apart, its symmetries found, its origin and size as they must be.

    FILE is a mesh (OBJ; STL, PLY, OFF, GLB, glTF, DAE with the extra `mesh`) in any unit and place, or a folder of
    BOP's models. What is safe to mend is mended and said; all else is refused with what mends it. OUT then holds
    object.toml, mesh.obj and, where Blender is installed, views.png.
    """
    from symsol_annot.objects.importing.importing import ImportOptions  # noqa: PLC0415 - takes scipy

    name = object_name(folder.resolve().name) if name is None else name
    if not is_object_name(name):
        raise click.UsageError(f"--name: expected {OBJECT_NAME_RULE}, found {name!r}")
    bop = None
    if path.is_dir():
        from symsol_annot.objects.importing.bop_models import bop_model  # noqa: PLC0415

        path, bop = bop_model(path, number)
    elif number is not None:
        raise click.UsageError("--id is for a folder of BOP's models, and FILE is none")
    options = ImportOptions(parts, body, tolerance, round_within)
    say("\n".join(write_import(path, folder, name, options, None if ignore_bop else bop)))
    say(f"Next:\n  symsol-annot render --object {quote(str(folder))} --train 0 --test 100")


def object_name(text: str) -> str:
    """Return the name of an object that a folder or a file of a name gives it: none of a built-in one's."""
    from symsol_annot.objects.importing.parting import as_object_name  # noqa: PLC0415 - takes scipy

    name = as_object_name(text) or "object"
    return f"{name}-mesh" if name in builtin_names() else name


def write_import(
    path: Path,
    folder: Path,
    name: str,
    options: "ImportOptions",
    bop: "BopSymmetries | None" = None,
    *,
    drawn: bool = True,
) -> list[str]:
    """Import a mesh file into a folder, and return the lines that say what was done.

    Args:
        path: of the mesh file.
        folder: where the object goes.
        name: of the object.
        options: what the user says about it.
        bop: symmetries that BOP states of it; None where none are compared.
        drawn: whether a picture of it is put into the folder, if it can be drawn here.
    """
    from symsol_annot.objects.importing.bop_models import compare_with_bop  # noqa: PLC0415 - takes scipy
    from symsol_annot.objects.importing.importing import import_mesh  # noqa: PLC0415
    from symsol_annot.objects.importing.object_writing import object_files, written_object  # noqa: PLC0415

    imported = import_mesh(path, name, options)
    with written_object(folder, object_files(imported.draft)) as (made, spec):
        if bop is not None:
            of_object = imported.frame @ spec.stabiliser @ imported.frame.T
            compare_with_bop(bop, imported.found, of_object, path)
        sheet = _sheet_of(spec) if drawn else ""
        if isinstance(sheet, bytes):
            (made / SHEET_NAME).write_bytes(sheet)
    files = ["object.toml", "mesh.obj", *([SHEET_NAME] if isinstance(sheet, bytes) else [])]
    lines = [*import_in_words(imported, spec), f"wrote {folder}: {', '.join(files)} of {name!r}"]
    return (
        lines
        if isinstance(sheet, bytes) or not drawn
        else [*lines, f"  no picture of it, which cannot be drawn here: {sheet}"]
    )


def import_in_words(imported: "ImportedObject", spec: ObjectSpec) -> list[str]:
    """Return the lines that say what was made of a mesh file."""
    from symsol_annot.objects.finding.report import report_lines  # noqa: PLC0415 - takes scipy

    lines = [line for line in report_lines(imported.found) if not line.startswith("larger ")]
    if not imported.draft.of_body:
        one = imported.found.larger[0]
        lines.append(
            f"without      {one.what} it has {one.group.name}: that is declared, and whole images are compared"
        )
    for number, part in enumerate(spec.parts, start=1):
        kept = ", breaks the symmetry" if number in spec.mesh.breaking and spec.marking is not None else ""
        lines.append(f"part {number:<8}{part.name}: {(spec.mesh.part_ids == number).sum()} triangles{kept}")
    among = "turns that keep one part each" if spec.has_all_rotations else "rotations"
    kept = f"{len(spec.stabiliser)} of {len(spec.symmetry_group)} {among} leave all parts in place"
    is_plain_ball = spec.has_all_rotations and spec.marking is None
    lines.append(f"symmetries   {'all rotations leave it in place' if is_plain_ball else kept}")
    lines += [f"mended       {note}" for note in imported.notes]
    x, y, z = (0.0 if abs(value) < 1e-9 * imported.scale else value for value in imported.centre)
    lines.append(
        f"placed       ({x:.6g}, {y:.6g}, {z:.6g}) is the origin, {imported.scale:.6g} of the file's units are one"
    )
    return lines


def _sheet_of(spec: ObjectSpec) -> bytes | str:
    """Return the picture of an object, or in words why there is none."""
    from symsol_annot.plotting.object_sheet import object_sheet  # noqa: PLC0415 - of no use to other commands

    try:
        return object_sheet(spec)
    except RenderError as error:
        return str(error)
