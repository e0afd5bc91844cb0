"""Does any part of a marking that shows fix the rotation, as an object.toml of format version 1 says?

It does not if there are a rotation g of the body's group outside of the stabiliser, and a camera, for which marking M
and turned marking gM are alike wherever the camera sees the body, and something of them shows: both rotations then
draw the same picture, though the marking shows in it. Two equal dots a quarter of a turn apart are such a marking.

On a convex body a face is seen where the camera is on its outer side. So for each g the planes of the faces in which M
and gM differ must all be turned away, and one in which they agree must be seen. Cameras are tried all around, at two
distances, and moved to where that is nearly so.
"""

from dataclasses import dataclass
from itertools import chain

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from symsol_annot.errors import ObjectError
from symsol_annot.objects.finding.axes import angles_and_axes
from symsol_annot.objects.finding.surface import Surface
from symsol_annot.objects.mesh import is_convex
from symsol_annot.objects.spec import ObjectSpec
from symsol_annot.objects.surface import SURFACE_TOLERANCE, Points
from symsol_annot.rotations.so3 import Rotations

NOT_CONVEX = ("whether a part of the marking may hide behind another part of a body that is not convex",)
_DISTANCES = (4.0, 1000.0)  # of cameras from the centre, in radii
_CAMERAS = 4000  # all around, two degrees apart
_NEAREST = 6  # of them are moved, in rounds of ever smaller steps
_ROUNDS, _STEPS, _FIRST_STEP = 8, 64, 0.05
_INWARDS = 1e-3  # share of the way from a triangle's corner to its centre, so that a point is inside
_SEEN = 1e-6  # a camera is on the outer side of a face's plane by this much
_MOST_TRIANGLES = 4000  # of a marking, which takes seconds


def refuse_parts_that_fix_no_rotation(spec: ObjectSpec) -> tuple[str, ...]:
    """Refuse an object of format version 1 of whose marking some part that is seen alone fixes less than it declares.

    Args:
        spec: with a marking, whose stabiliser is what it declares.

    Returns:
        What was not looked for, in words.

    Raises:
        ObjectError: there is a camera from which two rotations look alike, though the marking shows.
    """
    if not is_convex(spec.mesh):
        return NOT_CONVEX
    if np.count_nonzero(spec.mesh.is_marking) > _MOST_TRIANGLES:
        return (f"whether any part of a marking of over {_MOST_TRIANGLES:,} triangles fixes the rotation",)
    marking = _Faces(spec)
    cameras = _cameras()
    for g in spec.symmetry_group[spec.cosets[1:, 0]]:
        agreement = marking.agreement(g)
        if agreement is None:
            continue
        camera = _camera_that_sees(agreement, cameras)
        if camera is not None:
            raise ObjectError(_message(spec, g, camera))
    return ()


@dataclass(frozen=True, eq=False)
class _Agreement:
    """Planes of faces, as (n, 4) normals and levels: in which M and gM are alike, and in which they differ."""

    alike: Points
    different: Points


class _Faces:
    """A marking's triangles, and which points are on them."""

    def __init__(self, spec: ObjectSpec) -> None:
        mesh = spec.mesh
        self._triangles = mesh.vertices[mesh.triangles[mesh.is_marking]]
        a, b, c = np.moveaxis(self._triangles, 1, 0)
        normals = np.cross(b - a, c - a)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        self._planes = np.column_stack([normals, np.einsum("ti,ti->t", normals, a)])
        across = np.cross(normals[:, None], np.roll(self._triangles, -1, axis=1) - self._triangles)
        across /= np.linalg.norm(across, axis=-1, keepdims=True)
        levels = np.einsum("tki,tki->tk", across, self._triangles)
        self._inward = np.concatenate([across, levels[..., None]], axis=-1)  # (T, 3, 4) of the edges
        centres = self._triangles.mean(axis=1, keepdims=True)
        corners = self._triangles + _INWARDS * (centres - self._triangles)
        halfway = (corners + np.roll(corners, -1, axis=1)) / 2.0
        self._points = np.concatenate([corners, halfway, centres], axis=1)  # (T, 7, 3)
        self._tree = cKDTree(centres[:, 0])
        self._reach = float(np.linalg.norm(self._triangles - centres, axis=-1).max()) + SURFACE_TOLERANCE
        self._pieces = self._spheres(np.count_nonzero(mesh.is_marking), spec)

    def _spheres(self, count: int, spec: ObjectSpec) -> list[tuple[Points, float]]:
        """Return a sphere around each connected piece: its centre (3,) and its radius."""
        mesh = spec.mesh
        triangles = mesh.triangles[mesh.is_marking]
        part_of = np.zeros(count, dtype=np.intp)
        surface = Surface(mesh.vertices, triangles, part_of, ("marking",), np.arange(count)).without_parts()
        spheres = []
        for piece in range(int(surface.components.max()) + 1):
            corners = self._triangles[surface.components == piece].reshape(-1, 3)
            centre = corners.mean(axis=0)
            spheres.append((centre, float(np.linalg.norm(corners - centre, axis=1).max())))
        return spheres

    def agreement(self, g: Rotations) -> _Agreement | None:
        """Return where the marking and the marking turned by g (3, 3) are alike and differ; None if alike nowhere."""
        if not any(
            np.linalg.norm(g @ one - other) <= r + s + SURFACE_TOLERANCE
            for one, r in self._pieces
            for other, s in self._pieces
        ):
            return None
        turned_here = self._holds(self._points @ g)  # g^-1 x, for x on M: is x on gM?
        here_turned = self._holds(self._points @ g.T)  # g y, for y on M: is gy on M?
        alike = self._planes[turned_here.any(axis=1)]
        if not len(alike):
            return None
        turned = self._planes[~here_turned.all(axis=1)]
        turned = np.column_stack([turned[:, :3] @ g.T, turned[:, 3]])
        return _Agreement(alike, np.concatenate([self._planes[~turned_here.all(axis=1)], turned]))

    def _holds(self, points: Points) -> npt.NDArray[np.bool_]:
        """Tell which of points (T, 7, 3) are on the marking."""
        flat = points.reshape(-1, 3)
        holds = np.zeros(len(flat), dtype=bool)
        near = self._tree.query_ball_point(flat, self._reach)
        point = np.repeat(np.arange(len(flat)), [len(triangles) for triangles in near])
        triangle = np.fromiter(chain.from_iterable(near), dtype=np.intp, count=len(point))
        holds[point[self._are_on(flat[point], triangle)]] = True
        return holds.reshape(points.shape[:2])

    def _are_on(self, points: Points, triangle: npt.NDArray[np.intp]) -> npt.NDArray[np.bool_]:
        """Tell which of points (n, 3) are on the triangles (n,) that are given with each."""
        planes = self._planes[triangle]
        is_level = np.abs(np.einsum("ni,ni->n", points, planes[:, :3]) - planes[:, 3]) <= SURFACE_TOLERANCE
        inward = np.einsum("ni,nki->nk", points, self._inward[triangle, :, :3]) - self._inward[triangle, :, 3]
        return np.asarray(is_level & (inward.min(axis=1) >= -SURFACE_TOLERANCE))


def _cameras() -> Points:
    """Return directions (n, 3) all around."""
    index = np.arange(_CAMERAS) + 0.5
    z, turn = 1 - 2 * index / _CAMERAS, np.pi * (1 + np.sqrt(5)) * index
    return np.column_stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z])


def _camera_that_sees(agreement: _Agreement, directions: Points) -> Points | None:
    """Return a camera (3,) that sees a plane in which the markings are alike, and none in which they differ."""
    rng = np.random.default_rng(0)
    for distance in _DISTANCES:
        tried = directions
        for round_ in range(_ROUNDS):
            fits = _fits(agreement, distance * tried)
            if fits.max() > _SEEN:
                return np.asarray(distance * tried[int(fits.argmax())])
            best = tried[np.argsort(fits)[-_NEAREST:]]
            step = _FIRST_STEP * 0.5**round_
            tried = (best[:, None] + step * rng.normal(size=(len(best), _STEPS, 3))).reshape(-1, 3)
            tried = np.concatenate([best, tried / np.linalg.norm(tried, axis=1, keepdims=True)])
    return None


def _fits(agreement: _Agreement, cameras: Points) -> npt.NDArray[np.float64]:
    """Return how well each camera (n, 3) does: it is on the outer side of a plane alike, and on none that differs."""
    seen = (cameras @ agreement.alike[:, :3].T - agreement.alike[:, 3]).max(axis=1)
    if not len(agreement.different):
        return np.asarray(seen)
    hidden = (agreement.different[:, 3] - cameras @ agreement.different[:, :3].T).min(axis=1)
    return np.asarray(np.where(hidden >= 0, seen, hidden))


def _message(spec: ObjectSpec, g: Rotations, camera: Points) -> str:
    angle, axis = angles_and_axes(g[None])
    along, seen_from = (", ".join(f"{value + 0.0:.3g}" for value in vector) for vector in (axis[0], camera))
    return (
        f"{spec.folder}: marking.any_part_fixes_rotation is not true of {spec.name!r}: a camera at ({seen_from}) "
        f"sees the same part of the marking after a turn by {np.degrees(angle[0]):.4g} degrees about ({along}), which "
        "is not in the stabiliser. Make the marking a [[part]] of an object.toml of format version 2, whose sets "
        "follow from a comparison of images: docs/objects.md shows one"
    )
