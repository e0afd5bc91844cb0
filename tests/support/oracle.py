"""A ray caster for the built-in objects, written from docs/conventions.md alone.

It shares no code and no mesh with the package: bodies are intersections of half-spaces, markings are formulas.
A wrong frame, hand, camera, facet or disc on either side makes the two disagree.
"""

import numpy as np

GOLDEN = (1 + 5**0.5) / 2
CYLINDER_RADIUS = 1 / (1 + 1.15**2) ** 0.5
CYLINDER_TOP = 1.15 * CYLINDER_RADIUS
CONE_BASE_Z = -0.6
DISC_RADIUS, DISC_Z = 0.2 * CYLINDER_RADIUS, 0.55
CAMERA_DISTANCE, FILLED = 4.0, 0.9
RAYS_AT_ONCE = 8192


def half_spaces(name):
    """The body as {x : normals @ x <= offsets}."""
    if name in ("tet", "tetX"):
        corners = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / 3**0.5
        return -corners, np.full(4, 1 / 3)
    if name == "cube":
        return np.concatenate([np.eye(3), -np.eye(3)]), np.full(6, 1 / 3**0.5)
    if name == "icosa":
        cubic = [[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
        rectangle = [[x / GOLDEN, 0, z * GOLDEN] for x in (-1, 1) for z in (-1, 1)]
        normals = np.array(cubic + [np.roll(v, k).tolist() for v in rectangle for k in range(3)]) / 3**0.5
        vertex = np.array([0, 1, GOLDEN]) / np.hypot(1, GOLDEN)
        return normals, np.full(20, (normals @ vertex).max())
    facets = np.radians(np.arange(360) + 0.5)
    outward = np.stack([np.cos(facets), np.sin(facets), np.zeros(360)], axis=1)
    up = np.array([0.0, 0.0, 1.0])
    if name in ("cyl", "cylO"):
        apothem = CYLINDER_RADIUS * np.cos(np.radians(0.5))
        return np.concatenate([outward, [up, -up]]), np.array([apothem] * 360 + [CYLINDER_TOP] * 2)
    if name == "cone":
        apothem, height = (1 - CONE_BASE_Z**2) ** 0.5 * np.cos(np.radians(0.5)), 1 - CONE_BASE_Z
        side = (outward * height + up * apothem) / np.hypot(height, apothem)
        return np.concatenate([side, [-up]]), np.array([side[0] @ up] * 360 + [-CONE_BASE_Z])
    raise KeyError(name)


def on_marking(name, points, faces):
    """Which hits (model coordinates, and the half-space that was hit) lie on the marking."""
    if name == "tetX":
        return faces == 0  # the face opposite the corner (1, 1, 1)
    if name != "cylO":
        return np.zeros(len(points), dtype=bool)
    steps = np.where(faces < 180, faces, faces - 360)  # facet k spans k to k + 1 degrees; the disc is at 0
    middle = np.radians(steps + 0.5)
    across = -np.sin(middle) * points[:, 0] + np.cos(middle) * points[:, 1]  # from the facet's middle line
    width = 2 * CYLINDER_RADIUS * np.sin(np.radians(0.5))
    return (faces < 360) & (np.hypot((steps + 0.5) * width + across, points[:, 2] - DISC_Z) < DISC_RADIUS)


def cast(name, R_m2c, size=224):
    """The ids (0 background, 1 body, 2 marking) at the pixels' centres: (size, size)."""
    return _cast_at(name, R_m2c, size, np.arange(size) + 0.5)


def cast_samples(name, R_m2c, size=224, samples_per_axis=2):
    """The ids at the samples of the RGB, from the image's corner on, n a pixel: (n size + 1, n size + 1)."""
    return _cast_at(name, R_m2c, size, np.arange(samples_per_axis * size + 1) / samples_per_axis)


def _cast_at(name, R_m2c, size, places):
    focal = FILLED / 2 * size / np.tan(np.arcsin(1 / CAMERA_DISTANCE))
    x, y = np.meshgrid((places - size / 2) / focal, (places - size / 2) / focal)
    directions = np.stack([x, y, np.ones_like(x)], axis=-1).reshape(-1, 3)
    ids = np.concatenate(
        [_cast_rays(name, R_m2c, directions[i : i + RAYS_AT_ONCE]) for i in range(0, len(directions), RAYS_AT_ONCE)]
    )
    return ids.reshape(x.shape)


def _cast_rays(name, R_m2c, directions_c):
    normals, offsets = half_spaces(name)
    origin = R_m2c.T @ np.array([0, 0, -CAMERA_DISTANCE])  # the camera, in model coordinates
    directions = directions_c @ R_m2c  # row vectors: R^T applied to each
    speed = directions @ normals.T
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (offsets - normals @ origin) / speed
    entering = np.where(speed < 0, t, -np.inf)
    faces, enter = entering.argmax(axis=1), entering.max(axis=1)
    leave = np.where(speed > 0, t, np.inf).min(axis=1)
    hit = enter < leave
    points = origin + enter[:, None] * directions
    return np.where(hit, 1 + on_marking(name, points, faces), 0).astype(np.uint8)


def boundary(ids):
    """Samples whose 3x3 neighbourhood holds more than one id: where a rasteriser may round the other way."""
    padded = np.pad(ids, 1, mode="edge")
    shifted = [padded[i : i + ids.shape[0], j : j + ids.shape[1]] for i in range(3) for j in range(3)]
    return np.max(shifted, axis=0) != np.min(shifted, axis=0)


def fray_deg(circle):
    """Return how many steps beyond its longest run of members a circle (360,) still has members; 0 for an arc."""
    if circle.all() or not circle.any():
        return 0
    starts = np.flatnonzero(circle & ~np.roll(circle, 1))
    lengths = [int(np.argmin(np.roll(circle, -start))) for start in starts]
    length = max(lengths)
    turned = np.roll(circle, -starts[np.argmax(lengths)])  # begins with the longest run
    beyond = np.flatnonzero(turned)[length:]
    return int(np.minimum(beyond - (length - 1), 360 - beyond).max(initial=0))
