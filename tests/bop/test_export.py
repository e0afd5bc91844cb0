"""A BOP dataset, read back by BOP's page alone, says what the set says; what cannot be exported leaves nothing."""

import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import symsol_source
from bench_sets import SmallDisk
from bop_reader import pixels, read_json, read_ply, silhouette
from imported_sets import imported
from made_sets import make_set
from sealed_tests import sealed_test

import symsol_annot
from symsol_annot.bop import numbering
from symsol_annot.bop.export import export_bop, objects_in
from symsol_annot.errors import DataError, OutputError, SettingsError
from symsol_annot.objects.spec import load_object

RADIUS_MM = 100.0


def scene_of(exported, name):
    return exported / "test" / {"tetX": "000001", "cyl": "000002"}[name]


@pytest.mark.parametrize(("name", "obj_id"), [("tetX", 1), ("cyl", 2)])
def test_every_image_comes_back_with_its_labels(sets, exported, name, obj_id):
    scene, dataset = scene_of(exported, name), symsol_annot.load(sets / name)
    poses, info, cameras = (read_json(scene / f"scene_{what}.json") for what in ("gt", "gt_info", "camera"))
    listed = read_json(scene / "scene_gt_symmetries.json")
    group = np.reshape(read_json(exported / "symmetry_groups.json")[str(obj_id)], (-1, 3, 3))
    assert list(poses) == list(info) == list(cameras) == list(listed) == [str(i) for i in range(len(dataset))]
    for i, sample in enumerate(dataset):
        assert np.array_equal(pixels(scene / "rgb" / f"{i:06d}.png"), sample.image)
        is_object = sample.segmentation > 0
        for mask in ("mask", "mask_visib"):
            assert np.array_equal(pixels(scene / mask / f"{i:06d}_000000.png"), 255 * is_object)
        (pose,) = poses[str(i)]
        assert pose["obj_id"] == obj_id
        assert pose["cam_R_m2c"] == sample.rotation.ravel().tolist()
        assert pose["cam_t_m2c"] == [0.0, 0.0, 4.0 * RADIUS_MM]
        scale = cameras[str(i)]["depth_scale"]
        depth_mm = scale * pixels(scene / "depth" / f"{i:06d}.png")
        np.testing.assert_allclose(depth_mm, RADIUS_MM * sample.depth, atol=0.51 * scale)
        (of_image,) = info[str(i)]
        area = np.count_nonzero(is_object)
        assert of_image["px_count_all"] == of_image["px_count_visib"] == of_image["px_count_valid"] == area
        rows, columns = np.nonzero(is_object)
        box = [columns.min(), rows.min(), np.ptp(columns), np.ptp(rows)]
        assert of_image["bbox_obj"] == of_image["bbox_visib"] == box
        assert of_image["visib_fract"] == 1.0
        (sets_of_image,) = listed[str(i)]
        assert sets_of_image["obj_id"] == obj_id
        R = np.reshape(pose["cam_R_m2c"], (3, 3))
        np.testing.assert_array_equal(R @ group[sets_of_image["symmetries"]], sample.symmetry_set.members)


@pytest.mark.parametrize(("name", "obj_id"), [("tetX", 1), ("cyl", 2)])
def test_the_model_at_its_pose_through_its_camera_covers_the_mask(exported, name, obj_id):
    scene = scene_of(exported, name)
    vertices, _, _, triangles = read_ply(exported / "models" / f"obj_{obj_id:06d}.ply")
    poses, cameras = read_json(scene / "scene_gt.json"), read_json(scene / "scene_camera.json")
    for i in poses:
        K = np.reshape(cameras[i]["cam_K"], (3, 3))
        R, t = np.reshape(poses[i][0]["cam_R_m2c"], (3, 3)), np.array(poses[i][0]["cam_t_m2c"])
        mask = pixels(scene / "mask" / f"{int(i):06d}_000000.png") > 0
        off = silhouette(vertices, triangles, K, R, t, mask.shape) ^ mask
        assert np.count_nonzero(off) <= (0 if name == "tetX" else 4)  # the ray caster's cylinder is round, no prism


def test_the_dataset_has_what_the_format_asks_for(exported):
    assert sorted(path.name for path in exported.iterdir()) == [
        "camera.json",
        "dataset_info.md",
        "models",
        "models_eval",
        "symmetry_groups.json",
        "test",
        "test_targets_bop19.json",
    ]
    camera = read_json(exported / "camera.json")
    assert (camera["width"], camera["height"], camera["cx"], camera["cy"]) == (32, 32, 15.5, 15.5)
    scene_camera = read_json(exported / "test/000001/scene_camera.json")["0"]
    assert scene_camera["cam_K"] == [camera["fx"], 0, 15.5, 0, camera["fy"], 15.5, 0, 0, 1]
    assert scene_camera["depth_scale"] == camera["depth_scale"]
    targets = read_json(exported / "test_targets_bop19.json")
    expected = [(1, i, 1, 1) for i in range(12)] + [(2, i, 2, 1) for i in range(3)]
    assert [(t["scene_id"], t["im_id"], t["obj_id"], t["inst_count"]) for t in targets] == expected
    for name in ("models_info.json", "obj_000001.ply", "obj_000002.ply"):
        assert (exported / "models" / name).read_bytes() == (exported / "models_eval" / name).read_bytes()
    info = read_json(exported / "models" / "models_info.json")
    assert len(info["1"]["symmetries_discrete"]) == 2  # with its marking: a third of a turn, and two
    assert info["2"]["symmetries_continuous"] == [{"axis": [0, 0, 1], "offset": [0, 0, 0]}]


def test_the_symmetries_of_the_body_may_be_stated_instead(sets, tmp_path):
    export_bop(objects_in([sets / "tetX"], count=1), tmp_path / "bop", symmetries="body")
    assert len(read_json(tmp_path / "bop/models/models_info.json")["1"]["symmetries_discrete"]) == 11


def test_scenes_are_split_and_numbered_so_that_the_index_follows(sets, tmp_path, monkeypatch):
    monkeypatch.setattr(numbering, "SCENE_IMAGES", 5)
    export_bop(objects_in([sets / "tetX"]), tmp_path / "bop")
    found = {}
    for scene in sorted((tmp_path / "bop/test").iterdir()):
        for im_id, (pose,) in read_json(scene / "scene_gt.json").items():
            found[numbering.index_of(1, int(scene.name), int(im_id))] = pose["cam_R_m2c"]
    assert [path.name for path in sorted((tmp_path / "bop/test").iterdir())] == ["000001", "000002", "000003"]
    dataset = symsol_annot.load(sets / "tetX")
    assert found == {sample.index: sample.rotation.ravel().tolist() for sample in dataset}


@pytest.mark.parametrize(
    ("first", "scene_id", "im_id"), [(1, 0, 0), (3, 2, 0), (1, 1_000_000, 0), (1, 1, 1000), (1, 1, -1)]
)
def test_ids_that_no_image_has_are_refused(first, scene_id, im_id):
    with pytest.raises(DataError, match=r"as (--first-scene says|export-bop numbers them)"):
        numbering.index_of(first, scene_id, im_id)


def test_the_lines_of_the_page_give_the_symmetry_set(sets, tmp_path, monkeypatch):
    page = (Path(__file__).parents[2] / "docs" / "bop.md").read_text()
    (code,) = re.findall(r"```python\n(.*?)```", page, flags=re.DOTALL)
    export_bop(objects_in([sets / "tetX"]), tmp_path / "bop" / "cylO")
    monkeypatch.chdir(tmp_path)
    names = {}
    exec(code, names)
    np.testing.assert_array_equal(names["symmetry_set"], symsol_annot.load(sets / "tetX")[0].symmetry_set)


def test_a_train_split_without_symmetry_sets_has_poses_alone(sets, tmp_path):
    export_bop(objects_in([sets / "tetX"], "train"), tmp_path / "bop", radius_mm=1.0)
    scene = tmp_path / "bop/train/000001"
    assert read_json(scene / "scene_gt.json")["1"][0]["cam_t_m2c"] == [0.0, 0.0, 4.0]
    assert not (scene / "scene_gt_symmetries.json").exists()
    assert not (tmp_path / "bop/test_targets_bop19.json").exists()


def test_the_command_says_what_it_wrote_and_takes_the_first_images(sets, here, tmp_path):
    done = here("export-bop", sets / "tetX", "--out", tmp_path / "a" / "bop", "--count", "2", "--radius-mm", "50")
    assert (done.returncode, done.stdout) == (
        0,
        f"{tmp_path}/a/bop: tetX (object 1): 2 test images; a bounding sphere has a radius of 50 mm\n",
    )
    assert list(read_json(tmp_path / "a/bop/test/000001/scene_gt.json")) == ["0", "1"]
    again = here("export-bop", sets / "tetX", "--out", tmp_path / "a" / "bop")
    assert again.returncode == 1
    assert "is not empty: it holds camera.json, dataset_info.md" in again.stderr
    assert "Nothing was touched" in again.stderr


def test_a_sealed_set_is_refused(tmp_path):
    folder = sealed_test(tmp_path / "sealed")
    (images,) = {path.parent for path in folder.rglob("manifest.json") if "commitment" in path.read_text()}
    with pytest.raises(DataError, match=r"is sealed: its rotations are secret.*docs/sealed.md"):
        objects_in([images])


def test_an_imported_set_is_refused(tmp_path):
    files, _ = symsol_source.content(["tet"])
    made = imported(symsol_source.write_zip(tmp_path / "symsol.zip", files), tmp_path / "sets", "tet")["tet"]
    with pytest.raises(DataError, match=r"was imported: its camera, mesh and convention are not known"):
        objects_in([made.folder])


def test_an_object_that_is_another_here_is_refused(sets):
    another = replace(load_object("tetX"), digest="0" * 64)
    with pytest.raises(DataError, match=r"was made from another tetX than the one here.*--object"):
        objects_in([sets / "tetX"], given={"tetX": another})


def test_a_damaged_shard_leaves_nothing(sets, tmp_path):
    shutil.copytree(sets / "tetX", tmp_path / "tetX")
    for shard in (tmp_path / "tetX").glob("test-*.h5"):
        shard.write_bytes(shard.read_bytes()[:-1])
    with pytest.raises(DataError):
        export_bop(objects_in([tmp_path / "tetX"]), tmp_path / "new" / "bop")
    assert [path.name for path in tmp_path.iterdir()] == ["tetX"]


def test_a_disk_that_fills_up_leaves_nothing(sets, tmp_path):
    disk = SmallDisk(tmp_path / "disk")
    disk.folder.mkdir()
    try:
        disk.resize(64)
        with pytest.raises(OutputError, match="bop: cannot be written: the disk is full: make room"):
            export_bop(objects_in([sets / "tetX"]), disk.folder / "bop")
        assert list(disk.folder.iterdir()) == []
    finally:
        disk.unmount()


@pytest.mark.parametrize("radius_mm", [0.0, -1.0, float("nan"), float("inf")])
def test_a_radius_that_is_no_length_is_refused(sets, tmp_path, radius_mm):
    with pytest.raises(SettingsError, match=r"radius: expected 0.001 to 1e\+06 mm"):
        export_bop(objects_in([sets / "tetX"]), tmp_path / "bop", radius_mm=radius_mm)
    assert not (tmp_path / "bop").exists()


def test_sets_of_different_cameras_are_refused(sets, tmp_path):
    make_set(tmp_path, "tet", test=1, size=16, depth=True)
    with pytest.raises(DataError, match="the sets differ in camera, size or depth"):
        objects_in([sets / "tetX", tmp_path / "tet"])


def test_a_folder_with_a_stranger_s_file_stays_as_it_is(sets, tmp_path):
    (tmp_path / "bop").mkdir()
    (tmp_path / "bop" / "mine").write_text("mine")
    with pytest.raises(OutputError, match="is not empty: it holds mine"):
        export_bop(objects_in([sets / "tetX"]), tmp_path / "bop")
    assert [path.name for path in (tmp_path / "bop").iterdir()] == ["mine"]
