"""Objects whose body every rotation maps onto itself: a ball, and the parts on it that break SO(3).

SO(3) cannot be listed. What can be is what keeps a part in place: a part whose centroid lies off the ball's middle is
kept by turns about the line through both, by a few of them or by a circle. Images that show some of the parts are drawn
alike by the turns that keep all of these, as far as the others stay out of sight; so the turns of all parts are the
list of candidates.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from symsol_annot.objects.mesh import BODY_ID, Mesh
from symsol_annot.objects.object_toml import ObjectToml
from symsol_annot.objects.part_symmetries import moments_of, order_about
from symsol_annot.objects.parts import Part
from symsol_annot.rotations.groups import ALL_ROTATIONS, GROUP_KINDS, cyclic_group
from symsol_annot.rotations.so3 import Rotations

Flags = npt.NDArray[np.bool_]

_OFF_MIDDLE = 1e-3  # radii from the ball's middle, under which a centroid gives no direction
_DECIMALS = 9  # of an axis, as meshes have them: its last bits depend on the order of a sum
_SAME = 1e-6  # Frobenius distance of rotations that are one
_ALIKE = 1e-4  # of areas, distances and moments of parts that a rotation may carry onto each other


@dataclass(frozen=True, eq=False)
class TurnsOfParts:
    """What keeps the parts of a ball in place.

    Attributes:
        ids: of the parts that break SO(3), ascending.
        candidates: (G, 3, 3) all rotations that keep one of them, the identity first, circles last.
        kept: (B, G) bool, which of the candidates keep each part.
    """

    ids: tuple[int, ...]
    candidates: Rotations
    kept: Flags


def declares_all_rotations(toml: ObjectToml) -> bool:
    """Tell whether an object.toml of format version 2 declares SO(3) as the group.

    Raises:
        ObjectError: it declares a group of no kind.
    """
    kind = toml.take("symmetry.kind", str) if toml.has("symmetry.kind") else None
    if kind is not None and kind not in GROUP_KINDS and kind != ALL_ROTATIONS:
        raise toml.fault("symmetry.kind", f"expected one of {', '.join(GROUP_KINDS)}, {ALL_ROTATIONS}, found {kind!r}")
    return kind == ALL_ROTATIONS


def turns_of_parts(toml: ObjectToml, mesh: Mesh, parts: tuple[Part, ...], of: tuple[str, ...]) -> TurnsOfParts:
    """Return which turns keep the parts in place that are not named `of`, the ball.

    Raises:
        ObjectError: no part is the ball, a part lies evenly around its middle, or two of one colour look alike.
    """
    if not of:
        raise toml.fault("symmetry.of", f"names no part, but the group {ALL_ROTATIONS!r} is that of a ball: name it")
    ids = tuple(BODY_ID + number for number, part in enumerate(parts) if part.name not in of)
    _refuse_look_alikes(toml, mesh, parts, ids)
    turns = [_turns_of(toml, mesh, parts, part) for part in ids]
    found = np.eye(3)[None]
    for of_part in sorted(turns, key=len):
        found = np.concatenate([found, of_part[~_is_among(of_part, found)]])
    kept = np.array([_is_among(found, of_part) for of_part in turns]).reshape(len(ids), len(found))
    return TurnsOfParts(ids, found, kept)


def _turns_of(toml: ObjectToml, mesh: Mesh, parts: tuple[Part, ...], part: int) -> Rotations:
    """Return the turns (n, 3, 3) that keep a part in place, the identity first: all are about its centroid's line."""
    triangles = mesh.triangles_of(part)
    _, centroid, _ = moments_of(triangles)
    distance = float(np.linalg.norm(centroid))
    if distance < _OFF_MIDDLE:
        raise toml.fault(
            f"part.{part - BODY_ID}.name",
            f"{parts[part - BODY_ID].name!r} lies evenly around the ball's middle, so that turns about several axes "
            "may keep it in place; such a part is not read yet. Make pieces of it parts, each in a colour of its own",
        )
    axis = np.round(centroid / distance, _DECIMALS)
    return cyclic_group(order_about(axis, triangles), axis)


def _is_among(rotations: Rotations, others: Rotations) -> Flags:
    """Tell which of rotations (n, 3, 3) are among others."""
    nearest = (rotations.reshape(-1, 9) @ others.reshape(-1, 9).T).argmax(axis=1)
    return np.asarray(np.linalg.norm(rotations - others[nearest], axis=(1, 2)) <= _SAME)


def _refuse_look_alikes(toml: ObjectToml, mesh: Mesh, parts: tuple[Part, ...], ids: tuple[int, ...]) -> None:
    """Refuse parts of one colour that some rotation may carry onto each other: images are compared part by part."""
    for place, first in enumerate(ids):
        for second in ids[place + 1 :]:
            one, other = parts[first - BODY_ID], parts[second - BODY_ID]
            if one.colour == other.colour and np.allclose(
                _invariants(mesh.triangles_of(first)), _invariants(mesh.triangles_of(second)), rtol=0, atol=_ALIKE
            ):
                raise toml.fault(
                    f"part.{second - BODY_ID}.name",
                    f"{other.name!r} looks like {one.name!r}: they have one size, one shape and one colour, and the "
                    "ball can be turned so that one comes to lie where the other was. Give them different colours",
                )


def _invariants(triangles: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return what no rotation changes of triangles (T, 3, 3): area, the centroid's distance, principal moments."""
    area, centroid, moments = moments_of(triangles)
    return np.array([area, np.linalg.norm(centroid), *np.linalg.eigvalsh(moments)])
