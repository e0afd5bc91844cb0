"""`symsol-annot symmetries`: find the symmetries of a mesh."""

import json
from pathlib import Path

import click
from symsol_annot_cli.import_object import object_name, write_import
from symsol_annot_cli.parameters import TOLERANCE, example, is_mesh_name
from symsol_annot_cli.terminal import say

from symsol_annot.errors import ObjectError
from symsol_annot.system.files import write_atomically


@click.command(
    epilog=example(
        "symsol-annot symmetries part.stl", "symsol-annot symmetries part.obj --write part --bop models_info.json"
    )
)
@click.argument("mesh")
@TOLERANCE
@click.option(
    "--round-within",
    type=click.FloatRange(0, 0.018),
    help="Take facets for round where they are no farther from it than this part of the radius.",
)
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@click.option(
    "--write",
    "folder",
    type=click.Path(path_type=Path),
    help="Write the object into this new folder, as import-object does.",
)
@click.option(
    "--bop", type=click.Path(path_type=Path), help="Write the symmetries as BOP has them in models_info.json."
)
@click.option(
    "--id", "number", type=click.IntRange(1), default=1, show_default=True, help="Id of the model in the file of --bop."
)
def symmetries(
    mesh: str,
    tolerance: float,
    round_within: float | None,
    folder: Path | None,
    bop: Path | None,
    number: int,
    *,
    as_json: bool,
) -> None:
    """Find the rotations that map a mesh onto itself, and those of what is left without some of its faces.

    MESH is a file (OBJ, STL, PLY, OFF, GLB), an object's folder, or the name of a built-in object. Lengths are printed
    as parts of its radius, which is measured from its group's fixed point.
    """
    if folder is not None and not is_mesh_name(mesh):
        raise click.UsageError("--write makes an object of a mesh file, so not of an object")
    from symsol_annot.objects.finding.record import bop_model_info, symmetries_to_json  # noqa: PLC0415 - takes scipy
    from symsol_annot.objects.finding.symmetries import find_symmetries  # noqa: PLC0415
    from symsol_annot.objects.reading import read_any_surface  # noqa: PLC0415
    from symsol_annot.rotations.groups import ALL_ROTATIONS  # noqa: PLC0415 - takes scipy

    surface = read_any_surface(mesh)
    found = find_symmetries(surface, tolerance, round_within=round_within)
    if as_json:
        say(json.dumps(symmetries_to_json(found), indent=2))
    else:
        from symsol_annot.objects.finding.report import report_lines  # noqa: PLC0415

        say("\n".join(report_lines(found)))
    if folder is not None:
        from symsol_annot.objects.importing.importing import ImportOptions  # noqa: PLC0415

        options = ImportOptions(tolerance=tolerance, round_within=round_within)
        lines = write_import(Path(mesh), folder, object_name(folder.resolve().name), options, drawn=False)
        say(lines[-1], err=as_json)
    if bop is not None:
        entries = _entries_of(bop)
        entries[str(number)] = bop_model_info(surface, found)
        write_atomically(bop, (json.dumps(entries, indent=2) + "\n").encode())
        say(f"wrote {bop}: model {number}", err=as_json)
        if found.object.kind == ALL_ROTATIONS:
            say(
                "  BOP cannot list SO(3): it holds the turns about three axes, and no rotations between them",
                err=as_json,
            )


def _entries_of(path: Path) -> dict[str, object]:
    """Return what a models_info.json holds already; nothing where there is none."""
    if not path.exists():
        return {}
    try:
        entries = json.loads(path.read_text(encoding="utf-8"))
    except ValueError:
        entries = None
    if not isinstance(entries, dict):
        raise ObjectError(f"{path}: is no models_info.json, so nothing was written; give another file with --bop")
    return entries
