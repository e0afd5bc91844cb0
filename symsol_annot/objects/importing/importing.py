"""From a mesh file to an object: read, mended, its symmetries found, its parts told apart, placed, and written down."""

import hashlib
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from symsol_annot.errors import ObjectError
from symsol_annot.objects.finding.find import DEFAULT_TOLERANCE
from symsol_annot.objects.finding.found import CertifiedGroup, Group, Symmetries
from symsol_annot.objects.finding.remainders.balls import ball_limit, ball_of
from symsol_annot.objects.finding.report import rounded_up
from symsol_annot.objects.finding.surface import Surface, make_surface
from symsol_annot.objects.finding.symmetries import find_symmetries
from symsol_annot.objects.importing.object_writing import ObjectDraft
from symsol_annot.objects.importing.parting import WHOLE, Parting, body_index, parted
from symsol_annot.objects.importing.placing import alike_joined, placed, steps_of_circle
from symsol_annot.objects.importing.repairs import Soup, mend, used_vertices
from symsol_annot.objects.importing.shells import closed_shells
from symsol_annot.objects.importing.solids import sort_out
from symsol_annot.objects.mesh_files.mesh_file import MeshFile
from symsol_annot.objects.mesh_files.reading import read_mesh_file
from symsol_annot.objects.obj_file import MAX_TRIANGLES
from symsol_annot.objects.parts import MAX_PARTS
from symsol_annot.rotations.groups import ALL_ROTATIONS
from symsol_annot.rotations.so3 import Rotations

Indices = npt.NDArray[np.intp]
Flags = npt.NDArray[np.bool_]

MOST_ROUND_WITHIN = 0.018  # radii: max_offset is a tenth more, and at most 0.02


@dataclass(frozen=True)
class ImportOptions:
    """What a user may say about an import.

    Attributes:
        parts: what tells the parts, one of PARTS_CHOICES.
        body: the name of the part that is the body; None for the largest.
        tolerance: how far a symmetry may carry a point from the surface, in radii.
        round_within: how far from round a body of facets may be, in radii, to count as round; None: as it is, unless
            it is a ball as far as anybody sees.
    """

    parts: str = "auto"
    body: str | None = None
    tolerance: float = DEFAULT_TOLERANCE
    round_within: float | None = None


@dataclass(frozen=True, eq=False)
class ImportedObject:
    """A mesh file as an object.

    Attributes:
        draft: the object, to be written.
        found: the symmetries of its body, in the file's unit and frame.
        notes: what was done to the mesh, in words.
        centre: (3,) the point of the file that became the origin.
        frame: (3, 3) its columns are the object's axes in the file.
        scale: how many of the file's units are one of the object's.
    """

    draft: ObjectDraft
    found: Symmetries
    notes: tuple[str, ...]
    centre: npt.NDArray[np.float64]
    frame: Rotations
    scale: float


@dataclass(frozen=True, eq=False)
class _Claim:
    """What an object declares of its symmetry.

    Attributes:
        shape: the group, its fixed point and its frame in the file.
        of_body: whether the body has it by itself.
        max_offset: how far the group may carry the body off itself, in radii; 0 where it is exact.
        steps: by how many a circle is stated; None for the usual.
    """

    shape: CertifiedGroup
    of_body: bool
    max_offset: float
    steps: int | None = None


def import_mesh(path: Path, name: str, options: ImportOptions) -> ImportedObject:
    """Return the object that a mesh file describes.

    Args:
        path: of the file.
        name: of the object.
        options: what the user says about it.

    Raises:
        ObjectError: it is no closed mesh of one object, or what tells its parts does not; the message says what to do.
        MissingExtraError: trimesh is not installed, and the file is no OBJ.
    """
    file, data = read_mesh_file(path, MAX_TRIANGLES)
    parting = parted(file, options.parts, path)
    try:
        return _imported(file, parting, name, path, hashlib.sha256(data).hexdigest(), options)
    except ObjectError as error:
        if str(error).startswith(str(path)):
            raise
        raise ObjectError(f"{path}: {error}") from None


def _imported(
    file: MeshFile, parting: Parting, name: str, path: Path, sha256: str, options: ImportOptions
) -> ImportedObject:
    soup = mend(Soup(file.vertices, file.triangles, parting.part_of))
    shell_of = sort_out(soup, closed_shells(soup))
    parts = _parts_left(soup, shell_of, parting)
    body, is_body, found = _body(soup, shell_of, parts, options, path)
    if _lacks_components(found, shell_of[is_body]) and options.parts == "auto" and parts.by == "none":
        parts = _parts_left(soup, shell_of, replace(parting, by="component"))
        soup.notes.append(f"components were made parts, since without {found.larger[0].what} more rotations fit")
        body, is_body, found = _body(soup, shell_of, parts, options, path)
    claim = _claim(found, soup.vertices[np.unique(soup.triangles[is_body])])
    soup = used_vertices(soup)
    is_of_body = np.zeros(len(soup.vertices), dtype=bool)
    is_of_body[soup.triangles[is_body]] = True
    place = placed(soup.vertices, is_of_body, claim.shape, options.tolerance)
    notes = list(soup.notes)
    if place.moved:
        notes.append(
            f"vertices were moved by up to {place.moved:.2g} of the radius, so that {claim.shape.group.name} is exact"
        )
    if parts.by in {"component", "node"} and parts.colours is None:
        parts = _alike_joined(place.vertices[soup.triangles], parts, body, claim.shape.group, notes)
    parts = _in_order(parts, body, _areas(soup, parts))
    draft = ObjectDraft(
        name,
        path.name,
        place.vertices,
        soup.triangles,
        parts.part_of,
        parts.names,
        parts.colours,
        claim.of_body,
        claim.shape.group,
        claim.max_offset,
        claim.steps,
        {
            "source": path.name,
            "source_sha256": sha256,
            "file_units_per_unit": place.scale,
            "origin_in_file": claim.shape.centre.tolist(),
            "axes_in_file": claim.shape.group.frame.T.reshape(-1).tolist(),
            "parts_by": parts.by,
            "repairs": notes,
            "group_found": found.shape.group.name,
            "residual": found.shape.residual,
            "tolerance": options.tolerance,
            "not_looked_for": list(found.not_looked_for),
        },
    )
    return ImportedObject(draft, found, tuple(notes), claim.shape.centre, claim.shape.group.frame, place.scale)


def _parts_left(soup: Soup, shell_of: Indices, parting: Parting) -> Parting:
    """Return the parts of the triangles that are left: the components, or those of the file that can be seen."""
    if parting.by != "component":
        left, part_of = np.unique(soup.label_of, return_inverse=True)
        colours = None if parting.colours is None else tuple(parting.colours[part] for part in left)
        return Parting(part_of.reshape(-1), tuple(parting.names[part] for part in left), colours, parting.by)
    count = int(shell_of.max()) + 1
    if count > MAX_PARTS:
        raise ObjectError(
            f"has {count:,} components, an object at most {MAX_PARTS} parts; join those that belong together"
        )
    names = (WHOLE, *(f"component-{number}" for number in range(2, count + 1)))
    components = Parting(shell_of, names, None, "component")
    order = np.argsort(_areas(soup, components), kind="stable")[::-1]
    return Parting(np.argsort(order)[shell_of], names, None, "component")


def _body(
    soup: Soup, shell_of: Indices, parts: Parting, options: ImportOptions, path: Path
) -> tuple[int, Flags, Symmetries]:
    """Return the body's part, which triangles (T,) are on the closed surfaces that it is a part of, and their group."""
    body = body_index(parts.names, _areas(soup, parts), options.body, path)
    is_body = np.isin(shell_of, np.unique(shell_of[parts.part_of == body]))  # with what is painted on it
    triangles = soup.triangles[is_body]
    surface = make_surface(soup.vertices, triangles, np.zeros(len(triangles), dtype=np.intp), (WHOLE,))
    _refuse_coarse_ball(surface, options.round_within)
    return body, is_body, find_symmetries(surface, options.tolerance, round_within=options.round_within)


def _refuse_coarse_ball(surface: Surface, round_within: float | None) -> None:
    """Refuse a ball of facets that are farther off round than is allowed; 0 takes facets as they are.

    Whether its facets are meant, nobody knows but the user, and finding their group takes minutes.
    """
    ball, allowed = ball_of(surface), ball_limit(round_within)
    if ball is None or allowed == 0 or ball.deviation <= allowed:
        return
    needed = rounded_up(ball.deviation)
    is_allowed = needed <= MOST_ROUND_WITHIN
    by_option = f"--round-within {needed:g} takes it for one, " if is_allowed else ""
    raise ObjectError(
        f"the body is too coarse for a ball: its facets are up to {ball.deviation:.2g} of the radius off one, "
        f"{ball.deviation / allowed:.2g} times the {allowed:g} that is allowed; give it finer facets, or import it "
        f"with `symsol-annot import-object`: its option {by_option}--round-within 0 takes its facets as they are"
    )


def _lacks_components(found: Symmetries, shell_of: Indices) -> bool:
    """Tell whether there is a larger group, and what it lacks is whole shells."""
    if not found.larger:
        return False
    taken = np.zeros(len(shell_of), dtype=bool)
    taken[found.larger[0].taken_away] = True
    return not bool(np.isin(shell_of[taken], shell_of[~taken]).any())


def _claim(found: Symmetries, vertices: npt.NDArray[np.float64]) -> _Claim:
    """Return what an object declares: its body's group, or the larger one of the body without some of its faces.

    The larger one is no group of a part by itself, so images are then compared as a whole. A round body of facets may
    be carried off itself by as much as it is off round. In whole images facets tell, so a circle is then stated by
    steps among which are all turns of the facets.

    Args:
        found: of the body.
        vertices: (n, 3) of the body.

    Raises:
        ObjectError: it is a ball but for some faces, which are no part.
    """
    if found.larger:
        one = found.larger[0]
        if one.group.kind == ALL_ROTATIONS:
            raise ObjectError(
                f"the body has {one.group.name}, but for {one.what}: make them a part, a closed surface of its "
                "own that may reach into the ball"
            )
        group = one.as_it_is if one.as_it_is.contains(found.shape.group) else one.group
        steps = steps_of_circle((vertices - one.centre) @ group.frame) if group.is_continuous else None
        shape = replace(found.shape, group=group, centre=one.centre, residual=0.0)
        return _Claim(shape, of_body=False, max_offset=0.0, steps=steps)
    nearly, shape = found.roundness, found.shape
    max_offset = 1.1 * nearly.deviation if nearly is not None and shape.group.is_continuous else 0.0
    return _Claim(shape, of_body=True, max_offset=max_offset)


def _alike_joined(
    corners: npt.NDArray[np.float64], parts: Parting, body: int, group: Group, notes: list[str]
) -> Parting:
    """Return parts of which those that look alike, since a symmetry carries one onto the other, are one."""
    frame = group.frame
    part_of = alike_joined(corners, parts.part_of, body, frame.T @ group.rotations @ frame)
    kept, renumbered = np.unique(part_of, return_inverse=True)
    gone = len(parts.names) - len(kept)
    if gone:
        notes.append(f"{gone} part{'s' if gone > 1 else ''} that a symmetry carries onto others joined with those")
    names = tuple(parts.names[part] for part in kept)
    return Parting(renumbered.reshape(-1), names, None, parts.by)


def _in_order(parts: Parting, body: int, areas: list[float]) -> Parting:
    """Return the parts with the body first, and the others by their area, the largest first."""
    order = sorted(range(len(parts.names)), key=lambda part: (part != body, -areas[part]))
    colours = None if parts.colours is None else tuple(parts.colours[part] for part in order)
    return Parting(np.argsort(order)[parts.part_of], tuple(parts.names[part] for part in order), colours, parts.by)


def _areas(soup: Soup, parts: Parting) -> list[float]:
    a, b, c = np.moveaxis(soup.vertices[soup.triangles], 1, 0)
    doubled = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    return [float(doubled[parts.part_of == part].sum()) for part in range(len(parts.names))]
