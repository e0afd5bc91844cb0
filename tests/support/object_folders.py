"""Folders of objects as text: a marked tetrahedron, with and without its marking, and edits of it."""

from importlib import resources
from pathlib import Path

import pytest

BUILTIN = (
    "box",
    "cone",
    "cube",
    "cyl",
    "cylO",
    "die",
    "dots",
    "icosa",
    "mug",
    "nut",
    "screw",
    "sphereX",
    "tet",
    "tetX",
)
ASSETS = Path(str(resources.files("symsol_annot_assets")))
every_builtin = pytest.mark.parametrize("name", BUILTIN)
TOML = """\
format_version = 1
name = "mug"
title = "a tetrahedron with one face coloured"

[body.group]
kind = "tetrahedral"

[marking]
tolerance_px = 2.5
any_part_fixes_rotation = true

[marking.stabiliser]
kind = "cyclic"
order = 3
axis = [1, 1, 1]

[provenance]
anything = "goes"
"""
H = 1 / 3**0.5
TETRAHEDRON = [f"v {H} {H} {H}", f"v {H} -{H} -{H}", f"v -{H} {H} -{H}", f"v -{H} -{H} {H}"]
MESH = "\n".join([*TETRAHEDRON, "f 1 3 4", "f 1 4 2", "f 1 2 3", "usemtl marking", "f 2 4 3"]) + "\n"
UNMARKED_TOML = TOML.split("[marking]", maxsplit=1)[0]
UNMARKED_MESH = MESH.replace("usemtl marking\n", "")


def edited(text, old, new):
    """Replace a line that the text holds once; also return its number."""
    lines = text.splitlines()
    (index,) = [i for i, line in enumerate(lines) if line == old]
    lines[index] = new
    return "\n".join(lines) + "\n", index + 1


LINE_OF_KIND = {"body.group.kind": 'kind = "tetrahedral"', "marking.stabiliser.kind": 'kind = "cyclic"'}
REQUIRED = {
    "format_version": "format_version = 1",
    "name": 'name = "mug"',
    "title": 'title = "a tetrahedron with one face coloured"',
    "marking.tolerance_px": "tolerance_px = 2.5",
    "marking.any_part_fixes_rotation": "any_part_fixes_rotation = true",
    "marking.stabiliser.order": "order = 3",
} | LINE_OF_KIND


def toml_of(group, stabiliser=None):
    text = f'format_version = 1\nname = "mug"\ntitle = "mug"\n[body.group]\n{group}\n'
    if stabiliser is None:
        return text
    return f"{text}[marking]\ntolerance_px = 5\nany_part_fixes_rotation = true\n[marking.stabiliser]\n{stabiliser}\n"
