"""The instances of one object in the scenes of a BOP dataset: their pictures, cameras and poses.

SPLIT/SCENE/scene_gt.json          poses per image, in a list
SPLIT/SCENE/scene_gt_info.json     how much of each is visible, in the same order; may be missing
SPLIT/SCENE/scene_camera.json      cam_K per image
SPLIT/SCENE/rgb/IMAGE.png          or gray, or .jpg
"""

import contextlib
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from symsol_annot.bop.reading.json_files import (
    JsonFile,
    check_inside,
    is_there,
    number,
    numbers,
    read_table,
    shown,
    typed,
    whole_id,
)
from symsol_annot.errors import DataError, SettingsError, first_of
from symsol_annot.rotations.so3 import Rotations, nearest_rotations, rotation_deviation

MAX_OFF_SO3 = 1e-3  # of a pose in the file; the nearest rotation is taken
_SCENE = re.compile(r"[0-9]{1,6}")
_PICTURES = tuple((folder, ending) for folder in ("rgb", "gray") for ending in ("png", "jpg", "jpeg"))
_LEAST_FOCAL_PX, _MOST_FOCAL_PX = 1.0, 1e7
_SHOWN_IDS = 12


@dataclass(frozen=True, eq=False)
class Instance:
    """An object in a picture.

    Attributes:
        scene_id: of its scene.
        im_id: of its picture, within the scene.
        gt_id: its place in the picture's list of poses, from 0.
        picture: the file.
        K: (3, 3) the camera's matrix; the centre of the first pixel is (0, 0).
        R_m2c: (3, 3) its rotation, the nearest one to what the file says.
        t_m2c_mm: (3,) its translation.
        off_so3: how far the file's matrix is from a rotation.
    """

    scene_id: int
    im_id: int
    gt_id: int
    picture: Path
    K: npt.NDArray[np.float64]
    R_m2c: Rotations
    t_m2c_mm: npt.NDArray[np.float64]
    off_so3: float

    @property
    def name(self) -> str:
        """What an error message calls it."""
        return f"scene {self.scene_id}, image {self.im_id}, instance {self.gt_id}"


@dataclass(frozen=True, eq=False)
class Found:
    """All of a split that shows an object.

    Attributes:
        instances: those that are visible enough, by scene, picture and place in the list.
        hidden: how many others there are.
        files: the JSON files that say so.
    """

    instances: tuple[Instance, ...]
    hidden: int
    files: tuple[JsonFile, ...]


def read_instances(root: Path, split: str, obj_id: int, least_visible: float) -> Found:
    """Read the instances of an object in all scenes of a split.

    Args:
        root: the dataset's folder.
        split: the name of a folder in it, like "test".
        obj_id: the object's id.
        least_visible: the least visib_fract of an instance that counts; all do in a scene without scene_gt_info.json.

    Raises:
        DataError: a file is missing or broken, or leads out of the dataset.
        SettingsError: the split has no instance of the object that is visible enough.
    """
    folder = root / split
    seen: set[int] = set()
    instances: list[Instance] = []
    files: list[JsonFile] = []
    hidden = 0
    for scene in _scenes(root, folder):
        found = _Scene(root, scene, obj_id, least_visible)
        seen |= found.obj_ids
        if obj_id in found.obj_ids:
            instances += found.instances()
            hidden += found.hidden
            files += found.files
    if not instances:
        if obj_id in seen:
            raise SettingsError(
                f"{folder}: object {obj_id} is in {hidden} images, visible by less than {least_visible:g} in each; "
                "--least-visible takes a smaller part"
            )
        others = first_of([str(other) for other in sorted(seen)], _SHOWN_IDS) or "none"
        raise SettingsError(f"{folder}: no scene has object {obj_id}; there are: {others}")
    return Found(tuple(instances), hidden, tuple(files))


def _scenes(root: Path, folder: Path) -> list[Path]:
    check_inside(root, folder)
    try:
        scenes = [path for path in folder.iterdir() if _SCENE.fullmatch(path.name) and path.is_dir()]
    except OSError as error:
        raise DataError(f"{folder}: {_missing(root, error)}") from None
    if not scenes:
        raise DataError(f"{folder}: has no scenes; expected folders like 000001 with scene_gt.json and rgb in them")
    for scene in scenes:
        check_inside(root, scene)
    return sorted(scenes, key=lambda path: (int(path.name), path.name))


def _missing(root: Path, error: OSError) -> str:
    words = error.strerror
    if isinstance(error, FileNotFoundError):
        words = "no such folder"
        with contextlib.suppress(OSError):
            there = sorted(path.name for path in root.iterdir() if path.is_dir())
            return f"{words}; {root} has {first_of(there, _SHOWN_IDS) or 'no folders'}"
    return f"{words}; expected a folder of scenes in the folder of a BOP dataset"


class _Scene:
    """One scene: which objects are in it, and the instances of one."""

    def __init__(self, root: Path, folder: Path, obj_id: int, least_visible: float) -> None:
        self._root, self._folder, self._obj_id, self._least_visible = root, folder, obj_id, least_visible
        self._gt = read_table(root, folder / "scene_gt.json", "the poses of each image")
        self.files = [self._gt]
        self.hidden = 0
        self._poses = dict(sorted(self._by_image()))
        self.obj_ids = {ids for of_image in self._ids.values() for ids in of_image}

    def _by_image(self) -> Iterator[tuple[int, list[dict[str, Any]]]]:
        self._ids: dict[int, list[int]] = {}
        for key in self._gt.table:
            im_id = whole_id(key, f"{self._gt.path}: image")
            poses = typed(self._gt.table, key, list, str(self._gt.path))
            if im_id in self._ids:
                raise DataError(f"{self._gt.path}: has image {im_id} twice")
            name = f"{self._gt.path}: image {im_id}"
            self._ids[im_id] = [whole_id(_value(pose, "obj_id", name), f"{name}: obj_id") for pose in poses]
            yield im_id, poses

    def instances(self) -> Iterator[Instance]:
        """Yield the instances that are visible enough, and count the others."""
        cameras = self._read("scene_camera.json", "the camera of each image")
        path = self._folder / "scene_gt_info.json"
        info = self._read(path.name, "how visible each pose is") if is_there(path) else None
        for im_id, poses in self._poses.items():
            chosen = [gt_id for gt_id, found in enumerate(self._ids[im_id]) if found == self._obj_id]
            visible = [gt_id for gt_id in chosen if self._is_visible(info, im_id, gt_id, len(poses))]
            self.hidden += len(chosen) - len(visible)
            if visible:
                K, picture = self._camera(cameras, im_id), self._picture(im_id)
                yield from (self._instance(im_id, gt_id, poses[gt_id], K, picture) for gt_id in visible)

    def _read(self, name: str, what: str) -> JsonFile:
        self.files.append(read_table(self._root, self._folder / name, what))
        return self.files[-1]

    def _is_visible(self, info: JsonFile | None, im_id: int, gt_id: int, poses: int) -> bool:
        if info is None:
            return True
        name = f"{info.path}: image {im_id}"
        listed = typed(info.table, _key(info, im_id), list, str(info.path))
        if len(listed) != poses:
            raise DataError(f"{name}: expected {poses} entries, one per pose of scene_gt.json, found {len(listed)}")
        visible = number(_value(listed[gt_id], "visib_fract", name), f"{name}: visib_fract")
        return visible >= self._least_visible

    def _camera(self, cameras: JsonFile, im_id: int) -> npt.NDArray[np.float64]:
        name = f"{cameras.path}: image {im_id}"
        entry = typed(cameras.table, _key(cameras, im_id), dict, str(cameras.path))
        K = numbers(typed(entry, "cam_K", list, name), 9, f"{name}: cam_K").reshape(3, 3)
        focal_px = K[[0, 1], [0, 1]]
        is_pinhole = np.array_equal(K[2], (0, 0, 1)) and K[1, 0] == 0
        if not (is_pinhole and focal_px.min() >= _LEAST_FOCAL_PX and focal_px.max() <= _MOST_FOCAL_PX):
            raise DataError(
                f"{name}: cam_K: expected fx, s, cx, 0, fy, cy, 0, 0, 1 with fx and fy of {_LEAST_FOCAL_PX:g} to "
                f"{_MOST_FOCAL_PX:g} pixels, found {', '.join(f'{value:g}' for value in K.ravel())}"
            )
        return K

    def _picture(self, im_id: int) -> Path:
        for folder, ending in _PICTURES:
            path = self._folder / folder / f"{im_id:06d}.{ending}"
            if is_there(path):
                check_inside(self._root, path)
                return path
        raise DataError(
            f"{self._folder}: image {im_id} is missing: expected rgb/{im_id:06d}.png, or in gray, or as .jpg; "
            "other kinds of pictures are not read"
        )

    def _instance(
        self, im_id: int, gt_id: int, pose: dict[str, Any], K: npt.NDArray[np.float64], picture: Path
    ) -> Instance:
        name = f"{self._gt.path}: image {im_id}, instance {gt_id}"
        R = numbers(typed(pose, "cam_R_m2c", list, name), 9, f"{name}: cam_R_m2c").reshape(3, 3)
        off = float(rotation_deviation(R))
        if not off <= MAX_OFF_SO3:
            raise DataError(f"{name}: cam_R_m2c: is no rotation: off by {off:.3g} (allowed {MAX_OFF_SO3:g})")
        t_mm = numbers(typed(pose, "cam_t_m2c", list, name), 3, f"{name}: cam_t_m2c")
        return Instance(int(self._folder.name), im_id, gt_id, picture, K, nearest_rotations(R), t_mm, off)


def _key(file: JsonFile, im_id: int) -> str:
    """Return the key of an image, which may have leading zeros."""
    key = next((key for key in (str(im_id), f"{im_id:06d}") if key in file.table), None)
    if key is None:
        raise DataError(f"{file.path}: has no image {im_id}, of which scene_gt.json has poses")
    return key


def _value(entry: Any, key: str, what: str) -> Any:
    if not isinstance(entry, dict) or key not in entry:
        raise DataError(f"{what}: expected tables with {key}, found {shown(entry)}")
    return entry[key]
