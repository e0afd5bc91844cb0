"""Objects of format version 2 as text: a prism with a handle that is a shell of its own, and with painted faces."""

import math

import numpy as np

REACH = math.sqrt(1.0 - 0.08**2 - 0.25**2)  # so far a handle stands out that touches the unit sphere
BOX = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]  # corners by bits x, y, z

TOML = """\
format_version = 2
name = "mug"
title = "a prism with a handle"

[[part]]
name = "body"
select = { material = "clay" }

[[part]]
name = "handle"
select = { material = "grip" }
colour = [0.1, 0.5, 0.2]

[symmetry]
of = ["body"]
kind = "dihedral"
order = 8

[equality]
tolerance_px = 0.125

[provenance]
anything = "goes"
"""


class ObjText:
    """Gathers the lines of an OBJ file."""

    def __init__(self):
        self._vertices, self._faces = [], []

    def add(self, corners, faces, material):
        start = len(self._vertices) + 1
        self._vertices += [f"v {x:.12f} {y:.12f} {z:.12f}" for x, y, z in corners]
        self._faces += [f"usemtl {material}", *("f " + " ".join(str(start + k) for k in face) for face in faces)]
        return self

    def paint(self, face, material):
        """Give the face of a number, the materials not counted, a material of its own."""
        places = [place for place, line in enumerate(self._faces) if line.startswith("f ")]
        before = next(line for line in self._faces[places[face] :: -1] if line.startswith("usemtl"))
        self._faces[places[face] : places[face] + 1] = [f"usemtl {material}", self._faces[places[face]], before]
        return self

    def __str__(self):
        return "\n".join([*self._vertices, *self._faces]) + "\n"


def prism(facets=8, radius=0.6, half=0.5, material="clay"):
    """A prism about z with an edge at half a facet from the x axis: its sides are faces 0 to facets - 1."""
    angles = [2.0 * math.pi * (k + 0.5) / facets for k in range(facets)]
    rim = [(radius * math.cos(a), radius * math.sin(a)) for a in angles]
    corners = [(x, y, z) for z in (-half, half) for x, y in rim]
    sides = [(k, (k + 1) % facets, facets + (k + 1) % facets, facets + k) for k in range(facets)]
    caps = [tuple(range(facets - 1, -1, -1)), tuple(range(facets, 2 * facets))]
    return ObjText().add(corners, [*sides, *caps], material)


def add_box(text, low, high, material):
    corners = [[(low, high)[number >> axis & 1][axis] for axis in range(3)] for number in range(8)]
    return text.add(corners, BOX, material)


def mug(facets=8):
    """A prism with a handle along the x axis."""
    return str(add_box(prism(facets), (0.5, -0.08, -0.25), (REACH, 0.08, 0.25), "grip"))


def parted_toml(parts, group, tolerance_px=0.125):
    """An object.toml of parts, each a name, a material and a colour or None, over a group in TOML."""
    text = 'format_version = 2\nname = "thing"\ntitle = "a thing"\n'
    for name, material, colour in parts:
        text += f'[[part]]\nname = "{name}"\nselect = {{ material = "{material}" }}\n'
        text += f"colour = {list(colour)}\n" if colour else ""
    return f"{text}[symmetry]\n{group}\n[equality]\ntolerance_px = {tolerance_px}\n"


def painted(*faces, facets=8):
    """A prism that touches the unit sphere, with side faces painted: their numbers to their materials."""
    text = prism(facets, radius=0.8, half=0.6)
    for face, material in faces:
        text.paint(face, material)
    return str(text)


def drawn_set(spec, renderer, R_gt):
    """Which candidates draw the image: whole pictures compared point by point, over each coset."""
    ids, rgb = renderer.ids_and_rgb(R_gt)
    breaking = np.array(spec.mesh.breaking)
    member = np.zeros(len(spec.symmetry_group), bool)
    for coset in spec.cosets:
        worst = 0
        for g in spec.symmetry_group[coset]:
            other_ids, other_rgb = renderer.ids_and_rgb(R_gt @ g)
            either = np.isin(ids, breaking) | np.isin(other_ids, breaking)
            shade = np.abs(rgb.astype(int) - other_rgb.astype(int)).max(axis=-1)
            worst = max(worst, np.count_nonzero(either & ((ids != other_ids) | (shade > 12))))
        member[coset] = worst / 4 < spec.tolerance_px
    member[spec.cosets[0]] = True
    return member
