"""Objects as data: what a folder declares is what is loaded, and its digest is of its bytes."""

import os
import shutil
import time
from pathlib import Path

import numpy as np
import pytest
from asset_geometry import GROUPS, PARTED_GROUPS
from object_folders import (
    ASSETS,
    BUILTIN,
    MESH,
    TOML,
    UNMARKED_MESH,
    UNMARKED_TOML,
    H,
    edited,
    every_builtin,
    toml_of,
)
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from symsol_annot.errors import ObjectError, SymsolError, UnknownObjectError
from symsol_annot.objects.spec import PUBLISHED_NAMES, builtin_names, load_object, read_object
from symsol_annot.rotations.groups import GROUP_KINDS, GroupKind, cyclic_group


def same_set(found, expected):
    distances = cKDTree(found.reshape(-1, 9)).query(expected.reshape(-1, 9))[0]
    return len(found) == len(expected) and distances.max() < 1e-9


def test_builtin_objects_are_these():
    assert builtin_names() == BUILTIN


@pytest.mark.parametrize("name", GROUPS | PARTED_GROUPS)
def test_a_builtin_object_has_its_bodys_group(name):
    group = load_object(name).symmetry_group
    assert same_set(group, Rotation.create_group((GROUPS | PARTED_GROUPS)[name], axis="Z").as_matrix())
    np.testing.assert_array_equal(group[0], np.eye(3))


@every_builtin
def test_a_builtin_object_is_loaded_under_its_own_name(name):
    spec = load_object(name)
    assert (spec.name, spec.folder) == (name, ASSETS / name)
    assert spec.title


@pytest.mark.parametrize(("name", "order", "tolerance_px"), [("tetX", 3, 5.0), ("cylO", 1, 0.125)])
def test_a_marked_object_has_a_stabiliser_and_a_tolerance(name, order, tolerance_px):
    spec = load_object(name)
    turns = Rotation.from_rotvec(np.outer(np.arange(order) * 2 * np.pi / order, [H, H, H])).as_matrix()
    assert same_set(spec.stabiliser, turns)
    assert spec.marking.tolerance_px == tolerance_px
    assert spec.cosets.shape == (len(spec.symmetry_group) // order, order)


@pytest.mark.parametrize("name", ["tet", "cube", "icosa", "cone", "cyl"])
def test_an_unmarked_object_is_one_coset_of_all_of_its_group(name):
    spec = load_object(name)
    assert spec.marking is None
    assert not spec.mesh.is_marking.any()
    np.testing.assert_array_equal(spec.stabiliser, spec.symmetry_group)
    np.testing.assert_array_equal(spec.cosets, [np.arange(len(spec.symmetry_group))])


@pytest.mark.parametrize(
    ("name", "nearest"), [("cyl0", "cylO"), ("tetx", "tetX"), ("CUBE", "cube"), ("icosah", "icosa")]
)
def test_an_unknown_name_is_answered_with_the_nearest(name, nearest):
    with pytest.raises(UnknownObjectError) as caught:
        load_object(name)
    message = str(caught.value)
    assert message.startswith(f"unknown object {name!r}. Did you mean ")
    assert repr(nearest) in message.split("?", maxsplit=1)[0]


def test_an_unknown_name_is_answered_with_all_names_and_no_wild_guess():
    with pytest.raises(UnknownObjectError) as caught:
        load_object("quaternion")
    message = str(caught.value)
    assert "Did you mean" not in message
    assert ", ".join(BUILTIN) in message


def test_a_path_that_is_no_folder_is_an_unknown_object(write):
    folder = write()
    for path in (folder / "object.toml", folder / "missing"):
        with pytest.raises(UnknownObjectError, match="is given by the path of its folder"):
            load_object(str(path))


def test_an_unknown_object_is_an_object_error():
    assert issubclass(UnknownObjectError, ObjectError)
    assert issubclass(ObjectError, SymsolError)


@every_builtin
def test_a_renamed_copy_of_a_builtin_folder_is_an_object_like_any_other(name, tmp_path):
    folder = Path(shutil.copytree(ASSETS / name, tmp_path / "my object"))
    toml = folder / "object.toml"
    toml.write_text(edited(toml.read_text(encoding="utf-8"), f'name = "{name}"', 'name = "mine"')[0], encoding="utf-8")
    copy, original = load_object(str(folder)), load_object(name)
    assert (copy.name, copy.title, copy.folder) == ("mine", original.title, folder)
    assert copy.digest != original.digest
    np.testing.assert_array_equal(copy.mesh.vertices, original.mesh.vertices)
    np.testing.assert_array_equal(copy.mesh.triangles, original.mesh.triangles)
    np.testing.assert_array_equal(copy.symmetry_group, original.symmetry_group)
    np.testing.assert_array_equal(copy.cosets, original.cosets)


def test_what_object_toml_declares_is_what_is_read(write):
    spec = read_object(write())
    assert (spec.name, spec.title) == ("mug", "a tetrahedron with one face coloured")
    assert spec.marking.tolerance_px == 2.5
    assert spec.cosets.shape == (4, 3)
    np.testing.assert_array_equal(spec.mesh.is_marking, [False, False, False, True])


def test_what_provenance_says_is_free(write):
    toml = TOML + 'year = 2021\nlist = [1, 2]\n[provenance.more]\nkind = "x"\n'
    assert read_object(write(toml)).name == "mug"


@pytest.mark.parametrize(
    ("table", "expected"),
    [
        ('kind = "octahedral"', "O"),
        ('kind = "icosahedral"', "I"),
        ('kind = "dihedral"\norder = 5', "D5"),
        ('kind = "cyclic"\norder = 1', "C1"),
        ('kind = "cyclic"\norder = 7\naxis = [0, 0, 0.5]', "C7"),
        ('kind = "cyclic"\norder = 3600', "C3600"),
    ],
)
def test_a_group_is_named_by_kind_order_and_axis(write, table, expected):
    toml = UNMARKED_TOML.replace('kind = "tetrahedral"', table)
    group = read_object(write(toml, UNMARKED_MESH)).symmetry_group
    assert same_set(group, Rotation.create_group(expected, axis="Z").as_matrix())


@pytest.mark.parametrize("name", ["a", "9", "Mug-2_b", "x" * 60])
def test_a_name_may_hold_letters_digits_underscores_and_hyphens(write, name):
    assert read_object(write(TOML.replace('"mug"', f'"{name}"'))).name == name


@pytest.mark.parametrize("tolerance", ["5", "1e-3", "0.125"])
def test_a_tolerance_is_any_positive_number(write, tolerance):
    toml, _ = edited(TOML, "tolerance_px = 2.5", f"tolerance_px = {tolerance}")
    assert read_object(write(toml)).marking.tolerance_px == float(tolerance)


def test_any_byte_of_either_file_changes_the_digest(write):
    comment = "# abcdefgh\n"
    texts = {"toml": TOML + comment, "mesh": MESH + comment}
    digests = [read_object(write(**texts)).digest]
    for file, text in texts.items():
        changed = [text[:i] + "~" + text[i + 1 :] for i in range(len(text) - 9, len(text) - 1)]
        changed += [text[:-1], text + "\n", text.replace("\n", "\r\n"), text.replace("\n", " \n", 1), comment + text]
        digests += [read_object(write(**(texts | {file: new}))).digest for new in changed]
    assert len(set(digests)) == len(digests)


def test_the_digest_does_not_depend_on_where_the_folder_is(write, tmp_path):
    folder = write()
    copy = shutil.copytree(folder, tmp_path / "elsewhere")
    assert read_object(folder).digest == read_object(Path(copy)).digest


DIGESTS = dict(
    line.split()
    for line in """
cone ff7adf5dd172ca2089a1386f76861cb764626ab190857a4bfe9c9ea86bc82196
cube 43db92d3ef0c17a346acec9449cc6f9088644ddbeb412f831cd7f383bd0a3247
cyl 229e3403acd487145ef1282d1b9e310337443a2ec4f2f1f4916235784751934e
cylO 244496499e4f864ec37260d09c1ec1d196541fac6ac0410e84983cf4358ff4bc
icosa 93546342fdd5faf8837b578f2c7752a134fffe056b069f7aa1804e8a4c4cd1d6
tet 99f6ee6c2583e4510685ce5f8b99e04b06ee0459b0b93c69a9b541f94a533f47
tetX f5003003052ddf74d4ef05e135804705eaeaad9456e7d039590f288c6f131069
""".strip().splitlines()
)


@pytest.mark.parametrize("name", PUBLISHED_NAMES)
def test_a_published_objects_digest_is_that_of_the_published_sets(name):
    assert load_object(name).digest == DIGESTS[name]


def test_the_digest_is_of_the_bytes_that_were_parsed(write, monkeypatch):
    """Each file is opened once: what it becomes while the object is read is in neither object nor digest."""
    folder = write()
    before, opened = read_object(folder), []
    open_file = os.open

    def open_and_change(path, *rest, **options):
        descriptor = open_file(path, *rest, **options)
        if Path(path).parent == folder:
            opened.append(Path(path).name)
            Path(f"{path}.new").write_text("changed", encoding="utf-8")
            Path(f"{path}.new").replace(path)
        return descriptor

    monkeypatch.setattr(os, "open", open_and_change)
    assert read_object(folder).digest == before.digest
    assert opened == ["object.toml", "mesh.obj"]


def test_a_byte_order_mark_changes_the_digest_and_nothing_else(write):
    plain, marked = (read_object(write(data)) for data in (TOML.encode(), b"\xef\xbb\xbf" + TOML.encode()))
    assert (plain.name, plain.title) == (marked.name, marked.title)
    assert plain.digest != marked.digest


@pytest.mark.parametrize("length", [1e-9, 1e-3, 1e8])
def test_an_axis_of_any_length_within_that_is_the_same_axis(write, length):
    toml, _ = edited(TOML, "axis = [1, 1, 1]", f"axis = [{length!r}, {length!r}, {length!r}]")
    np.testing.assert_allclose(read_object(write(toml)).stabiliser, read_object(write()).stabiliser, atol=1e-12)


def test_the_largest_group_is_read_in_time(write):
    start = time.process_time()
    toml = toml_of('kind = "dihedral"\norder = 3600', 'kind = "cyclic"\norder = 1')
    assert read_object(write(toml, MESH)).cosets.shape == (7200, 1)
    assert time.process_time() - start < 10.0


@pytest.mark.parametrize(
    ("table", "order"),
    [('kind = "cyclic"\norder = 1', 1), ('kind = "dihedral"\norder = 2', 4), ('kind = "tetrahedral"', 12)],
)
def test_any_subgroup_of_the_bodys_group_is_read_as_a_stabiliser(write, table, order):
    spec = read_object(write(TOML.replace('kind = "cyclic"\norder = 3\naxis = [1, 1, 1]', table)))
    assert spec.cosets.shape == (12 // order, order)


def test_a_kind_added_to_the_table_is_read_with_its_parameters(write, monkeypatch):
    def turned_group(order, axis):
        return cyclic_group(order, axis)

    monkeypatch.setitem(GROUP_KINDS, "turned", GroupKind("turned", turned_group, needs=("order", "axis")))
    toml = UNMARKED_TOML.replace('kind = "tetrahedral"', 'kind = "turned"\norder = 3\naxis = [1, 1, 1]')
    group = read_object(write(toml, UNMARKED_MESH)).symmetry_group
    np.testing.assert_array_equal(group, cyclic_group(3, [1, 1, 1]))
    with pytest.raises(ObjectError, match=r"body\.group\.axis: is missing"):
        read_object(write(toml.replace("axis = [1, 1, 1]", ""), UNMARKED_MESH))
    with pytest.raises(ObjectError, match="icosahedral, turned, found 'turner'"):
        read_object(write(toml.replace("turned", "turner"), UNMARKED_MESH))
