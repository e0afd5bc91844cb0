"""A split as BOP's scenes: pictures and masks as PNG, and JSON with poses, cameras and symmetry sets.

BOP's camera is ours, OpenCV's, but for its pixels: there the centre of the first one is (0, 0), here (0.5, 0.5).
"""

import json
import math
from collections.abc import Callable, Iterator
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from symsol_annot.bop.numbering import scene_and_image
from symsol_annot.rendering.camera import Camera
from symsol_annot.sets.dataset import Dataset, Sample
from symsol_annot.system.png import to_png

SYMMETRY_SETS_NAME = "scene_gt_symmetries.json"
_MOST_DEPTH = 65535  # in a PNG of 16 bits
_VISIBLE = 255  # in a mask


def write_scenes(
    folder: Path,
    dataset: Dataset,
    camera: Camera,
    radius_mm: float,
    obj_id: int,
    first_scene: int,
    on_image: Callable[[], object] = lambda: None,
) -> list[dict[str, int]]:
    """Write a split's scenes.

    Args:
        folder: of the scenes, like `test`.
        dataset: the images, a split or the first ones of it.
        camera: of the set.
        radius_mm: how many millimetres the object's bounding sphere has for a radius.
        obj_id: the object's id.
        first_scene: the id of the first scene.
        on_image: called after each image.

    Returns:
        The images as BOP's targets: scene_id, im_id, obj_id, inst_count.

    Raises:
        DataError: a shard is damaged.
        OSError: a file cannot be written.
    """
    targets = []
    for scene_id, indices in groupby(range(len(dataset)), key=lambda index: scene_and_image(first_scene, index)[0]):
        scene = _Scene(folder / f"{scene_id:06d}", camera, radius_mm, obj_id, has_depth=dataset.has_depth)
        for index in indices:
            im_id = scene_and_image(first_scene, index)[1]
            scene.add(im_id, dataset[index])
            targets.append({"im_id": im_id, "inst_count": 1, "obj_id": obj_id, "scene_id": scene_id})
            on_image()
        scene.finish()
    return targets


def intrinsics(camera: Camera) -> dict[str, float]:
    """Return a camera's fx, fy, cx, cy in pixels, by BOP's convention: (0, 0) is the centre of the first pixel."""
    focal_px = float(camera.focal_px)
    return {"fx": focal_px, "fy": focal_px, "cx": camera.width / 2 - 0.5, "cy": camera.height / 2 - 0.5}


def depth_scale(camera: Camera, radius_mm: float) -> float:
    """Return how many millimetres a unit of depth images is: the least power of ten with which they fit 16 bits."""
    return float(10.0 ** math.ceil(math.log10((camera.distance + 1.0) * radius_mm / _MOST_DEPTH)))


def to_json(entries: Any) -> bytes:
    """Return JSON as BOP's files have it: an entry per line."""
    if isinstance(entries, dict):
        lines = [f"  {json.dumps(str(key))}: {json.dumps(value)}" for key, value in entries.items()]
        return ("{\n" + ",\n".join(lines) + "\n}\n").encode("ascii")
    return ("[\n" + ",\n".join(f"  {json.dumps(value)}" for value in entries) + "\n]\n").encode("ascii")


class _Scene:
    """One scene on its way into a folder."""

    def __init__(self, folder: Path, camera: Camera, radius_mm: float, obj_id: int, *, has_depth: bool) -> None:
        self._folder, self._obj_id, self._radius_mm = folder, obj_id, radius_mm
        self._scale = depth_scale(camera, radius_mm)
        self._translation_mm = [0.0, 0.0, camera.distance * radius_mm]
        of = intrinsics(camera)
        self._camera = {
            "cam_K": [of["fx"], 0.0, of["cx"], 0.0, of["fy"], of["cy"], 0.0, 0.0, 1.0],
            "depth_scale": self._scale,
        }
        self._files: dict[str, dict[int, Any]] = {
            "scene_camera.json": {},
            "scene_gt.json": {},
            "scene_gt_info.json": {},
        }
        for name in ("rgb", "mask", "mask_visib", *(["depth"] if has_depth else [])):
            (folder / name).mkdir(parents=True)

    def add(self, im_id: int, sample: Sample) -> None:
        """Write an image's pictures, and remember its labels."""
        segmentation = (
            np.zeros(sample.image.shape[:2], np.uint8) if sample.segmentation is None else sample.segmentation
        )
        is_object = segmentation > 0
        for name, pixels in self._pictures(im_id, sample, is_object):
            (self._folder / name).write_bytes(to_png(pixels))
        pose = {"cam_R_m2c": sample.rotation.ravel().tolist(), "cam_t_m2c": self._translation_mm}
        self._files["scene_camera.json"][im_id] = self._camera
        self._files["scene_gt.json"][im_id] = [{**pose, "obj_id": self._obj_id}]
        self._files["scene_gt_info.json"][im_id] = [_visibility(is_object, sample.depth)]
        if sample.symmetry_mask is not None:
            members = np.flatnonzero(sample.symmetry_mask).tolist()
            self._files.setdefault(SYMMETRY_SETS_NAME, {})[im_id] = [{"obj_id": self._obj_id, "symmetries": members}]

    def finish(self) -> None:
        """Write the scene's JSON."""
        for name, entries in self._files.items():
            (self._folder / name).write_bytes(to_json(entries))

    def _pictures(
        self, im_id: int, sample: Sample, is_object: npt.NDArray[np.bool_]
    ) -> Iterator[tuple[str, npt.NDArray[Any]]]:
        yield f"rgb/{im_id:06d}.png", sample.image
        for name in ("mask", "mask_visib"):  # nothing stands before the object
            yield f"{name}/{im_id:06d}_000000.png", (_VISIBLE * is_object).astype(np.uint8)
        if sample.depth is not None:
            steps = np.rint(sample.depth.astype(np.float64) * (self._radius_mm / self._scale))
            yield f"depth/{im_id:06d}.png", steps.astype(np.uint16)


def _visibility(is_object: npt.NDArray[np.bool_], depth: npt.NDArray[np.float32] | None) -> dict[str, Any]:
    """Return an object's entry of scene_gt_info.json; a box's width is that of its pixels' centres, as BOP has it."""
    rows, columns = np.nonzero(is_object)
    box = [-1, -1, -1, -1]
    if len(rows):
        left, top = int(columns.min()), int(rows.min())
        box = [left, top, int(columns.max()) - left, int(rows.max()) - top]
    valid = 0 if depth is None else int(np.count_nonzero(depth[is_object]))
    return {
        "bbox_obj": box,
        "bbox_visib": box,
        "px_count_all": len(rows),
        "px_count_valid": valid,
        "px_count_visib": len(rows),
        "visib_fract": 1.0 if len(rows) else 0.0,
    }
