"""The materials that an OBJ file's `mtllib` describes: their colours, and the textures that they name."""

import math
from dataclasses import dataclass

from symsol_annot.objects.mesh_files.neighbouring_files import NeighbouringFiles

_OPTIONS = {"-blendu": 1, "-blendv": 1, "-bm": 1, "-boost": 1, "-cc": 1, "-clamp": 1, "-imfchan": 1, "-mm": 2}
_OPTIONS |= {"-o": 3, "-s": 3, "-t": 3, "-texres": 1, "-colorspace": 1}  # how many words follow each, at most


@dataclass(frozen=True)
class ObjMaterial:
    """What a `newmtl` says.

    Attributes:
        colour: `Kd`, linear RGB from 0 to 1; None where it says none.
        texture: the file that `map_Kd` names; None where there is none.
    """

    colour: tuple[float, float, float] | None = None
    texture: str | None = None


def read_obj_materials(libraries: list[str], files: NeighbouringFiles) -> dict[str, ObjMaterial]:
    """Return name to material of the libraries that an OBJ file names; one that is not there describes none."""
    found: dict[str, ObjMaterial] = {}
    for library in libraries:
        data = files.read(library)
        name = ""
        for line in (data or b"").decode("latin-1").removeprefix("\xef\xbb\xbf").splitlines():
            words = line.split("#", 1)[0].split()
            if len(words) < 2:
                continue
            if words[0] == "newmtl":
                name = " ".join(words[1:])
                found[name] = ObjMaterial()
            elif words[0] == "Kd" and name:
                found[name] = ObjMaterial(_colour(words[1:]), found[name].texture)
            elif words[0].lower() == "map_kd" and name:
                found[name] = ObjMaterial(found[name].colour, _file_in(words[1:]))
    return found


def _colour(words: list[str]) -> tuple[float, float, float] | None:
    try:
        red, green, blue = (float(word) for word in words)
    except ValueError:
        return None
    if not all(math.isfinite(value) for value in (red, green, blue)):
        return None
    return (min(max(red, 0.0), 1.0), min(max(green, 0.0), 1.0), min(max(blue, 0.0), 1.0))


def _file_in(words: list[str]) -> str | None:
    """Return the file's name in a `map_Kd`, which may have blanks in it, after the options."""
    place = 0
    while place < len(words) and words[place] in _OPTIONS:
        most = place + 1 + _OPTIONS[words[place]]
        place += 2
        while place < most and _is_number(words[place] if place < len(words) else ""):
            place += 1
    return " ".join(words[place:]) or None


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
