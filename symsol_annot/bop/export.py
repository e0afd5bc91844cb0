"""Sets written as a BOP dataset, which the scripts of bop_toolkit read: one object per set, whole or not at all."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeAlias

from symsol_annot.bop.models import model_info, to_ply
from symsol_annot.bop.numbering import FIRST_SCENE, MAX_SCENE_ID, scenes_of
from symsol_annot.bop.scenes import SYMMETRY_SETS_NAME, depth_scale, intrinsics, to_json, write_scenes
from symsol_annot.errors import DataError, OutputError, SettingsError, first_of, output_errors
from symsol_annot.generation.origin import object_behind
from symsol_annot.objects.spec import ObjectSpec
from symsol_annot.rotations.so3 import Rotations
from symsol_annot.sets.dataset import Dataset, load
from symsol_annot.sets.settings import RenderedSettings
from symsol_annot.system.files import new_folder
from symsol_annot.system.locks import held_folder

DEFAULT_RADIUS_MM = 100.0
SYMMETRY_GROUPS_NAME = "symmetry_groups.json"
MODEL_FOLDERS = ("models", "models_eval")  # the toolkit measures errors on the second; both hold the same
_RADII_MM = (1e-3, 1e6)
_LISTED_NAMES = 5

Symmetries: TypeAlias = Literal["object", "body"]


@dataclass(frozen=True)
class BopObject:
    """A set that becomes an object of a BOP dataset.

    Attributes:
        obj_id: its id, from 1.
        first_scene: the id of its first scene.
        dataset: the images, a split or the first ones of it.
        settings: of the set.
        spec: the object that the set was made from.
    """

    obj_id: int
    first_scene: int
    dataset: Dataset
    settings: RenderedSettings
    spec: ObjectSpec


def objects_in(
    folders: Sequence[Path],
    split: str = "test",
    count: int | None = None,
    given: Mapping[str, ObjectSpec] | None = None,
) -> tuple[BopObject, ...]:
    """Open the sets that are to be exported; nothing is written.

    Args:
        folders: of the sets; the first becomes object 1.
        split: "train" or "test".
        count: how many images of each set at most, the first ones; all where it is None.
        given: objects that are not built in, by name.

    Raises:
        DataError: a set is missing, damaged, unfinished, imported or sealed, or was made from another object.
        SettingsError: there are more scenes than ids.
    """
    found: list[BopObject] = []
    first_scene = FIRST_SCENE
    for obj_id, folder in enumerate(folders, start=1):
        dataset = load(folder, split)
        settings = _rendered(folder, dataset)
        spec = object_behind(folder, dataset.manifest, (given or {}).get(dataset.object))
        found.append(BopObject(obj_id, first_scene, dataset[:count], settings, spec))
        first_scene += scenes_of(len(found[-1].dataset))
    if first_scene > MAX_SCENE_ID + 1:
        raise SettingsError(
            f"the sets have {first_scene - 1} scenes, of which {MAX_SCENE_ID} have ids; --count takes fewer"
        )
    if len({(one.settings.camera, one.settings.has_depth) for one in found}) > 1:
        raise DataError(
            "the sets differ in camera, size or depth, and a BOP dataset has one camera; export each to its own folder"
        )
    return tuple(found)


def export_bop(
    objects: Sequence[BopObject],
    out: Path,
    *,
    radius_mm: float = DEFAULT_RADIUS_MM,
    symmetries: Symmetries = "object",
    on_image: Callable[[], object] = lambda: None,
) -> None:
    """Write a BOP dataset; the folder appears once it is whole.

    Args:
        objects: as `objects_in` returned them.
        out: the dataset's folder, missing or empty.
        radius_mm: how many millimetres the bounding sphere of each object has for a radius.
        symmetries: which models_info.json lists: "object", those of the object with its marking, which every image
            has; or "body", those of the body without it.
        on_image: called after each image.

    Raises:
        SettingsError: the radius is no length, or the symmetries of a ball's body were asked for, which are no list.
        DataError: a shard is damaged.
        OutputError: the folder holds something, or cannot be written to; nothing of the dataset is left.
    """
    least, most = _RADII_MM
    if not (math.isfinite(radius_mm) and least <= radius_mm <= most):
        raise SettingsError(f"radius: expected {least:g} to {most:g} mm, found {radius_mm}")
    balls = [one.spec.name for one in objects if one.spec.has_all_rotations]
    if balls and symmetries == "body":
        raise SettingsError(
            f"symmetries: the body of {', '.join(balls)} is a ball, whose symmetries are all rotations, and "
            "models_info.json lists none or few; take those of the object"
        )
    with held_folder(out):
        _refuse_contents(out)
        with new_folder(out) as new:
            split, camera = objects[0].dataset.split, objects[0].settings.camera
            targets = []
            for one in objects:
                targets += write_scenes(
                    new / split, one.dataset, camera, radius_mm, one.obj_id, one.first_scene, on_image
                )
            _write_models(new, objects, radius_mm, symmetries)
            size = {"width": camera.width, "height": camera.height}
            scale = {"depth_scale": depth_scale(camera, radius_mm)}
            (new / "camera.json").write_bytes(to_json({**intrinsics(camera), **scale, **size}))
            (new / "dataset_info.md").write_text(_about(objects, radius_mm, symmetries), encoding="utf-8")
            groups = {one.obj_id: _as_lists(one.dataset.symmetry_group) for one in objects}
            (new / SYMMETRY_GROUPS_NAME).write_bytes(to_json(groups))
            if split == "test":
                (new / "test_targets_bop19.json").write_bytes(to_json(targets))


def _rendered(folder: Path, dataset: Dataset) -> RenderedSettings:
    if isinstance(dataset.manifest.settings, RenderedSettings):
        return dataset.manifest.settings
    if dataset.manifest.is_sealed:
        raise DataError(
            f"{folder}: is sealed: its rotations are secret, and BOP's files hold them; export the set beside the "
            "secret once that is revealed (docs/sealed.md)"
        )
    raise DataError(
        f"{folder}: was imported: its camera, mesh and convention are not known, and BOP's files hold them; "
        "export a set that `symsol-annot render` made"
    )


def _refuse_contents(out: Path) -> None:
    with output_errors(out):
        names = sorted(path.name for path in out.iterdir())
    if names:
        raise OutputError(
            f"{out}: is not empty: it holds {first_of(names, _LISTED_NAMES)}. Nothing was touched; "
            "choose another folder with --out, or move these elsewhere"
        )


def _write_models(folder: Path, objects: Sequence[BopObject], radius_mm: float, symmetries: Symmetries) -> None:
    info: dict[int, dict[str, Any]] = {}
    plies: dict[int, bytes] = {}
    for one in objects:
        group = one.spec.stabiliser if symmetries == "object" else one.spec.symmetry_group
        info[one.obj_id] = model_info(one.spec.mesh, group, radius_mm)
        plies[one.obj_id] = to_ply(one.spec.mesh, one.settings.render, radius_mm)
    for name in MODEL_FOLDERS:
        (folder / name).mkdir()
        (folder / name / "models_info.json").write_bytes(to_json(info))
        for obj_id, ply in plies.items():
            (folder / name / f"obj_{obj_id:06d}.ply").write_bytes(ply)


def _as_lists(group: Rotations) -> list[list[float]]:
    return [[float(value) for value in row] for row in group.reshape(-1, 9) + 0.0]  # no -0


def _about(objects: Sequence[BopObject], radius_mm: float, symmetries: Symmetries) -> str:
    """Return dataset_info.md."""
    of = "the object with its marking" if symmetries == "object" else "the body without its marking"
    rows = [
        f"| {one.obj_id} | {one.spec.name}: {one.spec.title} | {one.first_scene} | {len(one.dataset)} "
        f"| `{one.dataset.fingerprint}` |"
        for one in objects
    ]
    distance_mm = objects[0].settings.camera.distance * radius_mm
    lines = [
        "# A BOP dataset made by symsol-annot",
        "",
        f"- The bounding sphere of each object has a radius of {radius_mm:g} mm.",
        f"- Each image shows one object, whose centre lies {distance_mm:g} mm in front of the camera.",
        f"- Symmetries in models_info.json are those of {of}.",
        f"- {SYMMETRY_SETS_NAME} lists for each image which g of the object's list in {SYMMETRY_GROUPS_NAME} fit",
        "  it, by their numbers from 0: its symmetry set is all `cam_R_m2c @ g`.",
        "",
        "| obj_id | object | first scene | images | fingerprint of the split |",
        "|---|---|---|---|---|",
        *rows,
    ]
    return "\n".join(lines) + "\n"
