"""A certificate that sphereX's symmetry sets lack no rotation; exits 1 where it finds one.

python tools/prove_spherex.py data/sphereX [--minutes 60] --rows rows.jsonl [--json FILE]

Branch and bound over SO(3). A cube of rotation vectors around v, of the half-diagonal r, holds rotations that are at
most r from R = exp(v). A point p of the ball that shows the label l in the image lies at R^T p in the model; where the
model's nearest point of that label is farther than r from there, no rotation of the cube draws the image, and the cube
is done with. Cubes that are left are cut into eight, down to a half-diagonal of --leaf degrees. What is left is held
against the turns that keep in place what the image shows, members or not, on which the rule decides.

It is done with two kinds of points. With the image's own samples no rotation that is discarded draws the same pixels.
They cannot tell all apart: a part of which a sample or two show is drawn by rotations far away, too, with a sliver of
another shape. So of the cubes that are farther than BESIDE half-diagonals from all turns, up to MOST_DRAWN per image
are drawn at their middles, and those with the same samples are counted. With points of the continuous limit (on both
sides of the parts' outlines, where they face the camera, and along the ball's rim) all the other cubes are to be
discarded by the bound: a rotation farther than that from all turns that is left makes the command exit with 1.

Labels are those of the ball that the mesh stands for. Of images that show something, the hardest --hard (the least
samples of a part that shows) are taken first, then others in their order.
"""

import argparse
import json
import sys
import time
from functools import cache
from pathlib import Path

import numpy as np
from symsol_annot_assets.ball import DISC_RADIUS_RAD, X_HALF_WIDTH, X_REACH, disc_axis, is_in_x

from symsol_annot import load
from symsol_annot.annotation.symmetry_set import SymmetrySet
from symsol_annot.objects.spec import load_object
from symsol_annot.rotations.so3 import quat_wxyz_to_rotation

BODY, X, DISC = 1, 2, 3
CUBE_MAP = 1200  # texels along a side of the map of distances
TEXEL_RAD = 1.5 / CUBE_MAP  # that a point is from its texel's middle, at most, and a little more
BESIDE = 10  # half-diagonals, 3 degrees: what one sample of a part cannot tell from a candidate
DEEPEST_RAD = np.radians(0.01)  # half-diagonal to which cubes beside all candidates are cut in the limit
ROUNDING_RAD = 1e-6  # of an arccosine near 1, and more
STEP_RAD, ASIDE_RAD = np.radians(0.1), np.radians(0.01)  # between points of an outline, and of them from it
WITNESSES, AT_A_TIME, CUBES_AT_ONCE, MOST_CUBES = 120, 10, 4096, 300_000
POINTS_AT_ONCE, GROWTH, DRAWN_AT_ONCE, MOST_DRAWN = 100, 1.2, 1024, 4000
CORNERS = np.array([[a, b, c] for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)], float)


def main():
    """Search image by image, and print and keep the counts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="a set of sphereX")
    parser.add_argument("--split", default="test")
    parser.add_argument("--images", type=int, default=200)
    parser.add_argument("--hard", type=int, default=20)
    parser.add_argument("--leaf", type=float, default=0.6, help="degrees")
    parser.add_argument("--minutes", type=float, help="stop after so long; the same command goes on")
    parser.add_argument("--rows", type=Path, required=True, help="one line of JSON per image; none is done again")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    end = time.monotonic() + (float("inf") if arguments.minutes is None else 60 * arguments.minutes)
    dataset = load(arguments.folder, arguments.split)
    done = {row["image"]: row for row in rows_of(arguments.rows)}
    chosen = hardest_and_first(dataset, arguments.hard, arguments.images)
    for kind, index in chosen:
        if index not in done and time.monotonic() < end:
            done[index] = row = {"kind": kind, **search(dataset, index, np.radians(arguments.leaf))}
            with arguments.rows.open("a") as file:
                file.write(json.dumps(row) + "\n")
            print(row, flush=True)
    found = summary([{**done[index], "kind": kind} for kind, index in chosen if index in done], arguments.leaf)
    print(json.dumps(found, indent=1))
    if arguments.json:
        arguments.json.write_text(json.dumps(found, indent=1) + "\n")
    sys.exit(1 if found["images_with_cubes_beside_all_candidates_in_the_limit"] else 0)


def rows_of(path):
    """Return what is known already."""
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def hardest_and_first(dataset, hard, count):
    """Return kinds and indices of images that show something: those with the least of a part, then the others."""
    parts_px = dataset.labels().part_pixels[:, 1:]
    least = np.where(parts_px > 0, parts_px, np.inf).min(axis=1)
    order = np.argsort(least, kind="stable")[:hard].tolist()
    shown = [index for index in np.flatnonzero(parts_px.max(axis=1) > 0).tolist() if index not in order]
    return [("hard", index) for index in order] + [("other", index) for index in shown[: max(0, count - len(order))]]


@cache
def sphere_x():
    """Return the object."""
    return load_object("sphereX")


def label_of(points):
    """Return the label of points (..., 3) of the unit sphere, in the model's frame."""
    flat = points.reshape(-1, 3)
    labels = np.where(flat @ disc_axis() >= np.cos(DISC_RADIUS_RAD), DISC, np.where(is_in_x(flat), X, BODY))
    return labels.reshape(points.shape[:-1])


def to_outline_of_x(points):
    """Return the distance in rad of points (n, 3) of the unit sphere to the X's outline.

    It consists of arcs of circles about the x and the y axis. From a point the nearest of such a circle is at its own
    angle about that axis, and of an arc at the angle next to that.
    """
    nearest = np.full(len(points), np.inf)
    x, y, z = points.T
    for across, along in ((x, y), (y, -x), (-x, -y), (-y, x)):  # the arm along each of the four ways
        for height, low, high, axis, aside in (
            (X_HALF_WIDTH, X_HALF_WIDTH, X_REACH, along, across),
            (-X_HALF_WIDTH, X_HALF_WIDTH, X_REACH, along, across),
            (X_REACH, -X_HALF_WIDTH, X_HALF_WIDTH, across, along),
        ):
            radius = np.sqrt(1.0 - height**2)
            turn = np.clip(np.arctan2(aside, z), np.arcsin(low / radius), np.arcsin(high / radius))
            cosine = axis * height + radius * (aside * np.sin(turn) + z * np.cos(turn))
            np.minimum(nearest, np.arccos(np.clip(cosine, -1.0, 1.0)), out=nearest)
    return nearest


@cache
def distances():
    """Return lower bounds in rad of the distance from each texel to each label: (3 texels,) f4, BODY's first."""
    middle = (np.arange(CUBE_MAP) + 0.5) / CUBE_MAP * 2 - 1
    u, v = np.meshgrid(middle, middle)
    faces = []
    for side in range(6):
        point = np.empty((CUBE_MAP, CUBE_MAP, 3))
        axis = side // 2
        point[..., axis], point[..., (axis + 1) % 3], point[..., (axis + 2) % 3] = 1 - 2 * (side % 2), u, v
        faces.append(point / np.linalg.norm(point, axis=-1, keepdims=True))
    points = np.stack(faces).reshape(-1, 3)
    labels, to_x = label_of(points), to_outline_of_x(points)
    to_disc = np.abs(np.arccos(np.clip(points @ disc_axis(), -1.0, 1.0)) - DISC_RADIUS_RAD)
    found = [
        np.where(labels == BODY, 0.0, np.where(labels == X, to_x, to_disc)),
        np.where(labels == X, 0.0, to_x),
        np.where(labels == DISC, 0.0, to_disc),
    ]
    return np.maximum(np.stack(found) - ROUNDING_RAD, 0.0).astype(np.float32).ravel()


def texels(points):
    """Return the texel of points (..., 3)."""
    size = np.abs(points)
    axis = size.argmax(axis=-1)[..., None]
    most = np.take_along_axis(points, axis, axis=-1)
    u, v = (np.take_along_axis(points, (axis + k) % 3, axis=-1) / np.abs(most) for k in (1, 2))
    column, row = (np.clip(((w + 1) / 2 * CUBE_MAP).astype(np.int32), 0, CUBE_MAP - 1)[..., 0] for w in (u, v))
    return ((2 * axis + (most < 0))[..., 0] * CUBE_MAP + row) * CUBE_MAP + column


@cache
def points_of(camera, samples):
    """Return the points (n, 3) of the unit sphere, in camera coordinates, that rays through an image's samples meet."""
    lattice = camera.lattice(samples)
    u, v = np.meshgrid(np.arange(lattice.width) + 0.5, np.arange(lattice.height) + 0.5)
    slopes = np.stack([u - lattice.width / 2, v - lattice.height / 2], axis=-1).reshape(-1, 2) / lattice.focal_px
    rays = np.column_stack([slopes, np.ones(len(slopes))])
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    along = camera.distance * rays[:, 2]
    inside = along**2 - camera.distance**2 + 1.0
    rays, depth = rays[inside >= 0], (along - np.sqrt(np.maximum(inside, 0.0)))[inside >= 0]
    return depth[:, None] * rays - [0.0, 0.0, camera.distance]


@cache
def beside_outlines():
    """Return points (n, 3) of the unit sphere, in the model's frame, on both sides of the outlines of X and disc."""
    along = np.linspace(X_HALF_WIDTH, X_REACH, int((X_REACH - X_HALF_WIDTH) / STEP_RAD) + 2)
    across = np.linspace(-X_HALF_WIDTH, X_HALF_WIDTH, int(2 * X_HALF_WIDTH / STEP_RAD) + 2)
    ends = [np.column_stack([np.full(len(across), X_REACH + off), across]) for off in (-ASIDE_RAD, ASIDE_RAD)]
    sides = [
        np.column_stack([along, np.full(len(along), side * (X_HALF_WIDTH + off))])
        for side in (-1, 1)
        for off in (-ASIDE_RAD, ASIDE_RAD)
    ]
    arm = np.concatenate(ends + sides)
    xy = np.concatenate([arm, -arm, arm[:, ::-1], -arm[:, ::-1]])
    of_x = np.column_stack([xy, np.sqrt(1.0 - (xy**2).sum(axis=1))])
    axis = disc_axis()
    aside = np.cross(axis, [0.0, 0.0, 1.0])
    aside /= np.linalg.norm(aside)
    turn = np.arange(0.0, 2 * np.pi, STEP_RAD / np.sin(DISC_RADIUS_RAD))[:, None]
    circle = np.cos(turn) * aside + np.sin(turn) * np.cross(axis, aside)
    of_disc = [
        np.cos(r) * axis + np.sin(r) * circle for r in (DISC_RADIUS_RAD - ASIDE_RAD, DISC_RADIUS_RAD + ASIDE_RAD)
    ]
    return np.concatenate([of_x, *of_disc])


def points_in_the_limit(camera, R):
    """Return points (n, 3) of the unit sphere, in camera coordinates: beside outlines in sight, and at its rim."""
    horizon = -1.0 / camera.distance - ROUNDING_RAD  # the camera looks along z
    outlines = beside_outlines() @ R.T
    turn = np.arange(0.0, 2 * np.pi, STEP_RAD)
    radius = np.sqrt(1.0 - horizon**2)
    rim = np.column_stack([radius * np.cos(turn), radius * np.sin(turn), np.full(len(turn), horizon)])
    rng = np.random.default_rng(0)
    return np.concatenate([rng.permutation(outlines[outlines[:, 2] < horizon]), rng.permutation(rim)])


def witnesses(points, labels, R):
    """Return the numbers of points to be asked first, and of those around the parts, which are asked last."""
    rng = np.random.default_rng(0)
    marks, body = np.flatnonzero(labels != BODY), np.flatnonzero(labels == BODY)
    field = distances().reshape(3, -1)[1:, texels(points[body] @ R)].min(axis=0)
    near = body[np.argsort(field, kind="stable")[: max(200, 3 * len(marks))]]
    few = [(marks, WITNESSES // 2), (near, WITNESSES // 4), (body, WITNESSES // 4)]
    return np.concatenate([rng.permutation(some)[:count] for some, count in few]), np.concatenate(
        [rng.permutation(marks)[:600], rng.permutation(near)[:600]]
    )


def search(dataset, index, leaf_rad):
    """Return what is found of one image."""
    start, settings = time.monotonic(), dataset.manifest.rendered
    sample = dataset[index]
    R_gt, points = sample.rotation, points_of(settings.camera, settings.render.samples_per_axis)
    labels = label_of(points @ R_gt)
    first, last = witnesses(points, labels, R_gt)
    half = np.pi / 4
    middle = (np.arange(4) + 0.5) * 2 * half - np.pi
    cubes, nodes = np.stack(np.meshgrid(middle, middle, middle), axis=-1).reshape(-1, 3), 0
    while True:
        radius = np.sqrt(3.0) * half
        cubes = cubes[np.linalg.norm(cubes, axis=1) - radius <= np.pi]
        nodes += len(cubes)
        cubes = left_of(left_of(cubes, points[first], labels[first], radius), points[last], labels[last], radius)
        if radius <= leaf_rad or not len(cubes) or len(cubes) > MOST_CUBES:
            break
        half /= 2
        cubes = (cubes[:, None] + half * CORNERS).reshape(-1, 3)
    keeps = sphere_x().kept_by_turns[sample.part_pixels[1:] > 0].all(axis=0)
    candidates = SymmetrySet(R_gt, sample.symmetry_group, keeps)
    R = rotations_of(cubes)
    off = candidates.distance_to_arcs(R)
    limit = search_in_the_limit(cubes, radius, points_in_the_limit(settings.camera, R_gt), candidates)

    beyond = off > BESIDE * radius
    tried = np.flatnonzero(beyond)[np.argsort(-off[beyond])]
    tried = tried[:: max(1, -(-len(tried) // MOST_DRAWN))]  # evenly by distance, the farthest among them
    same = tried[draw_the_image(R[tried], points, labels)]
    return {
        "image": index,
        "x_px": float(sample.part_pixels[1]),
        "disc_px": float(sample.part_pixels[2]),
        "members": len(sample.symmetry_set.members),
        "nodes": nodes,
        "half_diagonal_deg": round(float(np.degrees(radius)), 3),
        "cubes_left": len(cubes),
        "farthest_from_a_candidate_deg": farthest_deg(off),
        "cubes_beside_all_candidates": int(beyond.sum()),
        "of_these_drawn": len(tried),
        "of_these_drawn_the_same": len(same),
        "farthest_drawn_the_same_deg": farthest_deg(off[same]),
        **{f"{name}_in_the_limit": value for name, value in limit.items()},
        "seconds": round(time.monotonic() - start, 1),
    }


def search_in_the_limit(cubes, radius, points, candidates):
    """Return what is left of cubes of a half-diagonal, those beside all candidates (R_gt first) cut further."""
    labels, beside_rad = label_of(points @ candidates[0]), BESIDE * radius
    cubes = left_of(cubes, points, labels, radius)
    off = candidates.distance_to_arcs(rotations_of(cubes))
    farthest = off[off <= beside_rad]
    while (off > beside_rad).any() and radius > DEEPEST_RAD:
        cubes, radius = cubes[off > beside_rad], radius / 2
        cubes = (cubes[:, None] + radius / np.sqrt(3.0) * CORNERS).reshape(-1, 3)
        cubes = left_of(cubes, points, labels, radius)
        off = candidates.distance_to_arcs(rotations_of(cubes))
        farthest = np.append(farthest, off[off <= beside_rad])
    return {
        "cubes_beside_all_candidates": int((off > beside_rad).sum()),
        "farthest_from_a_candidate_deg": farthest_deg(np.append(farthest, off)),
        "half_diagonal_deg": round(float(np.degrees(radius)), 3),
    }


def farthest_deg(distances_rad):
    """Return the largest distance, or 0 of none."""
    return round(float(np.degrees(distances_rad.max(initial=0.0))), 2)


def draw_the_image(R, points, labels):
    """Return the numbers of the rotations (n, 3, 3) that give all points their labels.

    Points of parts are asked first, then those nearest to some of these, then those at the ball's rim.
    """
    marks = np.flatnonzero(labels != BODY)
    some_marks = np.random.default_rng(0).permutation(marks)[: WITNESSES // 2]
    nearness = (points @ points[some_marks].T).max(axis=1)
    nearness[marks] = np.inf
    first = np.argsort(-nearness, kind="stable")[: len(marks) + POINTS_AT_ONCE]
    by_rim = np.argsort(-points[:, 2], kind="stable")
    order = np.concatenate([first, by_rim[~np.isin(by_rim, first)]])
    alive = np.arange(len(R))
    ends = np.minimum(np.cumsum(POINTS_AT_ONCE * GROWTH ** np.arange(200)), len(order)).astype(int)
    for some in np.split(order, np.unique(ends)[:-1]):
        parts = [alive[begin : begin + DRAWN_AT_ONCE] for begin in range(0, len(alive), DRAWN_AT_ONCE)]
        turned = (np.einsum("kij,pi->kpj", R[these], points[some]) for these in parts)
        kept = [these[(label_of(p) == labels[some]).all(axis=1)] for these, p in zip(parts, turned, strict=True)]
        alive = np.concatenate(kept) if kept else alive
    return alive


def left_of(cubes, points, labels, radius):
    """Return the cubes (n, 3) of which a rotation may give all points their labels, the first points asked first."""
    field, base = distances(), (labels - 1) * 6 * CUBE_MAP**2
    left = [cubes[:0]]
    for begin in range(0, len(cubes), CUBES_AT_ONCE):
        some = cubes[begin : begin + CUBES_AT_ONCE]
        R, at = rotations_of(some), 0
        while at < len(points) and len(some):
            count = max(AT_A_TIME, CUBES_AT_ONCE * AT_A_TIME // len(some))  # as many questions, whatever is left
            turned = np.einsum("kij,pi->kpj", R, points[at : at + count])
            kept = (field[base[at : at + count] + texels(turned)] <= radius + TEXEL_RAD).all(axis=1)
            some, R, at = some[kept], R[kept], at + count
        left.append(some)
    return np.concatenate(left)


def rotations_of(vectors):
    """Return exp of rotation vectors (n, 3): (n, 3, 3)."""
    angle = np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-12)
    return quat_wxyz_to_rotation(np.concatenate([np.cos(angle / 2), np.sin(angle / 2) * vectors / angle], axis=1))


def summary(rows, leaf):
    """Return the sums over images."""
    kinds = {}
    for row in rows:
        shows = " and ".join(name for name in ("x", "disc") if row[f"{name}_px"] > 0)
        kinds.setdefault(shows, []).append(row)
    return {
        "images": len(rows),
        "leaf_deg": leaf,
        "images_with_cubes_beside_all_candidates": sum(row["cubes_beside_all_candidates"] > 0 for row in rows),
        "images_that_rotations_beside_draw_too": sum(row["of_these_drawn_the_same"] > 0 for row in rows),
        "farthest_of_these_deg": max((row["farthest_drawn_the_same_deg"] for row in rows), default=0.0),
        "images_with_cubes_beside_all_candidates_in_the_limit": sum(
            row["cubes_beside_all_candidates_in_the_limit"] > 0 for row in rows
        ),
        "by_what_shows": {
            shows: {
                "images": len(some),
                "nodes": int(np.median([row["nodes"] for row in some])),
                "seconds": float(np.median([row["seconds"] for row in some])),
                "farthest_from_a_candidate_deg": max(row["farthest_from_a_candidate_deg"] for row in some),
                "farthest_from_a_candidate_deg_in_the_limit": max(
                    row["farthest_from_a_candidate_deg_in_the_limit"] for row in some
                ),
            }
            for shows, some in sorted(kinds.items())
        },
        "rows": rows,
    }


if __name__ == "__main__":
    main()
