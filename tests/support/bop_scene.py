"""A BOP dataset of one scene, drawn by BOP's page alone: an irregular tetrahedron, which no turn maps onto itself.

Its centre is not its origin, it stands off the middle of the pictures, and their camera has a skew.
"""

import io
import json
import struct

import numpy as np
from bop_reader import silhouette
from PIL import Image

VERTICES_MM = np.array([[-30, -20, -10], [60, -10, 0], [0, 50, 5], [10, 5, 70]], dtype=float)
TRIANGLES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
K = np.array([[750.0, 9.0, 210.0], [0.0, 660.0, 198.0], [0.0, 0.0, 1.0]])
SHAPE = (360, 480)
PAPER, INK = 230, 40
POSES = [  # quaternions, scalar first, and translations in mm
    ((0.9, 0.1, -0.3, 0.2), (70.0, -55.0, 420.0)),
    ((0.2, 0.7, 0.4, -0.5), (-35.0, 40.0, 450.0)),
    ((-0.3, 0.4, 0.8, 0.3), (80.0, 60.0, 600.0)),
]


def rotation(quat_wxyz):
    """A rotation by the formula R x = x + 2 w (q x x) + 2 q x (q x x), column by column."""
    w, *q = np.array(quat_wxyz) / np.linalg.norm(quat_wxyz)
    columns = [e + 2 * w * np.cross(q, e) + 2 * np.cross(q, np.cross(q, e)) for e in np.eye(3)]
    return np.stack(columns, axis=1)


def drawn(R, t, K, shape):
    """The object's silhouette in ink on paper, (H, W) u8."""
    return np.where(silhouette(VERTICES_MM, TRIANGLES, K, R, np.asarray(t), shape), INK, PAPER).astype(np.uint8)


def binary_ply():
    lines = ["ply", "format binary_little_endian 1.0", "element vertex 4", "property uchar red", "property float x"]
    lines += ["property float y", "property float z", "element face 4", "property list uchar int vertex_indices"]
    body = b"".join(struct.pack("<B3f", 9, *vertex) for vertex in VERTICES_MM)
    body += b"".join(struct.pack("<B3i", 3, *triangle) for triangle in TRIANGLES)
    return "\n".join([*lines, "end_header", ""]).encode() + body


def encoded(pixels, kind="PNG"):
    data = io.BytesIO()
    Image.fromarray(pixels).save(data, kind, quality=95)
    return data.getvalue()


def write_json(path, table):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(table))


def changed(path, change):
    """Change what a JSON file holds, in place."""
    table = json.loads(path.read_text())
    change(table)
    write_json(path, table)


def write_dataset(root, obj_id=5):
    """Write the dataset; each picture shows the object once, and another one, 7, that nobody has drawn."""
    size = np.ptp(VERTICES_MM, axis=0)
    info = {"diameter": float(max(np.linalg.norm(a - b) for a in VERTICES_MM for b in VERTICES_MM))}
    info |= {f"min_{axis}": float(value) for axis, value in zip("xyz", VERTICES_MM.min(axis=0), strict=True)}
    info |= {f"size_{axis}": float(value) for axis, value in zip("xyz", size, strict=True)}
    write_json(root / "models/models_info.json", {str(obj_id): info})
    (root / "models" / f"obj_{obj_id:06d}.ply").write_bytes(binary_ply())
    scene = root / "test/000003"
    (scene / "rgb").mkdir(parents=True)
    gt, gt_info, cameras = {}, {}, {}
    for im_id, (quat_wxyz, t) in enumerate(POSES):
        R = rotation(quat_wxyz)
        pose = {"cam_R_m2c": R.ravel().tolist(), "cam_t_m2c": list(t), "obj_id": obj_id}
        gt[im_id] = [{**pose, "obj_id": 7}, pose]
        gt_info[im_id] = [{"visib_fract": 1.0}, {"visib_fract": 0.3 + 0.3 * im_id}]
        cameras[im_id] = {"cam_K": K.ravel().tolist(), "depth_scale": 1.0}
        (scene / "rgb" / f"{im_id:06d}.png").write_bytes(encoded(np.stack(3 * [drawn(R, t, K, SHAPE)], axis=-1)))
    for name, table in (("gt", gt), ("gt_info", gt_info), ("camera", cameras)):
        write_json(scene / f"scene_{name}.json", table)
    return root
