"""What a gallery's files say, read without its page, and a renderer in numpy for what is drawn again."""

import base64
import json
import re

import numpy as np
from bench_sets import DiscRenderer
from numpy_renderer import NumpyRenderer
from scipy.spatial.transform import Rotation

from symsol_annot.gallery.redrawn import Redrawer


def documents(path):
    """What a script delivers: key to document."""
    text = path.read_text(encoding="ascii")
    assert re.fullmatch(r"SYMSOL\.deliver\(.*\);\n", text)
    key, document = json.loads(f"[{text[len('SYMSOL.deliver(') : -3]}]")
    return key, document


def array(document):
    return np.frombuffer(base64.b64decode(document["data"]), dtype=f"<{document['dtype']}")


def rotations(document):
    quat_wxyz = array(document).reshape(-1, 4).astype(float)
    return Rotation.from_quat(quat_wxyz[:, [1, 2, 3, 0]]).as_matrix() if len(quat_wxyz) else np.zeros((0, 3, 3))


def angles(a, b):
    return np.degrees(np.linalg.norm(Rotation.from_matrix(a @ np.swapaxes(b, -1, -2)).as_rotvec(), axis=-1))


def numpy_redrawer(source, runs, count=2):
    def open_renderer(spec, camera, settings):
        return DiscRenderer(camera.width) if spec.name == "cylO" else NumpyRenderer(spec.name, camera.width)

    return Redrawer(source, runs, count, open_renderer=open_renderer)


def set_of(index, name, split="test"):
    return next(one for one in index["sets"] if (one["object"], one["split"]) == (name, split))


def run_of(index, track, name="tetX"):
    found = enumerate(index["runs"])
    return next((n, run) for n, run in found if run["track"] == track and index["sets"][run["set"]]["object"] == name)


def refuse(error):
    def open_renderer(spec, camera, settings):
        raise error

    return open_renderer


def everything(folder):
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
