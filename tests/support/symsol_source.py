"""Zips of the original SYMSOL's layout, with its quirks, and what its sets should be: formulae that share no code with
the importer.

Quirks: a circle of 360 angles from 0 to 2 pi counts its end again; labels are float32, so that they are off SO(3) and
the end is off the start; a marked object lists its own rotation alone; a body stands as its maker liked.
"""

import io
import zipfile

import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

SIZE = 16
COUNTS = {"train": 20, "test": 6}
STANDS = Rotation.from_euler("xyz", [0.3, -0.2, np.pi / 4]).as_matrix()  # the tetrahedron's own frame


def circle(steps, *, has_end):
    """Turns about z; with the end, the identity is there twice."""
    angles = np.linspace(0.0, 2 * np.pi, steps, endpoint=has_end)
    return Rotation.from_rotvec(np.outer(angles, [0, 0, 1])).as_matrix()


def with_flips(turns):
    """Each turn, then the same after a half turn about x, in turns."""
    flip = np.diag([1.0, -1.0, -1.0])
    return np.stack([turns, turns @ flip], axis=1).reshape(-1, 3, 3)


def symmetries(name):
    """What the source multiplies a rotation with."""
    if name == "tet":
        return STANDS @ Rotation.create_group("T").as_matrix() @ STANDS.T
    if name == "cone":
        return circle(360, has_end=True)
    if name == "cyl":
        return with_flips(circle(360, has_end=True))
    return np.eye(3)[None]


def rotations(name, count, rng, dtype="f4"):
    """(n, m, 3, 3) R g, g in the source's order, the first R itself."""
    R = Rotation.random(count, random_state=rng).as_matrix()
    group = symmetries(name)
    first = int(np.argmin(np.abs(group - np.eye(3)).max(axis=(1, 2))))
    group = np.concatenate([group[first:], group[:first]])
    return (R[:, None] @ group[None]).astype(dtype)


def png(pixels):
    data = io.BytesIO()
    Image.fromarray(pixels).save(data, format="PNG")
    return data.getvalue()


def npz(tables):
    data = io.BytesIO()
    np.savez(data, **tables)
    return data.getvalue()


def content(names, seed=0, counts=COUNTS, dtype="f4"):
    """Name to bytes of all files of a zip, and name to array of what they say."""
    rng = np.random.default_rng(seed)
    files, arrays = {}, {}
    for split, count in counts.items():
        tables = {name: rotations(name, count, rng, dtype) for name in names}
        files[f"{split}/rotations.npz"] = npz(tables)
        for name in names:
            arrays[name, split] = tables[name]
            images = rng.integers(0, 256, size=(count, SIZE, SIZE, 3), dtype=np.uint8)
            arrays[name, split, "images"] = images
            for index, pixels in enumerate(images):
                files[f"{split}/images/{name}_{index:05d}.png"] = png(pixels)
    return files, arrays


def write_zip(path, files, compression=zipfile.ZIP_DEFLATED):
    with zipfile.ZipFile(path, "w", compression) as file:
        for name, data in files.items():
            file.writestr(name, data)
    return path
