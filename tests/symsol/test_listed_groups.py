"""Lists of rotations of an unknown convention: the group that they stand for, each element once."""

import numpy as np
import pytest
import symsol_source
from hostile_zips import assert_refused, rotations_changed, with_value
from imported_sets import MEMBERS, NAMES, SAME_RAD, angles, imported
from symsol_source import COUNTS, npz, write_zip

import symsol_annot


def test_the_ends_of_circles_are_counted(source):
    _, _, made = source
    sources = {name: made[name].manifest.imported.source for name in NAMES}
    duplicates = {name: (source.rotations_listed, source.duplicates_removed) for name, source in sources.items()}
    assert duplicates == {"tet": (12, 0), "cone": (360, 1), "cyl": (720, 2), "tetX": (1, 0)}
    assert all(0 < made[name].off_so3 < SAME_RAD for name in NAMES)
    assert all(0 < made[name].off_sets_rad < SAME_RAD for name in MEMBERS)


def test_symmetries_that_act_on_the_left_are_made_to_act_on_the_right(tmp_path):
    """A source whose matrices take camera to model lists g R; transposed, they are labels like ours."""
    files, arrays = symsol_source.content(("tet", "tetX"))
    for split in COUNTS:
        tables = {name: np.swapaxes(arrays[name, split], -1, -2) for name in ("tet", "tetX")}
        files[f"{split}/rotations.npz"] = npz({name: np.ascontiguousarray(table) for name, table in tables.items()})
    made = imported(write_zip(tmp_path / "s.zip", files), tmp_path / "sets")
    for name in ("tet", "tetX"):  # which lists nothing that would tell, but comes from the same source
        assert made[name].manifest.imported.source.transposed is True
        sample = symsol_annot.load(made[name].folder)[3]
        assert angles(sample.rotation, arrays[name, "test"][3, 0]) < SAME_RAD
    S = symsol_annot.load(made["tet"].folder)[3].symmetry_set
    assert angles(arrays["tet", "test"][3], S).min(axis=1).max() < SAME_RAD


def test_a_list_in_another_order_is_the_same_set(tmp_path):
    files, arrays = symsol_source.content(("cyl",))
    table = arrays["cyl", "train"]
    table[17, 1:] = table[17, 1:][np.random.default_rng(0).permutation(719)]
    files["train/rotations.npz"] = npz({"cyl": table})
    made = imported(write_zip(tmp_path / "s.zip", files), tmp_path / "sets")
    assert np.allclose(symsol_annot.load(made["cyl"].folder, "train")[17].rotation, table[17, 0], atol=1e-6)


HOSTILE = {
    "no common list": (
        rotations_changed(lambda t: with_value(t, (4, 5), t[3, 5]), "test"),
        "of the first 6 images are not R g",
    ),
    "no group": (rotations_changed(lambda t: t[:, :5], "train", "test"), "different rotations of a list make no group"),
}


@pytest.mark.parametrize(("damage", "message"), HOSTILE.values(), ids=HOSTILE)
def test_a_damaged_or_hostile_zip_is_one_error_and_leaves_nothing(tmp_path, damage, message):
    assert_refused(tmp_path, damage, message)
