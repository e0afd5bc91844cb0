"""Images of a BOP dataset as a set: labels that draw the images, symmetry sets, nothing half done."""

import shutil
import zlib

import numpy as np
import pytest
from bop_reader import read_json, symmetry_transformations
from bop_scene import (
    INK,
    PAPER,
    POSES,
    SHAPE,
    VERTICES_MM,
    changed,
    drawn,
    encoded,
    rotation,
    write_dataset,
    write_json,
)
from imported_sets import angles, everything

import symsol_annot
from symsol_annot.bop.importing import Choice, import_bop
from symsol_annot.errors import DataError, DifferentSetError, SettingsError
from symsol_annot.sets.verify import verify

SIZE = 64


@pytest.fixture(scope="module")
def pristine(tmp_path_factory):
    """A dataset of three images; not to be written to."""
    return write_dataset(tmp_path_factory.mktemp("bop") / "lone")


@pytest.fixture
def dataset(pristine, tmp_path):
    """A copy of it that a test may damage."""
    return shutil.copytree(pristine, tmp_path / "lone")


def imported(root, out, obj_id=5, size=SIZE, **choice):
    return import_bop(root, out, Choice(obj_id, size=size, **choice))


def overlap(mask, other):
    return np.count_nonzero(mask & other) / np.count_nonzero(mask | other)


@pytest.mark.parametrize(("name", "obj_id"), [("tetX", 1), ("cyl", 2)])
def test_an_exported_set_comes_back(sets, exported, tmp_path, name, obj_id):
    made = imported(exported, tmp_path, obj_id, size=32, name=name)
    before, after = symsol_annot.load(sets / name), symsol_annot.load(made.folder)
    assert len(before) == len(after)
    info = read_json(exported / "models/models_info.json")[str(obj_id)]
    group = symmetry_transformations(info)
    for sample, again in zip(before, after, strict=True):
        assert np.abs(sample.rotation - again.rotation).max() < 1e-9
        assert np.median(np.abs(sample.image.astype(int) - again.image)) < 2
        assert np.abs(sample.image.astype(int) - again.image).mean() < 0.5
        S, distances = again.symmetry_set, angles(sample.rotation @ group, again.symmetry_set)
        assert len(S) == len(group)
        assert max(distances.min(axis=0).max(), distances.min(axis=1).max()) < 1e-7
    assert verify(made.folder) == []


def test_a_render_at_the_label_covers_the_object_in_the_image(pristine, tmp_path):
    """The image as a camera on the object's axis sees it, by BOP's page; distance and focal length are found anew."""
    samples = symsol_annot.load(imported(pristine, tmp_path).folder)
    assert len(samples) == len(POSES)
    for sample, (quat_wxyz, t) in zip(samples, POSES, strict=True):
        centre, radius = sphere()
        distance = np.linalg.norm(rotation(quat_wxyz) @ centre + t)
        focal = 0.45 * SIZE * np.sqrt((distance / radius) ** 2 - 1)
        K_new = np.array([[focal, 0, SIZE / 2 - 0.5], [0, focal, SIZE / 2 - 0.5], [0, 0, 1]])
        t_new = np.array([0, 0, distance]) - sample.rotation @ centre
        expected = drawn(sample.rotation, t_new, K_new, (SIZE, SIZE)) == INK
        found = (sample.image[..., 0] < (INK + PAPER) / 2) & (sample.image[..., 0] > INK / 2)  # not the black outside
        assert overlap(found, expected) > 0.97
        unturned = drawn(rotation(quat_wxyz), [0, 0, distance] - rotation(quat_wxyz) @ centre, K_new, (SIZE, SIZE))
        assert overlap(found, unturned == INK) < 0.9  # what a label would draw that forgot the turn
        assert len(sample.symmetry_set) == 1


def sphere():
    """The sphere on which all four corners lie is here the smallest one, or its great circle's through three is."""
    found = []
    for few in (
        [0, 1, 2, 3],
        [0, 1, 2],
        [0, 1, 3],
        [0, 2, 3],
        [1, 2, 3],
        [0, 1],
        [1, 2],
        [1, 3],
        [2, 3],
        [0, 2],
        [0, 3],
    ):
        a, *others = VERTICES_MM[few]
        sides = np.array([b - a for b in others])
        weights = np.linalg.solve(2 * sides @ sides.T, (sides**2).sum(axis=1))
        centre = a + weights @ sides
        found.append((np.linalg.norm(VERTICES_MM - centre, axis=1).max(), *centre))
    radius, *centre = min(found)
    return np.array(centre), radius


def test_what_is_too_hidden_is_left_out_and_without_visibility_all_count(dataset, here, tmp_path):
    done = here("import-bop", dataset, "--id", 5, "--out", tmp_path / "a", "--size", 16, "--least-visible", 0.5)
    assert done.stdout.startswith(f"{tmp_path}/a/obj_000005: 2 test images, 1 too hidden ones left out, sets of 1 rot")
    assert "BOP: object 5 of test, visible from 0.5" in here("info", tmp_path / "a/obj_000005").stdout
    (dataset / "test/000003/scene_gt_info.json").unlink()
    assert len(symsol_annot.load(imported(dataset, tmp_path / "b", least_visible=0.5).folder)) == 3


def test_grey_pictures_jpeg_and_other_splits_are_read(dataset, tmp_path):
    shutil.move(dataset / "test", dataset / "train_pbr")
    scene = dataset / "train_pbr/000003"
    colour = symsol_annot.load(imported(dataset, tmp_path / "a", split="train_pbr").folder, "train")
    for im_id, (quat_wxyz, t) in enumerate(POSES):
        K = np.reshape(read_json(scene / "scene_camera.json")[str(im_id)]["cam_K"], (3, 3))
        (scene / "gray").mkdir(exist_ok=True)
        jpeg = encoded(drawn(rotation(quat_wxyz), t, K, SHAPE), "JPEG")
        (scene / "gray" / f"{im_id:06d}.jpg").write_bytes(jpeg)
    shutil.rmtree(scene / "rgb")
    grey = symsol_annot.load(imported(dataset, tmp_path / "b", split="train_pbr").folder, "train")
    for sample, again in zip(colour, grey, strict=True):
        assert np.array_equal(sample.rotation, again.rotation)
        assert np.abs(sample.image.astype(int) - again.image).mean() < 3


def test_without_models_the_diameter_has_to_be_said(dataset, tmp_path):
    shutil.rmtree(dataset / "models")
    with pytest.raises(SettingsError, match="give its diameter with --diameter-mm"):
        imported(dataset, tmp_path / "out")
    assert not (tmp_path / "out").exists()
    samples = symsol_annot.load(imported(dataset, tmp_path / "out", diameter_mm=100.0).folder)
    assert len(samples[0].symmetry_set) == 1
    R, t = rotation(POSES[0][0]), np.array(POSES[0][1])
    turn = samples[0].rotation @ R.T
    np.testing.assert_allclose(turn @ t, [0, 0, np.linalg.norm(t)], atol=1e-9)  # the origin is looked at
    assert np.trace(turn) == pytest.approx(1 + 2 * t[2] / np.linalg.norm(t))  # by the smallest turn


def test_the_same_command_again_finds_the_set_whole_and_makes_lost_shards_again(dataset, here, tmp_path):
    words = ("import-bop", dataset, "--id", 5, "--out", tmp_path / "sets", "--size", 16)
    assert "poses off SO(3) by at most" in here(*words).stdout
    folder = tmp_path / "sets/obj_000005"
    whole = everything(folder)
    assert "was there already" in here(*words).stdout
    (shard,) = folder.glob("*.h5")
    shard.write_bytes(shard.read_bytes()[:-1])
    assert "was there already" not in here(*words, "--workers", 3).stdout
    assert everything(folder) == whole
    shard.unlink()
    with pytest.raises(DataError, match="the same `symsol-annot import-bop` command makes them"):
        symsol_annot.load(folder)
    here(*words)
    (picture, *_) = sorted((dataset / "test/000003/rgb").iterdir())
    picture.write_bytes(encoded(np.zeros((*SHAPE, 3), np.uint8)))
    with pytest.raises(DifferentSetError, match="sha256"):
        imported(dataset, tmp_path / "sets", size=16)
    assert everything(folder) == whole


SCENE = "test/000003"
POSE = f"{SCENE}/scene_gt.json"


def first_pose(**values):
    return lambda root: changed(root / POSE, lambda table: table["0"][1].update(values))


def raw(name, data):
    return lambda root: (root / name).write_bytes(data)


def camera(value):
    return lambda root: changed(root / SCENE / "scene_camera.json", lambda table: table["1"].update(cam_K=value))


def info(**values):
    return lambda root: changed(root / "models/models_info.json", lambda table: table["5"].update(values))


def link_out(name):
    def damage(root):
        outside = root.parent / "outside"
        shutil.move(root / name, outside)
        (root / name).symlink_to(outside)

    return damage


def longer(name, size):
    """A file that says this size, the end of which takes no room."""

    def damage(root):
        with (root / name).open("r+b") as file:
            file.truncate(size)

    return damage


PICTURE = f"{SCENE}/rgb/000001.png"
HEADER = b"IHDR" + (100_000).to_bytes(4, "big") * 2 + b"\x08\x02\0\0\0"
GIANT = b"\x89PNG\r\n\x1a\n\0\0\0\r" + HEADER + zlib.crc32(HEADER).to_bytes(4, "big") + b"\0\0\0\0IEND\xaeB`\x82"
JPEG = encoded(np.zeros((16, 16, 3), np.uint8), "JPEG")
WIDE = JPEG.replace(b"\x08\0\x10\0\x10\x03", b"\x08\xff\xff\xff\xff\x03")
NO_VERTICES = b"ply\nformat ascii 1.0\nelement vertex 99999999\n"
NO_VERTICES += b"".join(b"property float %c\n" % axis for axis in b"xyz") + b"end_header\n1 2 3\n"
HOSTILE = {
    "no JSON": (raw(POSE, b"{"), "scene_gt.json: cannot be read as JSON"),
    "nested JSON": (raw(POSE, b"[" * 100_000), "scene_gt.json: cannot be read as JSON"),
    "a list": (raw(POSE, b"[1]"), "expected a table in braces, the poses of each image, found a list of 1"),
    "no poses": (lambda root: (root / POSE).unlink(), "scene_gt.json: no such file; expected the poses"),
    "an image that is a path": (raw(POSE, b'{"../../x": []}'), "expected a whole number from 0 to 999999, found '../"),
    "an image twice": (raw(POSE, b'{"1": [], "01": []}'), "has image 1 twice"),
    "poses of no objects": (raw(POSE, b'{"1": [{}]}'), "expected tables with obj_id, found a table of 0"),
    "no cameras": (lambda root: (root / SCENE / "scene_camera.json").unlink(), "scene_camera.json: no such file"),
    "a camera less": (raw(f"{SCENE}/scene_camera.json", b"{}"), "has no image 0, of which scene_gt.json has poses"),
    "no camera": (camera([1, 2]), "image 1: cam_K: expected 9 numbers"),
    "a flat camera": (camera([0, 0, 0, 0, 5, 0, 0, 0, 1]), "cam_K: expected fx, s, cx, 0, fy"),
    "no rotation": (first_pose(cam_R_m2c=[1, 0, 0, 0, 1, 0, 0, 0, -1]), "image 0, instance 1: cam_R_m2c: is no rot"),
    "a huge number": (first_pose(cam_t_m2c=[1, 2, 10**400]), "cam_t_m2c: expected 3 numbers within 1e"),
    "no number": (first_pose(cam_t_m2c=[1, 2, float("nan")]), "cam_t_m2c: expected 3 numbers"),
    "true": (first_pose(cam_t_m2c=[1, 2, True]), "cam_t_m2c: expected 3 numbers"),
    "a pose behind the camera": (first_pose(cam_t_m2c=[0, 0, -400]), "image 0, instance 1: its centre is at"),
    "a camera in the object": (first_pose(cam_t_m2c=[0, 0, 1]), "in front of the camera, which is outside it"),
    "a visibility less": (
        lambda root: changed(root / SCENE / "scene_gt_info.json", lambda table: table["2"].pop()),
        "scene_gt_info.json: image 2: expected 2 entries, one per pose of scene_gt.json, found 1",
    ),
    "no picture": (lambda root: (root / PICTURE).unlink(), "image 1 is missing: expected rgb/000001.png"),
    "half a picture": (lambda root: raw(PICTURE, (root / PICTURE).read_bytes()[:90])(root), "000001.png: image"),
    "no PNG": (raw(PICTURE, b"GIF89a"), "000001.png: is neither PNG nor JPEG"),
    "a picture of 100,000 pixels": (raw(PICTURE, GIANT), "is 100000 x 100000 pixels, expected 16 to 8192 each way"),
    "a JPEG of 65,535 pixels": (raw(PICTURE, WIDE), "is 65535 x 65535 pixels, expected 16 to 8192 each way"),
    "half a JPEG": (raw(PICTURE, JPEG[:-40]), "000001.png: .*[Tt]runcated"),
    "a picture elsewhere": (link_out(PICTURE), "out of the dataset's folder"),
    "a scene elsewhere": (link_out(SCENE), "out of the dataset's folder"),
    "models elsewhere": (link_out("models"), "out of the dataset's folder"),
    "a link to itself": (
        lambda root: (root / PICTURE).unlink() or (root / PICTURE).symlink_to("000001.png"),
        "000001.png: (cannot be followed|Too many levels)",
    ),
    "a picture of 8 GiB": (longer(PICTURE, 2**33), r"000001.png: .*larger than the 134,217,728 bytes"),
    "no scenes": (lambda root: shutil.move(root / SCENE, root / "test/scene"), "test: has no scenes"),
    "no split": (lambda root: shutil.move(root / "test", root / "val"), "test: no such folder; .* has models, val"),
    "no box": (info(size_x=None), "min and size: expected 6 numbers"),
    "another unit": (info(diameter=0.1), "is one of them in another unit"),
    "half a model": (raw("models/obj_000005.ply", b"ply\nformat ascii 1.0\n"), "has no header of a PLY file"),
    "a model without vertices": (
        raw("models/obj_000005.ply", NO_VERTICES),
        "it is too short for its 99,999,999 vertices",
    ),
    "a symmetry that is none": (info(symmetries_discrete=[[1] * 16]), r"symmetries_discrete\[0\]: its first three col"),
}  # fmt: skip


@pytest.mark.parametrize(("damage", "message"), HOSTILE.values(), ids=HOSTILE)
def test_a_damaged_or_hostile_dataset_is_one_error_and_leaves_nothing(dataset, tmp_path, damage, message):
    damage(dataset)
    with pytest.raises(DataError, match=message):
        imported(dataset, tmp_path / "out", size=16)
    assert not (tmp_path / "out").exists() or list((tmp_path / "out").iterdir()) == []


def test_what_is_not_there_or_makes_no_sense_is_refused(dataset, here, tmp_path):
    with pytest.raises(SettingsError, match="no scene has object 6; there are: 5, 7"):
        imported(dataset, tmp_path / "out", 6)
    changed(
        dataset / SCENE / "scene_gt_info.json", lambda t: [e.update(visib_fract=0.05) for es in t.values() for e in es]
    )
    with pytest.raises(SettingsError, match=r"object 5 is in 3 images, visible by less than 0.1 in each; --least-vis"):
        imported(dataset, tmp_path / "out")
    for path, found in ((tmp_path / "none", "No such file"), (dataset / POSE, "is a file")):
        with pytest.raises(DataError, match=f"{found}.*; expected the folder of a BOP dataset"):
            imported(path, tmp_path / "out")
    for choice in (
        {"split": "../test"},
        {"split": "depth"},
        {"name": "../x"},
        {"size": 9000},
        {"least_visible": np.nan},
    ):
        with pytest.raises(SettingsError, match="expected"):
            Choice(5, **choice)
    assert not (tmp_path / "out").exists()
    write_json(dataset / "models/models_info.json", {})
    done = here("import-bop", dataset, "--id", 5, "--out", tmp_path / "out", "--least-visible", "2")
    assert (done.returncode, done.stdout) == (2, "")
