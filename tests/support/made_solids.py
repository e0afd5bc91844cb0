"""Solids whose symmetry groups are known by construction, and changes that leave the group: turns, cuts, noise.

A solid is (vertices (V, 3), triangles (T, 3)); a group is named as `Group.name` has it.
"""

from itertools import pairwise, product

import numpy as np
from scipy.spatial import ConvexHull

from symsol_annot.objects.finding.surface import make_surface

PHI = (1 + 5**0.5) / 2


def ring(corners, radius, z, phase=0.0):
    turns = 2 * np.pi * (np.arange(corners) + phase) / corners
    return np.column_stack([radius * np.cos(turns), radius * np.sin(turns), np.full(corners, z)])


def hull_of(points):
    """The convex hull as a closed mesh, wound outwards."""
    points = np.asarray(points, dtype=float)
    hull = ConvexHull(points)
    triangles = hull.simplices.copy()
    a, b, c = (points[triangles[:, k]] for k in range(3))
    inwards = np.einsum("ti,ti->t", np.cross(b - a, c - a), hull.equations[:, :3]) < 0
    triangles[inwards] = triangles[inwards][:, ::-1]
    return points, triangles.astype(np.intp)


def prism(corners, height=1.3):
    return hull_of(np.concatenate([ring(corners, 1.0, z) for z in (-height / 2, height / 2)]))


def pyramid(corners, height=1.7):
    return hull_of(np.concatenate([ring(corners, 1.0, 0.0), [[0, 0, height]]]))


def antiprism(corners, height=0.8):
    return hull_of(np.concatenate([ring(corners, 1.0, 0.0), ring(corners, 1.0, height, 0.5)]))


def frustum(corners):
    return hull_of(np.concatenate([ring(corners, 1.0, 0.0), ring(corners, 0.6, 0.9)]))


def bipyramid(corners, height=1.5):
    return hull_of(np.concatenate([ring(corners, 1.0, 0.0), [[0, 0, height], [0, 0, -height]]]))


def twisted_prism(corners):
    """A prism whose top is turned a little: no half turns of a prism stay but those between its edges."""
    return hull_of(np.concatenate([ring(corners, 1.0, 0.0), ring(corners, 1.0, 0.9, 0.2)]))


def box(*sizes):
    return hull_of([[x, y, z] for x in (0, sizes[0]) for y in (0, sizes[1]) for z in (0, sizes[2])])


def tetrahedron():
    return hull_of([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])


def truncated_tetrahedron():
    return hull_of(
        [
            np.roll(np.array([3, 1, 1]) * s, k)
            for k in range(3)
            for s in ([1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1])
        ]
    )


def octahedron():
    return hull_of(np.concatenate([np.eye(3), -np.eye(3)]))


def cuboctahedron():
    return hull_of([np.roll([0, y, z], k) for k in range(3) for y in (-1, 1) for z in (-1, 1)])


def snub_cube():
    """A solid with all turns of the cube and no reflection."""
    t = 1.8392867552141612
    points = []
    for shift in range(3):
        for signs in np.array(np.meshgrid(*3 * [[-1, 1]])).reshape(3, -1).T:
            even = np.roll([1, 1 / t, t], shift)
            odd = np.roll([1, t, 1 / t], shift)
            points.append(signs * (even if signs.prod() > 0 else odd))
    return hull_of(points)


def icosahedron():
    return hull_of([np.roll([0, y, z * PHI], k) for k in range(3) for y in (-1, 1) for z in (-1, 1)])


def dodecahedron():
    corners = [[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    return hull_of(
        corners + [np.roll([0, y / PHI, z * PHI], k).tolist() for k in range(3) for y in (-1, 1) for z in (-1, 1)]
    )


def pyritohedron():
    """A cube whose faces are cut along one direction each: the turns of a tetrahedron, and no more."""
    corners = [[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    return hull_of(
        corners + [np.roll([0, 0.5 * y, 1.4 * z], k).tolist() for k in range(3) for y in (-1, 1) for z in (-1, 1)]
    )


def lathe(profile, facets):
    """A body of revolution, from the axis (r = 0) at the bottom to the axis at the top, or round to its start."""
    vertices, rows = [], []
    for r, z in profile:
        rows.append(np.full(facets, len(vertices)) if r == 0 else len(vertices) + np.arange(facets))
        vertices += [[0.0, 0.0, z]] if r == 0 else ring(facets, r, z).tolist()
    if profile[0][0] != 0:
        rows.append(rows[0])
    triangles = []
    for low, high in pairwise(rows):
        for k in range(facets):
            a, b, c, d = low[k], low[(k + 1) % facets], high[(k + 1) % facets], high[k]
            triangles += [t for t in ((a, b, c), (a, c, d)) if len(set(t)) == 3]
    return np.array(vertices), np.array(triangles, dtype=np.intp)


CUP = [(0, -1), (0.7, -1), (0.7, 1), (0.6, 1), (0.6, -0.85), (0, -0.85)]
CAN = [(0, -1), (0.6, -1), (0.6, 1), (0, 1)]
BOTTLE = [(0, -1), (0.5, -1), (0.5, 0.2), (0.2, 0.6), (0.2, 1), (0, 1)]
SPINDLE = [(0, -1), (0.3, -0.9), (0.5, 0), (0.3, 0.9), (0, 1)]
WASHER = [(0.5, -0.1), (1.0, -0.1), (1.0, 0.1), (0.5, 0.1)]


def torus(facets, sides):
    turns = 2 * np.pi * np.arange(sides) / sides
    return lathe([(1 + 0.3 * np.cos(t), 0.3 * np.sin(t)) for t in turns], facets)


def joined(*solids):
    """Solids side by side or within each other, each a closed shell."""
    vertices, triangles, offset = [], [], 0
    for points, faces in solids:
        vertices.append(points)
        triangles.append(faces + offset)
        offset += len(points)
    return np.concatenate(vertices), np.concatenate(triangles)


def moved(solid, by):
    return solid[0] + np.asarray(by, dtype=float), solid[1]


def zipped(lower, upper, offset_lower, offset_upper):
    """Triangles between two closed rings of other counts, that start at the same angle."""
    triangles, i, j = [], 0, 0
    while i < lower or j < upper:
        a, b = offset_lower + i % lower, offset_upper + j % upper
        if j == upper or (i < lower and (i + 1) / lower <= (j + 1) / upper):
            triangles.append((a, offset_lower + (i + 1) % lower, b))
            i += 1
        else:
            triangles.append((a, offset_upper + (j + 1) % upper, b))
            j += 1
    return triangles


def stacked(rings, bottom=True, top=True):
    """A closed surface through rings (corners, radius, z) about z; fans close its ends, or they are joined."""
    vertices, offsets, triangles = [], [], []
    for corners, radius, z in rings:
        offsets.append(sum(map(len, vertices)))
        vertices.append(ring(corners, radius, z))
    steps = list(range(len(rings) - 1)) + ([] if bottom else [-1])
    for k in steps:
        (n, _, _), (m, _, _) = rings[k], rings[(k + 1) % len(rings)]
        triangles += zipped(n, m, offsets[k], offsets[(k + 1) % len(rings)])
    count = sum(map(len, vertices))
    if bottom:
        vertices.append([[0.0, 0.0, rings[0][2]]])
        triangles += [(count, offsets[0] + (k + 1) % rings[0][0], offsets[0] + k) for k in range(rings[0][0])]
        count += 1
    if top:
        vertices.append([[0.0, 0.0, rings[-1][2]]])
        n = rings[-1][0]
        triangles += [(count, offsets[-1] + k, offsets[-1] + (k + 1) % n) for k in range(n)]
    return np.concatenate(vertices), np.array(triangles, dtype=np.intp)


def nut(hole=60):
    return stacked([(6, 0.9, -0.3), (6, 0.9, 0.3), (hole, 0.45, 0.3), (hole, 0.45, -0.3)], bottom=False, top=False)


def bolt(facets=90):
    """A hexagonal head on a round shank."""
    return stacked([(6, 0.7, -1.0), (6, 0.7, -0.5), (facets, 0.3, -0.5), (facets, 0.3, 1.0)])


def socket_screw(facets=360):
    """A round head with a hexagonal socket, and a shank, in one shell."""
    rings = [
        (facets, 0.35, -1.2),
        (facets, 0.35, 0.2),
        (facets, 0.6, 0.2),
        (facets, 0.6, 0.9),
        (6, 0.3, 0.9),
        (6, 0.3, 0.5),
    ]
    return stacked(rings)


def mug(facets=360, width=6):
    """A can in one shell with a block that grows out of its side."""
    vertices, triangles = lathe([(0, -1), (0.7, -1), (0.7, -0.4), (0.7, 0.4), (0.7, 1), (0, 1)], facets)
    start = 1 + facets  # of the ring at z = -0.4
    low, high = start + np.arange(width + 1), start + facets + np.arange(width + 1)
    is_block = np.isin(triangles, [*low, *high]).all(axis=1)
    out = {corner: len(vertices) + place for place, corner in enumerate([*low, *high])}
    raised = vertices[[*low, *high]] * [1.4, 1.4, 0.8]
    border = [*low, *high[::-1]]
    sides = []
    for a, b in zip(border, border[1:] + border[:1], strict=True):
        sides += [(a, b, out[b]), (a, out[b], out[a])]
    lifted = np.vectorize(out.get)(triangles[is_block])
    return np.concatenate([vertices, raised]), np.concatenate([triangles[~is_block], np.array(sides), lifted]).astype(
        np.intp
    )


def raised_cube(height):
    """A cube of one surface whose top has a square bump in its middle, or a dent where the height is negative."""
    points, triangles = [], []

    def face(*corners):
        triangles.extend(
            [[len(points), len(points) + 1, len(points) + 2], [len(points), len(points) + 2, len(points) + 3]]
        )
        points.extend(corners)

    for axis, side in ((0, -1), (0, 1), (1, -1), (1, 1), (2, -1)):
        normal = side * np.eye(3)[axis]
        u = np.roll(normal, 1)
        v = np.cross(normal, u)
        face(normal - u - v, normal + u - v, normal + u + v, normal - u + v)
    marks = [-1.0, -0.3, 0.3, 1.0]
    for (i, (x, right)), (j, (y, back)) in product(enumerate(pairwise(marks)), repeat=2):
        z = 1.0 + height * (i == j == 1)
        face((x, y, z), (right, y, z), (right, back, z), (x, back, z))
    around = [(-0.3, -0.3), (0.3, -0.3), (0.3, 0.3), (-0.3, 0.3)]
    for start, end in zip(around, around[1:] + around[:1], strict=True):
        face((*start, 1.0), (*end, 1.0), (*end, 1.0 + height), (*start, 1.0 + height))
    welded, place = np.unique(np.array(points).round(9), axis=0, return_inverse=True)
    return welded, place.reshape(-1)[np.array(triangles)].astype(np.intp)


def cut_box(height, depth=0.3):
    """A box of 2 x 2 x 2 height with a corner cut off."""
    corners = [[x, y, height * z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1) if (x, y, z) != (1, 1, 1)]
    return hull_of([*corners, [1 - depth, 1, height], [1, 1 - depth, height], [1, 1, height - depth]])


def two_shell_mug(facets=360):
    """A cup, and a ring that reaches into its wall: two closed shells."""
    points, faces = torus(40, 16)
    handle = points[:, [0, 2, 1]] * 0.4 + [0.75, 0, 0], faces[:, ::-1]
    return joined(lathe(CUP, facets), handle)


SOLIDS = {
    **{f"prism {n}": (prism(n), f"D{n}") for n in (3, 5, 6, 7, 8, 12, 17)},
    **{f"pyramid {n}": (pyramid(n), f"C{n}") for n in (3, 4, 5, 6, 9, 24)},
    **{f"antiprism {n}": (antiprism(n), f"D{n}") for n in (4, 5, 6, 7)},
    **{f"frustum {n}": (frustum(n), f"C{n}") for n in (3, 4, 6, 11)},
    **{f"bipyramid {n}": (bipyramid(n), f"D{n}") for n in (3, 5, 6, 10)},
    **{f"twisted prism {n}": (twisted_prism(n), f"D{n}") for n in (3, 4, 5)},
    "box": (box(1, 2, 3), "D2"),
    "square bar": (box(1, 1, 3), "D4"),
    "cube": (box(1, 1, 1), "O"),
    "wedge": (hull_of([[0, 0, 0], [2, 0, 0], [0, 1, 0], [2, 1, 0], [0, 0, 1], [0, 1, 1]]), "C1"),
    "roof": (hull_of([[-1, -2, 0], [1, -2, 0], [-1, 2, 0], [1, 2, 0], [0, -2, 1], [0, 2, 1]]), "C2"),
    "odd corner": (hull_of([[0, 0, 0], [1, 0, 0], [0, 1.3, 0], [0, 0, 1.7], [0.4, 0.5, 1.2]]), "C1"),
    "tetrahedron": (tetrahedron(), "T"),
    "truncated tetrahedron": (truncated_tetrahedron(), "T"),
    "pyritohedron": (pyritohedron(), "T"),
    "octahedron": (octahedron(), "O"),
    "cuboctahedron": (cuboctahedron(), "O"),
    "snub cube": (snub_cube(), "O"),
    "icosahedron": (icosahedron(), "I"),
    "dodecahedron": (dodecahedron(), "I"),
    "cup 64": (lathe(CUP, 64), "C64"),
    "cup 360": (lathe(CUP, 360), "C360"),
    "can 64": (lathe(CAN, 64), "D64"),
    "can 360": (lathe(CAN, 360), "D360"),
    "bottle 48": (lathe(BOTTLE, 48), "C48"),
    "spindle 36": (lathe(SPINDLE, 36), "D36"),
    "washer 90": (lathe(WASHER, 90), "D90"),
    "torus 40": (torus(40, 16), "D40"),
    "nut": (nut(), "D6"),
    "nut, hole of 45": (nut(45), "D3"),
    "bolt": (bolt(), "C6"),
    "screw with a socket": (socket_screw(), "C6"),
    "screw of 64 facets with a socket": (socket_screw(64), "C2"),
    "mug in one shell": (mug(), "C2"),
    "mug in two shells": (two_shell_mug(), "C1"),
    "cube with a bump": (raised_cube(0.2), "C4"),
    "cube with a dent": (raised_cube(-0.2), "C4"),
    "cube without a corner": (cut_box(1.0), "C3"),
    "bar without a corner": (cut_box(2.0), "C1"),
    "two boxes": (joined(box(1, 1, 1), moved(box(1, 1, 1), [2, 0, 0])), "D4"),
    "two odd boxes": (joined(box(1, 1, 1), moved(box(1, 1, 1.2), [2, 0, 0])), "C1"),
    "dumb-bell": (joined(moved(icosahedron(), [0, 0, -2.5]), moved(lathe(CAN, 5), [0, 0, 0])), "C1"),
}


def turned(solid, R, by=(0.0, 0.0, 0.0), scale=1.0):
    return scale * (solid[0] @ np.asarray(R).T) + np.asarray(by, dtype=float), solid[1]


def remeshed(solid, rng, parts=0.5):
    """The same surface, cut otherwise: a part of the triangles at a point inside, and a part of the edges."""
    vertices, triangles = solid
    edges = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    chosen = {
        tuple(edge) for edge in np.unique(edges, axis=0)[rng.random(len(np.unique(edges, axis=0))) < parts].tolist()
    }
    points, middles, out = vertices.tolist(), {}, []
    for edge in sorted(chosen):
        middles[edge] = len(points)
        share = rng.uniform(0.3, 0.7)
        points.append(((1 - share) * vertices[edge[0]] + share * vertices[edge[1]]).tolist())
    for triangle in triangles.tolist():
        border = []
        for a, b in zip(triangle, triangle[1:] + triangle[:1], strict=True):
            border.append(a)
            if (min(a, b), max(a, b)) in middles:
                border.append(middles[min(a, b), max(a, b)])
        if len(border) == 3 and rng.random() > parts:
            out.append(triangle)
            continue
        points.append((vertices[triangle] * rng.dirichlet(np.full(3, 5.0))[:, None]).sum(axis=0).tolist())
        out += [(a, b, len(points) - 1) for a, b in zip(border, border[1:] + border[:1], strict=True)]
    return np.array(points), np.array(out, dtype=np.intp)


def noisy(solid, amplitude, rng):
    """Each vertex moved by up to an amplitude, as a part of the size."""
    vertices, triangles = solid
    size = np.linalg.norm(vertices - vertices.mean(axis=0), axis=1).max()
    step = rng.normal(size=vertices.shape)
    step *= rng.random((len(vertices), 1)) / np.linalg.norm(step, axis=1, keepdims=True)
    return vertices + amplitude * size * step, triangles


def surface_of(solid, part_of=None, names=("body",)):
    vertices, triangles = solid
    return make_surface(vertices, triangles, np.zeros(len(triangles), dtype=int) if part_of is None else part_of, names)
