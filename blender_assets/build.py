"""Build the folders of the built-in objects: object.toml and mesh.obj.

    python -m symsol_annot_assets.build            # write them
    python -m symsol_annot_assets.build --check    # say whether what is there is what this script builds

Coordinates are written with 9 decimals, so that the last bit of a platform's cosine does not show.
"""

import argparse
import sys
from collections.abc import Callable
from pathlib import Path

from symsol_annot_assets import parted
from symsol_annot_assets.ball import marked_ball
from symsol_annot_assets.meshes import FACETS, MeshBuilder
from symsol_annot_assets.published import (
    MARKED_FACE,
    cone,
    cube_corners,
    cylinder,
    icosahedron_corners,
    regular_solid,
    tetrahedron_corners,
)

Colour = tuple[float, float, float]


def _marking_table(tolerance_px: float, stabiliser: str) -> str:
    return (
        f"[marking]\ntolerance_px = {tolerance_px}\nany_part_fixes_rotation = true\n\n"
        f"[marking.stabiliser]\n{stabiliser}"
    )


PUBLISHED: dict[str, tuple[str, Callable[[], MeshBuilder], str, str | None]] = {
    "tet": ("regular tetrahedron", lambda: regular_solid(tetrahedron_corners()), 'kind = "tetrahedral"', None),
    "cube": ("cube", lambda: regular_solid(cube_corners()), 'kind = "octahedral"', None),
    "icosa": ("regular icosahedron", lambda: regular_solid(icosahedron_corners()), 'kind = "icosahedral"', None),
    "cone": ("cone", cone, f'kind = "cyclic"\norder = {FACETS}\naxis = [0, 0, 1]', None),
    "cyl": ("cylinder", cylinder, f'kind = "dihedral"\norder = {FACETS}', None),
    "tetX": (
        "regular tetrahedron with one face coloured",
        lambda: regular_solid(tetrahedron_corners(), MARKED_FACE),
        'kind = "tetrahedral"',
        # A face seen edge-on draws a handful of pixels; 5 is the thesis's tolerance (section 5.1.2).
        _marking_table(tolerance_px=5, stabiliser='kind = "cyclic"\norder = 3\naxis = [1, 1, 1]'),
    ),
    "cylO": (
        "cylinder with a disc on its side, near one end",
        lambda: cylinder(discs=[0]),
        f'kind = "dihedral"\norder = {FACETS}',
        # Less than one of the 4 samples of a pixel: hidden means not a trace.
        _marking_table(tolerance_px=0.125, stabiliser='kind = "cyclic"\norder = 1'),
    ),
}  # fmt: skip

ROUND = f'kind = "cyclic"\norder = {FACETS}\naxis = [0, 0, 1]'

# Title, mesh, the names of the parts (which are also their materials) with their colours, and the body's group.
PARTED: dict[str, tuple[str, Callable[[], MeshBuilder], dict[str, Colour | None], str]] = {
    "mug": ("cup, round about its axis, with a handle", parted.mug, {"body": None, "handle": None}, ROUND),
    "nut": ("hexagonal nut", parted.nut, {"body": None}, 'kind = "dihedral"\norder = 6'),
    "screw": ("screw with a round head and a hexagonal socket", parted.screw, {"body": None, "socket": None}, ROUND),
    "dots": (
        "cylinder with two equal dots on its side, a quarter turn apart",
        parted.dots,
        {"body": None, "spots": None},
        f'kind = "dihedral"\norder = {FACETS}',
    ),
    "die": ("die with pips", parted.die, {"body": None, "pips": (0.02, 0.02, 0.03)}, 'kind = "octahedral"'),
    "box": (
        "box of six colours, square about its axis",
        parted.box,
        {
            "bottom": (0.75, 0.75, 0.70),
            "top": (0.90, 0.10, 0.05),
            "front": (0.95, 0.45, 0.02),
            "back": (0.85, 0.80, 0.05),
            "left": (0.05, 0.50, 0.15),
            "right": (0.05, 0.20, 0.85),
        },
        'kind = "dihedral"\norder = 4',
    ),
    "sphereX": (
        "ball with an X and, beside one end of it, a disc",
        marked_ball,
        {"body": None, "x": (0.02, 0.06, 0.60), "disc": (0.95, 0.16, 0.04)},
        # How far inside of the unit sphere the facets lie at most, in radii: a sixteenth of a pixel of the usual image.
        'kind = "so3"\nmax_offset = 0.0006',
    ),
}

OBJECTS = (*PUBLISHED, *PARTED)


def files_of(name: str) -> dict[str, str]:
    """Return the files of one object's folder: name to text."""
    if name in PARTED:
        return _parted_files(name)
    title, build, group, marking = PUBLISHED[name]
    marking_table = f"\n{marking}\n" if marking else ""
    toml = (
        f'format_version = 1\nname = "{name}"\ntitle = "{title}"\n\n[body.group]\n{group}\n{marking_table}\n'
        '[provenance]\nbuilt_by = "symsol_annot_assets.build"\n'
        'after = "SYMSOL (Murphy et al., 2021) and T. Bertens, master\'s thesis, TU Eindhoven"\nlicence = "CC-BY-4.0"\n'
    )
    return {"object.toml": toml, "mesh.obj": build().text(title)}


def _parted_files(name: str) -> dict[str, str]:
    title, build, parts, group = PARTED[name]
    tables = "".join(
        f'[[part]]\nname = "{part}"\nselect = {{ material = "{part}" }}\n'
        + (f"colour = {list(colour)}\n\n" if colour else "\n")
        for part, colour in parts.items()
    )
    toml = (
        f'format_version = 2\nname = "{name}"\ntitle = "{title}"\n\n{tables}[symmetry]\nof = ["{next(iter(parts))}"]\n'
        f'{group}\n\n[equality]\ntolerance_px = 0.125\n\n[provenance]\nbuilt_by = "symsol_annot_assets.build"\n'
        'licence = "CC-BY-4.0"\n'
    )
    return {"object.toml": toml, "mesh.obj": build().text(title)}


def main() -> int:
    """Write the folders, or with --check compare them; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="compare instead of writing")
    parser.add_argument("--out", type=Path, default=Path(__file__).resolve().parent, help="the folder of the folders")
    arguments = parser.parse_args()
    stale = []
    for name in OBJECTS:
        for file, text in files_of(name).items():
            path = arguments.out / name / file
            if arguments.check:
                if not path.is_file() or path.read_bytes() != text.encode():
                    stale.append(str(path))
            else:
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(text.encode())
    for path_text in stale:
        print(f"{path_text} is not what symsol_annot_assets.build builds", file=sys.stderr)
    return 1 if stale else 0


if __name__ == "__main__":
    sys.exit(main())
