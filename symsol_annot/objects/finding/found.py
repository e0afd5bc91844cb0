"""What was found: a group with its frame, and how sure it is."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from symsol_annot.objects.finding.axes import angles_and_axes
from symsol_annot.objects.finding.surface import Indices, Points
from symsol_annot.rotations.groups import ALL_ROTATIONS, CIRCLE_STEPS, GROUP_KINDS, cyclic_group, dihedral_group
from symsol_annot.rotations.so3 import Rotations

CIRCLE, CIRCLE_WITH_HALF_TURNS = "circle", "circle with half turns"
_LETTERS = {"tetrahedral": "T", "octahedral": "O", "icosahedral": "I"}
_PLAIN_NAMES = {CIRCLE: "circle", CIRCLE_WITH_HALF_TURNS: "circle with half turns", ALL_ROTATIONS: "SO(3)"}


@dataclass(frozen=True)
class Axis:
    """An axis of a group.

    Attributes:
        direction: (3,) unit vector in the mesh's frame.
        fold: by how many turns about it the group maps onto itself; None where by all.
    """

    direction: tuple[float, float, float]
    fold: int | None


@dataclass(frozen=True, eq=False)
class Group:
    """A group of rotations about a point.

    Attributes:
        kind: one of `rotations.groups.GROUP_KINDS`, or "circle", "circle with half turns" or "so3".
        order: n of a cyclic or dihedral one; 1 is the trivial group, cyclic. None for all others.
        frame: (3, 3) a rotation F; the group is F g F^T for g of the standard group of its kind, about z.
    """

    kind: str
    order: int | None
    frame: Rotations

    @property
    def is_continuous(self) -> bool:
        """Whether it has more rotations than can be listed."""
        return self.kind in _PLAIN_NAMES

    @property
    def name(self) -> str:
        """In words and letters: C6, D360, T, O, I, circle, circle with half turns, SO(3)."""
        if self.is_continuous:
            return _PLAIN_NAMES[self.kind]
        return _LETTERS.get(self.kind) or f"{'C' if self.kind == 'cyclic' else 'D'}{self.order}"

    @property
    def size(self) -> int | None:
        """The number of rotations; None where it is continuous."""
        return None if self.is_continuous else len(self.rotations)

    @cached_property
    def rotations(self) -> Rotations:
        """The (G, 3, 3) rotations, the identity first; those by whole degrees for a circle, the identity for SO(3)."""
        standard = {
            CIRCLE: lambda: cyclic_group(CIRCLE_STEPS),
            CIRCLE_WITH_HALF_TURNS: lambda: dihedral_group(CIRCLE_STEPS),
            ALL_ROTATIONS: lambda: np.eye(3)[None],
        }
        if self.kind in standard:
            elements = standard[self.kind]()
        else:
            elements = GROUP_KINDS[self.kind].make(**({} if self.order is None else {"order": self.order}))
        return np.asarray(self.frame @ elements @ self.frame.T)

    @cached_property
    def axes(self) -> tuple[Axis, ...]:
        """The axes, those with the most turns first; of a dihedral group the main one and one of the half turns."""
        if self.kind == ALL_ROTATIONS or (self.kind == "cyclic" and self.order == 1):
            return ()
        z, x = _vector(self.frame[:, 2]), _vector(self.frame[:, 0])
        if self.kind == "cyclic":
            return (Axis(z, self.order),)
        if self.kind == "dihedral":
            return Axis(z, self.order), Axis(x, 2)
        if self.is_continuous:
            return (Axis(z, None),) if self.kind == CIRCLE else (Axis(z, None), Axis(x, 2))
        return _axes_of(self.rotations)

    def contains(self, other: "Group", tolerance: float = 1e-3) -> bool:
        """Tell whether every rotation of another group is in this one, up to a Frobenius distance."""
        if self.kind == ALL_ROTATIONS:
            return True
        if other.kind == ALL_ROTATIONS or (other.is_continuous and not self.is_continuous):
            return False
        if self.is_continuous:
            return all(_is_in_circle(R, self.frame[:, 2], self.kind, tolerance) for R in other.rotations[:24])
        largest = (other.rotations.reshape(-1, 9) @ self.rotations.reshape(-1, 9).T).max(axis=1)
        return bool((largest > 3.0 - tolerance**2 / 2 - 1e-9).all())


def trivial_group() -> Group:
    """Return the group of the identity."""
    return Group("cyclic", 1, np.eye(3))


@dataclass(frozen=True, eq=False)
class Failed:
    """The candidate that came nearest to being a symmetry.

    Attributes:
        angle_rad: of its turn.
        axis: (3,) of its turn.
        residual: how far it carries a point of the surface from where it should be, in radii.
    """

    angle_rad: float
    axis: tuple[float, float, float]
    residual: float


@dataclass(frozen=True, eq=False)
class CertifiedGroup:
    """A group of a surface, and how far the surface is from having it.

    Lengths are parts of the radius: the largest distance of the surface from the centre.

    Attributes:
        group: the group.
        centre: (3,) its fixed point, in the mesh's unit and frame.
        residual: the largest distance from the surface that a point was carried to.
        bound: no element carries a point of the triangles that could be bounded farther than this.
        unbounded: how many triangles could not be bounded, so that only points of them were compared.
        failed: the candidate that came nearest; None where there was none.
        candidates: how many were looked at.
    """

    group: Group
    centre: Points
    residual: float
    bound: float
    unbounded: int
    failed: Failed | None
    candidates: int


@dataclass(frozen=True)
class Roundness:
    """How far a surface is from a body of revolution, or from a ball.

    Attributes:
        group: the continuous group that it would have.
        deviation: how far turns carry points from the surface, in radii.
    """

    group: Group
    deviation: float


@dataclass(frozen=True, eq=False)
class LargerGroup:
    """A larger group, of what is left when some faces are taken away.

    Attributes:
        group: of what is left; a continuous one where that is nearly round.
        as_it_is: of what is left to the tolerance, as `group` or a finite subgroup of it.
        centre: (3,) its fixed point, in the mesh's unit and frame.
        taken_away: (k,) indices of the mesh's triangles.
        what: that they are, in words.
        area_left: the share of the area that is left.
        residual: the largest distance that a point of what is left is carried to, where something is left there.
    """

    group: Group
    as_it_is: Group
    centre: Points
    taken_away: Indices
    what: str
    area_left: float
    residual: float


@dataclass(frozen=True, eq=False)
class PartSymmetry:
    """The rotations of the shape's group that map one part onto itself.

    Attributes:
        name: of the part.
        triangles: how many it has.
        stabiliser: the rotations.
        residual: how far a point of the part is carried from it.
    """

    name: str
    triangles: int
    stabiliser: Group
    residual: float


@dataclass(frozen=True, eq=False)
class Symmetries:
    """All that was found about a mesh.

    Attributes:
        shape: the group of the surface, whatever its parts.
        object: the group that maps every part onto itself.
        parts: each part's stabiliser in the group of the shape.
        roundness: how round it is, where it nearly is.
        larger: larger groups of what is left without some faces.
        radius: the largest distance of the surface from the centre, in the mesh's unit.
        tolerance: up to which a candidate counts as a symmetry, in radii; of a ball, how far from round it may be.
        not_looked_for: in words, what may be there and was not looked for.
    """

    shape: CertifiedGroup
    object: Group
    parts: tuple[PartSymmetry, ...]
    roundness: Roundness | None
    larger: tuple[LargerGroup, ...]
    radius: float
    tolerance: float
    not_looked_for: tuple[str, ...]


def _vector(v: npt.NDArray[np.float64]) -> tuple[float, float, float]:
    x, y, z = (float(c) for c in v)
    return x, y, z


def _axes_of(rotations: Rotations) -> tuple[Axis, ...]:
    """Return the axes of a polyhedral group's rotations."""
    _, directions = angles_and_axes(rotations[1:])
    folds: list[tuple[npt.NDArray[np.float64], int]] = []
    is_left = np.ones(len(directions), dtype=bool)
    for index, direction in enumerate(directions):
        if is_left[index]:
            same = np.abs(directions @ direction) > 1 - 1e-6
            is_left &= ~same
            folds.append((direction, int(np.count_nonzero(same)) + 1))
    return tuple(Axis(_vector(direction), fold) for direction, fold in sorted(folds, key=lambda pair: -pair[1]))


def _is_in_circle(R: Rotations, axis: Points, kind: str, tolerance: float) -> bool:
    along = float(axis @ R @ axis)
    return along > 1 - tolerance or (kind == CIRCLE_WITH_HALF_TURNS and along < -1 + tolerance)
