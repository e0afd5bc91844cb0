"""What labels obey, whoever signed them: rotations, a group, R_gt in every set, the one rule's sets."""

from dataclasses import replace
from functools import partial

import h5py
import numpy as np
import pytest
import symsol_source
from hypothesis import given, settings
from hypothesis import strategies as st
from made_sets import make_set
from tampering import change_group, put, reseal, tampered

from symsol_annot.errors import DataError
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.renderer import View
from symsol_annot.rendering.settings import RenderSettings
from symsol_annot.rotations.groups import cyclic_group, dihedral_group, tetrahedral_group
from symsol_annot.rotations.so3 import uniform_rotations
from symsol_annot.sets.dataset import load
from symsol_annot.sets.manifest import read_manifest, write_manifest
from symsol_annot.sets.shard.header import ShardHeader
from symsol_annot.sets.shard.laws import label_faults
from symsol_annot.sets.shard.reader import open_shard
from symsol_annot.sets.shard.writer import ImageRecord, ShardWriter
from symsol_annot.sets.stated.settings import RenderedSettings
from symsol_annot.sets.statistics import split_statistics
from symsol_annot.sets.verify import verify
from symsol_annot.symsol.importing import import_symsol

SECOND, FIRST_INDEX, ROWS = "test-00001-of-00003.h5", 16, 16
TOLERANCE_PX = 5.0
GROUP = tetrahedral_group()
STABILISER = [
    index for index, g in enumerate(GROUP) if np.allclose(g @ [1, 1, 1], [1, 1, 1])
]  # of the face that tetX's marking covers
SETTINGS = RenderedSettings(
    object="mug",
    object_sha256="ab" * 32,
    seed=0,
    camera=Camera(4.0, 27.9, 16, 16),
    render=RenderSettings(),
    tolerance_px=TOLERANCE_PX,
    annotate="all",
)
VIEW = View(np.zeros((16, 16, 3), "u1"), np.ones((16, 16), "u1"), np.array([256.0, 0.0]))
REMARK = "differs from a member by one that maps the marking onto itself"


def members(*indices, group=GROUP):
    mask = np.zeros(len(group), dtype=bool)
    mask[list(indices)] = True
    return mask


def coset(element, stabiliser=STABILISER, group=GROUP):
    """The indices of g H, found by looking at every element."""
    products = group[element] @ group[stabiliser]
    return {int(np.argmin(np.abs(group - product).sum(axis=(1, 2)))) for product in products}


def faults_of(tmp_path, rows, group=GROUP, tolerance_px=TOLERANCE_PX):
    """Write a shard of images with these areas and sets, and return its faults."""
    rotations = uniform_rotations(len(rows), np.random.default_rng(0))
    path = tmp_path / "shard.h5"
    header = ShardHeader(replace(SETTINGS, tolerance_px=tolerance_px), "test", 0, versions={})
    with ShardWriter(header, len(rows), group, annotated=True) as writer:
        for R, (pixels, mask) in zip(rotations, rows, strict=True):
            writer.add(ImageRecord(VIEW, R, pixels, mask))
        made = writer.finish({"candidates_drawn": 0, "candidates_within_tolerance": 0})
    path.write_bytes(made.data)
    with open_shard(path) as shard:
        return list(label_faults(shard, shard.labels()))


# The one rule's sets


def test_the_oracles_stabiliser_is_that_of_a_face():
    assert len(STABILISER) == 3
    assert {frozenset(coset(element)) for element in STABILISER} == {frozenset(STABILISER)}
    assert len({frozenset(coset(element)) for element in range(12)}) == 4


def test_sets_of_the_one_rule_have_no_fault(tmp_path):
    cosets = sorted({frozenset(coset(element)) for element in range(12)}, key=lambda found: 0 not in found)
    unions = [members(*cosets[0].union(*(cosets[k] for k in range(1, 4) if bits >> k & 1))) for bits in range(0, 16, 2)]
    rows = [(TOLERANCE_PX, members(*STABILISER)), (100.0, members(*STABILISER)), *[(0.0, union) for union in unions]]
    assert faults_of(tmp_path, rows) == []
    assert faults_of(tmp_path, rows[:2]) == []
    assert faults_of(tmp_path, rows[2:]) == []


@settings(deadline=None, max_examples=60)
@given(st.integers(1, 2**11))
def test_set_of_a_hidden_marking_is_whole_cosets_or_has_a_fault(tmp_path_factory, bits):
    mask = members(0, *[index for index in range(1, 12) if bits >> index - 1 & 1])
    there = set(np.flatnonzero(mask).tolist())
    is_whole = all(coset(element) <= there for element in there)
    found = faults_of(tmp_path_factory.mktemp("set"), [(9.0, members(*STABILISER)), (0.0, mask)])
    assert (found == []) == is_whole
    assert is_whole or found == [f"symmetry_mask: image 1: the set lacks a rotation that {REMARK}"]


def test_area_that_is_the_tolerance_shows_and_one_below_does_not(tmp_path):
    whole = members(*range(12))
    below = float(np.nextafter(np.float32(TOLERANCE_PX), np.float32(0)))
    assert faults_of(tmp_path, [(9.0, members(*STABILISER)), (below, whole)]) == []
    (fault,) = faults_of(tmp_path, [(9.0, members(*STABILISER)), (TOLERANCE_PX, whole)])
    assert "images that show the marking have different sets" in fault


@pytest.mark.parametrize("shown", [(0, STABILISER[1]), (0, *range(5, 12)), range(11)])
def test_set_of_images_that_show_the_marking_is_a_subgroup_or_a_fault(tmp_path, shown):
    (fault,) = faults_of(tmp_path, [(9.0, members(*shown))] * 2)
    assert fault.startswith("symmetry_mask: the set of images that show the marking: element ")


@pytest.mark.parametrize("shown", [(0,), STABILISER, range(12)])
def test_any_subgroup_may_be_the_stabiliser(tmp_path, shown):
    assert faults_of(tmp_path, [(9.0, members(*shown)), (0.0, members(*range(12)))]) == []


def test_body_without_marking_has_its_whole_group(tmp_path):
    assert faults_of(tmp_path, [(0.0, members(*range(12)))] * 2, tolerance_px=np.nan) == []
    (fault,) = faults_of(tmp_path, [(0.0, members(*range(12))), (0.0, members(*range(11)))], tolerance_px=np.nan)
    assert fault == "symmetry_mask: image 1: a body without marking has its whole group"


@pytest.mark.parametrize("group", [cyclic_group(1), cyclic_group(360), dihedral_group(360)], ids=len)
def test_sets_over_round_bodies_have_no_fault_and_one_rotation_too_few_is_one(tmp_path, group):
    """A marking that no turn maps onto itself: shown, one rotation; then one that a half turn does."""
    whole = members(*range(len(group)), group=group)
    assert faults_of(tmp_path, [(9.0, members(0, group=group)), (0.0, whole)], group) == []
    if len(group) > 1:
        two = members(0, len(group) // 2, group=group)  # a half turn, so a subgroup
        torn = whole.copy()
        torn[3] = False
        assert faults_of(tmp_path, [(9.0, two), (0.0, whole)], group) == []
        (fault,) = faults_of(tmp_path, [(9.0, two), (0.0, torn)], group)
        assert REMARK in fault


def test_all_faults_are_told_at_once(tmp_path):
    group = GROUP.copy()
    group[4] = np.nan
    found = faults_of(tmp_path, [(-1.0, members(1)), (np.nan, members(0))], group)
    assert [fault.split(":")[0] for fault in found] == ["marking_pixels", "symmetry_group", "symmetry_mask"]
    assert "image 0, 1: is no area" in found[0]


# A set that somebody signed again: `load` refuses what `verify` lists, and so does what counts over it


def spoilt(name, row, value):
    def spoil(shard):
        values = shard[name][...]
        values[row] = value(values[row]) if callable(value) else value
        shard[name][...] = values

    return spoil


def other_group(change):
    def spoil(shard):
        change_group(shard, change)

    return spoil


def with_element(index, value, group):
    group[index] = value
    return group


def turned_element(group):
    group[5] = group[5] @ cyclic_group(360)[1]
    return group


def doubled(shard):
    change_group(shard, lambda group: np.concatenate([group, group]))
    put(shard, "symmetry_mask", np.concatenate([shard["symmetry_mask"][...]] * 2, axis=1))


def doubled_by_a_turn_that_is_none(shard):
    mask = shard["symmetry_mask"][...]
    angle = 1e-8
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    change_group(shard, lambda group: np.concatenate([group, group @ turn]))
    put(shard, "symmetry_mask", np.concatenate([mask, mask], axis=1))


LAWLESS = {
    "no rotation": (spoilt("rotation", 3, lambda R: 1.001 * R), "rotation: image 19: is no rotation"),
    "reflection": (spoilt("rotation", 3, lambda R: -R), "rotation: image 19: is no rotation"),
    "zeros": (spoilt("rotation", slice(None), 0.0), "rotation: image 16, 17, 18, 19, 20 and 11 more: is no rotation"),
    "not a number": (spoilt("rotation", 0, np.nan), "rotation: image 16: is no rotation"),
    "huge": (spoilt("rotation", 0, 1e300), "rotation: image 16: is no rotation"),
    "infinite": (spoilt("rotation", 0, np.inf), "rotation: image 16: is no rotation"),
    "negative area": (spoilt("marking_pixels", 15, -0.25), "marking_pixels: image 31: is no area"),
    "infinite area": (spoilt("marking_pixels", 15, np.inf), "marking_pixels: image 31: is no area"),
    "negative area of a part": (spoilt("part_pixels", (3, 0), -1.0), "part_pixels: image 19: is no area"),
    "area of a part that is no number": (spoilt("part_pixels", (3, 1), np.nan), "part_pixels: image 19: is no area"),
    "infinite area of a part": (spoilt("part_pixels", (0, 0), np.inf), "part_pixels: image 16: is no area"),
    "parts larger than the image": (
        spoilt("part_pixels", (2, 0), 65 * 65 / 4 + 0.25),
        "part_pixels: image 18: is more than the 1056.25 pixels of an image",
    ),
    "parts larger than the image together": (
        spoilt("part_pixels", slice(None), lambda areas: areas + np.array([1057.0, 0.0])),
        "part_pixels: image 16, 17, 18, 19, 20 and 11 more: is more than",
    ),
    "marking larger than its coset's": (
        spoilt("part_pixels", (5, 1), lambda area: area + 300),
        "marking_pixels: image 21: is less than the marking's part_pixels",
    ),
    "empty set": (spoilt("symmetry_mask", 2, False), "symmetry_mask: image 18: the set lacks R_gt"),
    "no sets at all": (spoilt("symmetry_mask", slice(None), False), "the set lacks R_gt"),
    "group of zeros": (other_group(lambda group: 0 * group), "symmetry_group: element 0 is no rotation"),
    "turned group": (other_group(lambda group: cyclic_group(5)[1] @ group), "element 0 is not the identity"),
    "turned element": (other_group(turned_element), "so it is no group"),
    "reversed group": (other_group(lambda group: group[::-1]), "element 0 is not the identity"),
    "group twice": (doubled, "element 12 is there twice"),
    "group twice by a turn that is none": (doubled_by_a_turn_that_is_none, "element 12 is there twice"),
}


@pytest.mark.parametrize("case", LAWLESS)
def test_lawless_labels_are_refused_by_load_and_listed_by_verify_whoever_signed_them(tetX_set, case):
    spoil, words = LAWLESS[case]
    with tampered(tetX_set, SECOND) as shard:
        spoil(shard)
    assert [fault for fault in verify(tetX_set) if fault.startswith(SECOND) and words in fault]
    for check in (True, False):
        dataset = load(tetX_set, check=check)
        for read in (lambda: dataset[FIRST_INDEX], dataset.labels):  # noqa: B023 - called at once
            with pytest.raises(DataError, match=f"{SECOND}: its labels are none of an image set:\n") as refused:
                read()
            assert words in str(refused.value)
        assert dataset[0].index == 0
    with pytest.raises(DataError, match=SECOND):
        split_statistics(tetX_set, read_manifest(tetX_set), "test")


def test_no_warning_and_no_result_comes_of_numbers_at_the_ends_of_their_range(tetX_set):
    values = [1e308, -1e308, 5e-324, 1.7e-308, np.inf, -np.inf, np.nan, 2.0**52]
    for value in values:
        with tampered(tetX_set, SECOND) as shard:
            shard["rotation"][0] = value
            change_group(shard, partial(with_element, 3, value))
            shard["marking_pixels"][1] = np.float32(np.clip(value, -3e38, 3e38))
        with pytest.raises(DataError, match="is no rotation"):
            load(tetX_set)[FIRST_INDEX]


@pytest.mark.parametrize("areas", [(1056.25, 0.0), (1055.0, 1.25), (0.0, 1056.25), (0.0, 0.0)])
def test_parts_may_fill_the_lattice_and_no_more(tmp_path, areas):
    """65 by 65 points of a quarter of a pixel, for 32 by 32 pixels."""
    folder = make_set(tmp_path, "tetX", test=1)
    file = "test-00000-of-00001.h5"
    with tampered(folder, file) as shard:
        shard["part_pixels"][0] = areas
        shard["marking_pixels"][0] = areas[1]
        shard["symmetry_mask"][0] = members(0) if areas[1] else members(*range(12))
    assert [fault for fault in verify(folder) if "pixels" in fault] == []
    with tampered(folder, file) as shard:
        shard["part_pixels"][0, 0] += 0.25 if sum(areas) else 1057
    assert [fault.split(":")[1] for fault in verify(folder)] == [" part_pixels"]


# Sets from elsewhere


@pytest.fixture
def imported(tmp_path):
    """An imported set of a body without marking, whose group comes from lists in float32."""
    files, _ = symsol_source.content(("tet",))
    (made,) = import_symsol(symsol_source.write_zip(tmp_path / "symsol.zip", files), tmp_path / "sets")
    return made.folder


def test_imported_sets_obey_the_laws_that_can_be_known_of_them(imported):
    assert verify(imported) == []
    with load(imported) as dataset:
        assert all(len(sample.symmetry_set) == 12 for sample in dataset)


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (spoilt("rotation", 0, lambda R: 2 * R), "is no rotation"),
        (spoilt("symmetry_mask", (0, 0), False), "the set lacks R_gt"),
        (spoilt("symmetry_mask", (0, 3), False), "a body without marking has its whole group"),
        (other_group(turned_element), "so it is no group"),
    ],
)
def test_lawless_imported_labels_are_refused_whoever_signed_them(imported, spoil, words):
    name = read_manifest(imported).of_split("test")[0].file
    with tampered(imported, name) as shard:
        spoil(shard)
    with pytest.raises(DataError, match=words):
        load(imported)[0]


# Whose shard it is


def test_shard_that_is_the_manifests_by_its_digest_but_of_another_plan_is_refused(tetX_set, tmp_path):
    other = make_set(tmp_path / "other", test=40, seed=1)
    (other / SECOND).replace(tetX_set / SECOND)
    reseal(tetX_set)
    with pytest.raises(DataError, match=f"{SECOND}: is no shard of this set:\n.*'seed': expected 0, found 1"):
        load(tetX_set)[FIRST_INDEX]


def test_sets_that_the_manifest_denies_are_refused(tetX_set):
    manifest = read_manifest(tetX_set)
    write_manifest(tetX_set, replace(manifest, settings=replace(manifest.settings, annotate="none")))
    with pytest.raises(DataError, match="manifest and shard disagree on whether the split has symmetry sets"):
        load(tetX_set)[0]


def test_a_lawful_shard_is_what_it_was(tetX_set):
    """Else the tests here would find what the tampering did."""
    before = [sample.symmetry_mask for sample in load(tetX_set)]
    with tampered(tetX_set, SECOND) as shard:
        for name in ("rotation", "symmetry_mask", "marking_pixels", "part_pixels"):
            put(shard, name, shard[name][...])
        change_group(shard, lambda group: group)
        assert isinstance(shard, h5py.File)
    np.testing.assert_array_equal(before, [sample.symmetry_mask for sample in load(tetX_set)])
    assert verify(tetX_set) == []
