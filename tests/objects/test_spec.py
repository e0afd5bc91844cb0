"""Objects as data: what a folder declares is what is loaded, every fault is refused, and geometry must agree."""

import json
import os
import shutil
import subprocess
import sys
import time
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from symsol_annot.errors import ObjectError, SymsolError, UnknownObjectError
from symsol_annot.objects.check import check_object
from symsol_annot.objects.spec import builtin_names, load_object, read_object
from symsol_annot.rotations.groups import GROUP_KINDS, GroupKind, cyclic_group
from symsol_annot.system.text.names import OBJECT_NAME_RULE

BUILTIN = ("cone", "cube", "cyl", "cylO", "icosa", "tet", "tetX")
ASSETS = Path(str(resources.files("symsol_annot_assets")))
every_builtin = pytest.mark.parametrize("name", BUILTIN)

TOML = """\
format_version = 1
name = "mug"
title = "a tetrahedron with one face coloured"

[body.group]
kind = "tetrahedral"

[marking]
tolerance_px = 2.5
any_part_fixes_rotation = true

[marking.stabiliser]
kind = "cyclic"
order = 3
axis = [1, 1, 1]

[provenance]
anything = "goes"
"""
H = 1 / 3**0.5
TETRAHEDRON = [f"v {H} {H} {H}", f"v {H} -{H} -{H}", f"v -{H} {H} -{H}", f"v -{H} -{H} {H}"]
MESH = "\n".join([*TETRAHEDRON, "f 1 3 4", "f 1 4 2", "f 1 2 3", "usemtl marking", "f 2 4 3"]) + "\n"
UNMARKED_TOML = TOML.split("[marking]", maxsplit=1)[0]
UNMARKED_MESH = MESH.replace("usemtl marking\n", "")


@pytest.fixture
def write(tmp_path):
    """Write an object's folder and return it."""

    def write_object(toml=TOML, mesh=MESH):
        folder = tmp_path / "object"
        folder.mkdir(exist_ok=True)
        (folder / "object.toml").write_bytes(toml if isinstance(toml, bytes) else toml.encode())
        (folder / "mesh.obj").write_bytes(mesh if isinstance(mesh, bytes) else mesh.encode())
        return folder

    return write_object


@pytest.fixture
def fault_of(write):
    """Return the message that an object.toml is refused with, and the path that it must name."""

    def message(toml, mesh=MESH):
        folder = write(toml, mesh)
        with pytest.raises(ObjectError) as caught:
            read_object(folder)
        return str(caught.value), str(folder / "object.toml")

    return message


def edited(text, old, new):
    """Replace a line that the text holds once; also return its number."""
    lines = text.splitlines()
    (index,) = [i for i, line in enumerate(lines) if line == old]
    lines[index] = new
    return "\n".join(lines) + "\n", index + 1


def same_set(found, expected):
    distances = cKDTree(found.reshape(-1, 9)).query(expected.reshape(-1, 9))[0]
    return len(found) == len(expected) and distances.max() < 1e-9


# --- built-in objects ---


def test_builtin_objects_are_these():
    assert builtin_names() == BUILTIN


GROUPS = {"tet": "T", "tetX": "T", "cube": "O", "icosa": "I", "cone": "C360", "cyl": "D360", "cylO": "D360"}


@every_builtin
def test_a_builtin_object_has_its_bodys_group(name):
    group = load_object(name).symmetry_group
    assert same_set(group, Rotation.create_group(GROUPS[name], axis="Z").as_matrix())
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


# --- objects of one's own ---


@every_builtin
def test_a_renamed_copy_of_a_builtin_folder_is_an_object_like_any_other(name, tmp_path):
    folder = Path(shutil.copytree(ASSETS / name, tmp_path / "my object"))
    toml = folder / "object.toml"
    toml.write_text(edited(toml.read_text(encoding="utf-8"), f'name = "{name}"', 'name = "mug"')[0], encoding="utf-8")
    copy, original = load_object(str(folder)), load_object(name)
    assert (copy.name, copy.title, copy.folder) == ("mug", original.title, folder)
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


# --- the digest ---


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


@every_builtin
def test_a_builtin_objects_digest_is_that_of_the_published_sets(name):
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


# --- files that are none, and files that were made to do harm ---


@pytest.mark.parametrize("file", ["object.toml", "mesh.obj"])
@pytest.mark.parametrize(
    ("put", "said"),
    [
        (os.mkfifo, "is no regular file"),
        (lambda path: path.symlink_to("/dev/zero"), "is no regular file"),
        (Path.mkdir, "is a folder, where a file belongs"),
        (lambda path: path.symlink_to("nowhere"), "no such file; an object is a folder with"),
        (lambda path: path.symlink_to(path), "Too many levels of symbolic links"),
        (lambda path: path.touch() or os.truncate(path, 2**33), "is larger than the"),
    ],
    ids=["a FIFO", "a device", "a folder", "a link to nowhere", "a link to itself", "8 GB"],
)
def test_what_is_no_file_of_an_objects_is_refused_without_waiting(write, file, put, said):
    folder = write()
    (folder / file).unlink()
    put(folder / file)
    with pytest.raises(ObjectError) as caught:
        read_object(folder)
    assert str(caught.value).startswith(f"{folder / file}: ")
    assert said in str(caught.value)


@pytest.mark.skipif(not shutil.which("setpriv") or os.getuid() != 0, reason="root drops its privileges here")
def test_what_may_not_be_read_is_an_object_error_that_says_so(write, tmp_path):
    folder = write()
    for above in [*folder.parents][:-2]:  # up to /tmp, which all may enter
        above.chmod(above.stat().st_mode | 0o055)
    (folder / "mesh.obj").chmod(0)
    closed = tmp_path / "closed"
    closed.mkdir(mode=0o700)
    code = (
        "import sys; from symsol_annot.errors import ObjectError; from symsol_annot.objects.spec import load_object\n"
        "for path in sys.argv[1:]:\n try: load_object(path)\n except ObjectError as error: print(error)"
    )
    words = ["setpriv", "--reuid=65534", "--clear-groups", sys.executable, "-c", code]
    done = subprocess.run([*words, folder, closed / "mug"], capture_output=True, text=True, check=False)
    assert done.stdout.splitlines() == [
        f"{folder / 'mesh.obj'}: cannot be read: Permission denied",
        f"{closed / 'mug'}: cannot be read: Permission denied",
    ]


def test_a_name_that_can_be_no_path_is_an_unknown_object(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("", "x" * 5000, "a\0b", "\x1b[2J"):
        with pytest.raises(UnknownObjectError) as caught:
            load_object(name)
        assert str(caught.value).isprintable()
        assert len(str(caught.value)) < 6000
    with pytest.raises(ObjectError, match=r"^object.toml: no such file"):
        load_object(".")


HUGE = {
    "a number of 10^5 digits": "9" * 50_000,
    "a hexadecimal one": f"0x{'f' * 60_000}",
    "beyond 64 bits": str(2**63),
    "nested lists": "[" * 30_000,
    "nested tables": "{a=" * 20_000,
    "lists 40 deep": "[" * 40 + "]" * 40,
    "a key 40 deep": "{" + ".".join("a" * 40) + " = 1}",
}


@pytest.mark.parametrize("value", HUGE.values(), ids=HUGE)
@pytest.mark.parametrize("field", ["format_version", "marking.tolerance_px", "marking.stabiliser.order", "provenance"])
def test_numbers_and_nests_without_end_are_one_short_error(fault_of, field, value):
    key = field.rpartition(".")[2]
    old = next((line for line in TOML.splitlines() if line.startswith(f"{key} = ")), 'anything = "goes"')
    message, path = fault_of(edited(TOML, old, f"{key} = {value}")[0])
    assert message.startswith(path)
    assert len(message) < 500


SLOW = {
    "a key of 10,000 parts": ".".join("a" * 10_000) + " = 1\n",
    "many keys of 100 parts": "".join(f"{'.'.join('a' * 99)}.b{i} = 1\n" for i in range(5000)),
    "many tables": "[[a]]\n" * 170_000,
    "a megabyte of nothing": "\n" * 2**20,
    "64 KiB of keys": "".join(f"k{i:04} = 1\n" for i in range(6500)),
    "64 KiB of keys of 100 parts": "".join(f"{'.'.join('a' * 99)}.b{i} = 1\n" for i in range(300)),
}


@pytest.mark.parametrize("text", SLOW.values(), ids=SLOW)
def test_a_toml_that_takes_tomllib_for_ever_is_refused_in_time(fault_of, text):
    start = time.process_time()
    message, _ = fault_of(f"{text}{TOML}")
    assert time.process_time() - start < 10.0
    assert len(message) < 1000


@pytest.mark.parametrize("title", ["", " ", "a\x1b[2Jb", "two\nlines", "\u202egum a", "x" * 201])
def test_a_title_is_printable_and_short(fault_of, title):
    toml, line = edited(TOML, REQUIRED["title"], f"title = {json.dumps(title)}")
    message, path = fault_of(toml)
    assert message.startswith(f"{path}, line {line}: title: expected 1 to 200 printable characters, found ")
    assert message.isprintable()


@pytest.mark.parametrize(
    "table", ['["body.group"]\nkind = "cyclic"', '["marking"."stabiliser.order"]', "[lights]", "[a.b]"]
)
def test_a_table_that_nobody_reads_is_refused_though_it_looks_like_one(fault_of, table):
    message, _ = fault_of(f"{TOML}\n{table}\n")
    assert message.endswith("is not a field of an object.toml")


def test_a_byte_order_mark_changes_the_digest_and_nothing_else(write):
    plain, marked = (read_object(write(data)) for data in (TOML.encode(), b"\xef\xbb\xbf" + TOML.encode()))
    assert (plain.name, plain.title) == (marked.name, marked.title)
    assert plain.digest != marked.digest


@pytest.mark.parametrize("axis", ["[1e-200, 0, 0]", "[5e-324, 0, 0]", "[1e308, 1e308, 0]", "[1e200, 0, 1]"])
def test_an_axis_whose_direction_is_lost_in_rounding_is_refused(fault_of, axis):
    toml, line = edited(TOML, "axis = [1, 1, 1]", f"axis = {axis}")
    message, path = fault_of(toml)
    assert message.startswith(
        f"{path}, line {line}: marking.stabiliser.axis: expected an axis of a length from 1e-09 to"
    )


@pytest.mark.parametrize("length", [1e-9, 1e-3, 1e8])
def test_an_axis_of_any_length_within_that_is_the_same_axis(write, length):
    toml, _ = edited(TOML, "axis = [1, 1, 1]", f"axis = [{length!r}, {length!r}, {length!r}]")
    np.testing.assert_allclose(read_object(write(toml)).stabiliser, read_object(write()).stabiliser, atol=1e-12)


def test_the_largest_group_is_read_in_time(write):
    start = time.process_time()
    toml = toml_of('kind = "dihedral"\norder = 3600', 'kind = "cyclic"\norder = 1')
    assert read_object(write(toml, MESH)).cosets.shape == (7200, 1)
    assert time.process_time() - start < 10.0


def test_a_marking_too_fine_to_be_checked_is_refused_with_how_fine_it_may_be(write):
    folder = write(toml_of(*2 * ['kind = "cyclic"\norder = 3600']), finely_marked(3600))
    with pytest.raises(ObjectError, match=r"has 3,598 triangles, too many .* 3,600 rotations; simplify it to 1,864"):
        check_object(read_object(folder))


# --- faults of object.toml ---


def test_a_syntax_error_names_its_line(fault_of):
    toml, line = edited(TOML, "tolerance_px = 2.5", "tolerance_px = = 2.5")
    message, path = fault_of(toml)
    assert message.startswith(f"{path}: is no valid TOML: ")
    assert f"line {line}" in message


def test_a_field_that_is_there_twice_is_a_syntax_error(fault_of):
    toml, line = edited(TOML, 'name = "mug"', 'name = "mug"\nname = "cup"')
    message, path = fault_of(toml)
    assert message.startswith(f"{path}: is no valid TOML: ")
    assert f"line {line + 1}" in message


def test_a_toml_that_is_not_utf_8_is_refused(fault_of):
    message, path = fault_of(TOML.encode() + b"# caf\xe9\n")
    assert message.startswith(f"{path}: cannot be read: 'utf-8' codec")


@pytest.mark.parametrize("file", ["object.toml", "mesh.obj"])
def test_a_missing_file_is_named(write, file):
    folder = write()
    (folder / file).unlink()
    with pytest.raises(ObjectError) as caught:
        read_object(folder)
    expected = f"{folder / file}: no such file; an object is a folder with object.toml and mesh.obj"
    assert str(caught.value) == expected


def test_a_fault_of_the_mesh_is_a_fault_of_the_object(write):
    with pytest.raises(ObjectError, match=r"mesh\.obj, line 1: unknown statement 'wertex'"):
        read_object(write(mesh="wertex 1 2 3\n" + MESH))


LINE_OF_KIND = {"body.group.kind": 'kind = "tetrahedral"', "marking.stabiliser.kind": 'kind = "cyclic"'}
REQUIRED = {
    "format_version": "format_version = 1",
    "name": 'name = "mug"',
    "title": 'title = "a tetrahedron with one face coloured"',
    "marking.tolerance_px": "tolerance_px = 2.5",
    "marking.any_part_fixes_rotation": "any_part_fixes_rotation = true",
    "marking.stabiliser.order": "order = 3",
} | LINE_OF_KIND


@pytest.mark.parametrize("field", REQUIRED)
def test_a_missing_field_is_named_without_the_line_of_another(fault_of, field):
    toml, _ = edited(TOML, REQUIRED[field], "")
    message, path = fault_of(toml)
    assert message == f"{path}: {field}: is missing"


def test_a_missing_order_is_not_blamed_on_the_other_groups_order(fault_of):
    toml = TOML.replace('kind = "tetrahedral"', 'kind = "cyclic"\norder = 12').replace("order = 3\n", "")
    message, path = fault_of(toml)
    assert message == f"{path}: marking.stabiliser.order: is missing"


@pytest.mark.parametrize("table", ["[body.group]", "[marking.stabiliser]"])
def test_a_missing_table_is_named_by_its_first_field(fault_of, table):
    message, path = fault_of(TOML.replace(table, "[provenance.moved]"))
    assert message.startswith(path)
    assert message.endswith(f": {table.strip('[]')}.kind: is missing")


@pytest.mark.parametrize(
    ("field", "value", "expected"),
    [
        ("format_version", '"1"', "a whole number, found '1'"),
        ("format_version", "1.0", "a whole number, found 1.0"),
        ("format_version", "true", "a whole number, found True"),
        ("name", "3", "a string, found 3"),
        ("name", '["mug"]', "a string, found ['mug']"),
        ("title", "false", "a string, found False"),
        ("title", '{ en = "mug" }', "a string, found {'en': 'mug'}"),
        ("marking.tolerance_px", '"5"', "a number, found '5'"),
        ("marking.tolerance_px", "true", "a number, found True"),
        ("marking.tolerance_px", "[5]", "a number, found [5]"),
        ("marking.any_part_fixes_rotation", "1", "true or false, found 1"),
        ("marking.any_part_fixes_rotation", '"true"', "true or false, found 'true'"),
        ("marking.stabiliser.order", "3.0", "a whole number, found 3.0"),
        ("marking.stabiliser.order", "true", "a whole number, found True"),
        ("marking.stabiliser.axis", '"z"', "a list, found 'z'"),
        ("marking.stabiliser.axis", "1", "a list, found 1"),
    ],
)
def test_a_field_of_the_wrong_type_is_named_with_its_line(fault_of, field, value, expected):
    key = field.rsplit(".", 1)[-1]
    (old,) = [line for line in TOML.splitlines() if line.startswith(f"{key} = ")]
    toml, line = edited(TOML, old, f"{key} = {value}")
    message, path = fault_of(toml)
    assert message == f"{path}, line {line}: {field}: expected {expected}"


@pytest.mark.parametrize("field", LINE_OF_KIND)
def test_a_fault_of_a_key_that_stands_in_two_tables_is_named_with_its_own_line(fault_of, field):
    toml, line = edited(TOML, LINE_OF_KIND[field], "kind = 3")
    message, path = fault_of(toml)
    assert message == f"{path}, line {line}: {field}: expected a string, found 3"


@pytest.mark.parametrize(
    ("old", "new", "field"),
    [
        ('name = "mug"', 'name = "mug"\ntitel = "a mug"', "titel"),
        ("any_part_fixes_rotation = true", "any_part_fixes_rotation = true\ntolerance = 3", "marking.tolerance"),
        ("order = 3", "order = 3\nangle_deg = 120", "marking.stabiliser.angle_deg"),
        ("[marking]", "order_of_group = 12\n[marking]", "body.group.order_of_group"),
        ("[provenance]", '[lights]\nsun = "on"\n[provenance]', "lights.sun"),
    ],
)
def test_a_field_that_nobody_reads_is_named_with_its_line(fault_of, old, new, field):
    toml, _ = edited(TOML, old, new)
    key = field.rsplit(".", 1)[-1]
    (line,) = [n for n, text in enumerate(toml.splitlines(), start=1) if text.startswith(f"{key} = ")]
    message, path = fault_of(toml)
    assert message == f"{path}, line {line}: {field}: is not a field of an object.toml"


@pytest.mark.parametrize("key", ["a(", "c++", "[", "\\\\"])
def test_a_quoted_key_of_any_characters_is_refused_like_any_other(fault_of, key):
    toml, _ = edited(TOML, 'name = "mug"', f'name = "mug"\n"{key}" = 1')
    message, _ = fault_of(toml)
    assert message.endswith(": is not a field of an object.toml")


@pytest.mark.parametrize(
    "table",
    ['kind = "tetrahedral"\norder = 12', 'kind = "dihedral"\norder = 3\naxis = [0, 0, 1]'],
    ids=["order of a finite group", "axis of a dihedral group"],
)
def test_a_field_that_does_not_belong_to_the_kind_of_group_is_refused(fault_of, table):
    message, path = fault_of(UNMARKED_TOML.replace('kind = "tetrahedral"', table), UNMARKED_MESH)
    extra = table.rsplit("\n", 1)[-1].split()[0]
    assert message.startswith(f"{path}, line ")
    assert message.endswith(f": body.group.{extra}: is not a field of an object.toml")


@pytest.mark.parametrize("version", [0, 2, -1])
def test_another_format_version_is_refused(fault_of, version):
    toml, line = edited(TOML, "format_version = 1", f"format_version = {version}")
    message, path = fault_of(toml)
    assert message == f"{path}, line {line}: format_version: expected 1, found {version}"


@pytest.mark.parametrize("name", ["", "a b", "../mug", "-mug", "_mug", "a/b", "mug.h5", "café", "mug\n", "x" * 65, "٣"])
def test_a_name_that_no_file_should_have_is_refused(fault_of, name):
    toml, line = edited(TOML, 'name = "mug"', f"name = {json.dumps(name)}")
    message, path = fault_of(toml)
    assert message == f"{path}, line {line}: name: expected {OBJECT_NAME_RULE}, found {name!r}"


@pytest.mark.parametrize("field", LINE_OF_KIND)
def test_a_kind_of_group_that_does_not_exist_is_refused_with_those_that_do(fault_of, field):
    toml, line = edited(TOML, LINE_OF_KIND[field], 'kind = "spherical"')
    message, path = fault_of(toml)
    kinds = "cyclic, dihedral, tetrahedral, octahedral, icosahedral"
    assert message == f"{path}, line {line}: {field}: expected one of {kinds}, found 'spherical'"


@pytest.mark.parametrize("order", [0, -3, 3601])
def test_an_order_is_at_least_1_and_not_huge(fault_of, order):
    toml, line = edited(TOML, "order = 3", f"order = {order}")
    message, path = fault_of(toml)
    assert message == f"{path}, line {line}: marking.stabiliser.order: expected 1 to 3600, found {order}"


@pytest.mark.parametrize(
    "axis",
    ["[0, 0, 0]", "[0.0, -0.0, 0]", "[1, 1]", "[]", "[0, 0, 1, 0]", '["x", "y", "z"]', "[[1], [1], [1]]"],
)
def test_an_axis_is_three_numbers_that_are_not_all_0(fault_of, axis):
    toml, line = edited(TOML, "axis = [1, 1, 1]", f"axis = {axis}")
    message, path = fault_of(toml)
    assert message.startswith(f"{path}, line {line}: marking.stabiliser.axis: expected three ")


@pytest.mark.parametrize("axis", ["[nan, 0, 1]", "[inf, 0, 1]", "[0, -inf, 0]", "[true, true, true]"])
def test_an_axis_is_finite_and_no_truth_value(fault_of, axis):
    toml = UNMARKED_TOML.replace('kind = "tetrahedral"', f'kind = "cyclic"\norder = 3\naxis = {axis}')
    message, path = fault_of(toml, UNMARKED_MESH)
    assert message.startswith(f"{path}, line 8: body.group.axis: expected three ")


@pytest.mark.parametrize("tolerance", ["0", "0.0", "-0.0", "-1", "-0.125", "nan", "inf", "-inf", f"1{'0' * 400}.0"])
def test_a_tolerance_that_is_not_positive_and_finite_is_refused(fault_of, tolerance):
    toml, line = edited(TOML, "tolerance_px = 2.5", f"tolerance_px = {tolerance}")
    message, path = fault_of(toml)
    assert message.startswith(
        f"{path}, line {line}: marking.tolerance_px: expected a positive number of pixels, found "
    )


def test_a_marking_whose_parts_do_not_fix_the_rotation_is_refused(fault_of):
    toml, line = edited(TOML, "any_part_fixes_rotation = true", "any_part_fixes_rotation = false")
    message, path = fault_of(toml)
    assert message.startswith(f"{path}, line {line}: marking.any_part_fixes_rotation: is false, and such a marking ")
    assert "not supported yet" in message


def test_a_marking_table_needs_marked_faces(write):
    folder = write(TOML, UNMARKED_MESH)
    with pytest.raises(ObjectError) as caught:
        read_object(folder)
    assert str(caught.value).startswith(
        f"{folder}: mesh.obj has no face of the material 'marking', while object.toml has a"
    )


def test_marked_faces_need_a_marking_table(write):
    folder = write(UNMARKED_TOML, MESH)
    with pytest.raises(ObjectError) as caught:
        read_object(folder)
    assert str(caught.value).startswith(
        f"{folder}: mesh.obj has a face of the material 'marking', while object.toml has no"
    )


@pytest.mark.parametrize(
    "table",
    [
        'kind = "cyclic"\norder = 4\naxis = [0, 0, 1]',
        'kind = "cyclic"\norder = 3\naxis = [0, 0, 1]',
        'kind = "cyclic"\norder = 6\naxis = [1, 1, 1]',
        'kind = "octahedral"',
        'kind = "dihedral"\norder = 4',
    ],
)
def test_a_stabiliser_from_outside_the_bodys_group_is_refused(fault_of, table):
    message, path = fault_of(TOML.replace('kind = "cyclic"\norder = 3\naxis = [1, 1, 1]', table))
    assert message.startswith(f"{path}: marking.stabiliser: is no subgroup of body.group: ")


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


# --- does the geometry have the declared symmetry? ---


def toml_of(group, stabiliser=None):
    text = f'format_version = 1\nname = "mug"\ntitle = "mug"\n[body.group]\n{group}\n'
    if stabiliser is None:
        return text
    return f"{text}[marking]\ntolerance_px = 5\nany_part_fixes_rotation = true\n[marking.stabiliser]\n{stabiliser}\n"


def prism(facets, axis="z", material_of_caps="body"):
    """A prism about an axis in the unit sphere, its caps regular polygons."""
    turns = np.arange(facets) * 2 * np.pi / facets
    x, y = 0.8 * np.cos(turns), 0.8 * np.sin(turns)
    vertices = np.concatenate([np.stack([x, y, np.full(facets, z)], axis=1) for z in (-0.6, 0.6)])
    if axis == "x":
        vertices = np.roll(vertices, 1, axis=1)
    lines = [f"v {x:.12f} {y:.12f} {z:.12f}" for x, y, z in vertices]
    for k in range(facets):
        following = (k + 1) % facets
        lines.append(f"f {k + 1} {following + 1} {following + 1 + facets} {k + 1 + facets}")
    lines.append(f"usemtl {material_of_caps}")
    lines.append("f " + " ".join(str(k + 1) for k in reversed(range(facets))))
    lines.append("f " + " ".join(str(k + 1 + facets) for k in range(facets)))
    return "\n".join(lines) + "\n"


def finely_marked(facets):
    """A cone whose base is marked: facets - 2 triangles of marking."""
    turns = np.arange(facets) * 2 * np.pi / facets
    lines = [f"v {0.8 * np.cos(t):.12f} {0.8 * np.sin(t):.12f} -0.6" for t in turns] + ["v 0 0 1"]
    lines += [f"f {k + 1} {(k + 1) % facets + 1} {facets + 1}" for k in range(facets)]
    return "\n".join([*lines, "usemtl marking", "f " + " ".join(str(k) for k in range(facets, 0, -1))]) + "\n"


CUBE_FACES = {
    "bottom": "f 1 4 3 2",
    "top": "f 5 6 7 8",
    "front": "f 1 2 6 5",
    "right": "f 2 3 7 6",
    "back": "f 3 4 8 7",
    "left": "f 4 1 5 8",
}


def cube(*marked):
    corners = [(-1, -1), (1, -1), (1, 1), (-1, 1)]
    lines = [f"v {x * H} {y * H} {z * H}" for z in (-1, 1) for x, y in corners]
    lines += [face for name, face in CUBE_FACES.items() if name not in marked]
    lines += ["usemtl marking", *(CUBE_FACES[name] for name in marked)] if marked else []
    return "\n".join(lines) + "\n"


OCTAHEDRAL, DIHEDRAL_360 = 'kind = "octahedral"', 'kind = "dihedral"\norder = 360'
QUARTER_TURNS, PRISM_4 = 'kind = "cyclic"\norder = 4', 'kind = "dihedral"\norder = 4'


@every_builtin
def test_the_check_accepts_every_builtin_object(name):
    check_object(load_object(name))


@pytest.mark.parametrize(
    ("mesh", "group"),
    [
        (prism(360), DIHEDRAL_360),
        (prism(720), DIHEDRAL_360),
        (prism(90), 'kind = "dihedral"\norder = 90'),
        (prism(90), 'kind = "dihedral"\norder = 45'),
        (prism(90, axis="x"), 'kind = "cyclic"\norder = 90\naxis = [1, 0, 0]'),
        (cube(), OCTAHEDRAL),
        (cube(), 'kind = "tetrahedral"'),
        (UNMARKED_MESH, 'kind = "tetrahedral"'),
    ],
    ids=[
        "prism 360",
        "prism 720",
        "prism 90",
        "part of a group",
        "about x",
        "cube",
        "cube's tetrahedral",
        "tetrahedron",
    ],
)
def test_the_check_accepts_a_group_that_the_surface_has(write, mesh, group):
    check_object(read_object(write(toml_of(group), mesh)))


@pytest.mark.parametrize(
    ("mesh", "group"),
    [
        (cube(), 'kind = "icosahedral"'),
        (cube(), 'kind = "dihedral"\norder = 8'),
        (cube(), 'kind = "cyclic"\norder = 3\naxis = [1, 1, 0]'),
        (UNMARKED_MESH, OCTAHEDRAL),
        (prism(90), DIHEDRAL_360),
        (prism(180), 'kind = "cyclic"\norder = 360'),
        (prism(90), OCTAHEDRAL),
        (prism(90, axis="x"), 'kind = "dihedral"\norder = 90'),
    ],
    ids=[
        "cube as icosahedron",
        "cube as octagon",
        "cube about a wrong axis",
        "tetrahedron as cube",
        "90 facets as 360",
        "180 facets as 360",
        "prism as cube",
        "prism about another axis",
    ],
)
def test_the_check_refuses_a_group_that_the_surface_lacks(write, mesh, group):
    folder = write(toml_of(group), mesh)
    with pytest.raises(ObjectError) as caught:
        check_object(read_object(folder))
    assert str(caught.value).startswith(f"{folder}: the surface of 'mug' is not invariant under body.group: ")


def test_the_check_refuses_a_flip_that_the_cone_lacks(write):
    mesh = (ASSETS / "cone" / "mesh.obj").read_text(encoding="utf-8")
    with pytest.raises(ObjectError, match="is not invariant under body"):
        check_object(read_object(write(toml_of(DIHEDRAL_360), mesh)))


@pytest.mark.parametrize(
    ("mesh", "group", "stabiliser"),
    [
        (cube("top"), OCTAHEDRAL, QUARTER_TURNS),
        (cube("top", "bottom"), OCTAHEDRAL, PRISM_4),
        (cube("front", "left"), OCTAHEDRAL, 'kind = "cyclic"\norder = 2\naxis = [1, 1, 0]'),
        (cube(*CUBE_FACES), OCTAHEDRAL, OCTAHEDRAL),
        (prism(360, material_of_caps="marking"), DIHEDRAL_360, DIHEDRAL_360),
    ],
    ids=["a face", "two opposite faces", "two faces that meet", "all faces", "both caps of a cylinder"],
)
def test_the_check_accepts_the_stabiliser_that_the_marking_has(write, mesh, group, stabiliser):
    check_object(read_object(write(toml_of(group, stabiliser), mesh)))


@pytest.mark.parametrize(
    ("mesh", "group", "stabiliser"),
    [
        (MESH, 'kind = "tetrahedral"', 'kind = "cyclic"\norder = 1'),
        (cube("top"), OCTAHEDRAL, 'kind = "cyclic"\norder = 2'),
        (cube("top", "bottom"), OCTAHEDRAL, QUARTER_TURNS),
        (prism(360, material_of_caps="marking"), DIHEDRAL_360, 'kind = "cyclic"\norder = 360'),
    ],
    ids=["tetrahedron's face", "cube's face", "two opposite faces", "both caps"],
)
def test_the_check_refuses_a_stabiliser_that_is_declared_too_small(write, mesh, group, stabiliser):
    folder = write(toml_of(group, stabiliser), mesh)
    with pytest.raises(ObjectError) as caught:
        check_object(read_object(folder))
    assert str(caught.value).startswith(f"{folder}: ")
    assert str(caught.value).endswith("the stabiliser is larger than declared")


@pytest.mark.parametrize(
    ("mesh", "group", "stabiliser"),
    [
        (MESH, 'kind = "tetrahedral"', 'kind = "tetrahedral"'),
        (MESH, 'kind = "tetrahedral"', 'kind = "cyclic"\norder = 3\naxis = [-1, 1, 1]'),
        (cube("top"), OCTAHEDRAL, PRISM_4),
        (cube("top"), OCTAHEDRAL, f"{QUARTER_TURNS}\naxis = [1, 0, 0]"),
    ],
    ids=["all of the tetrahedron's", "another face's", "with the flip", "about another axis"],
)
def test_the_check_refuses_a_stabiliser_that_moves_the_marking(write, mesh, group, stabiliser):
    folder = write(toml_of(group, stabiliser), mesh)
    with pytest.raises(ObjectError) as caught:
        check_object(read_object(folder))
    assert str(caught.value).startswith(f"{folder}: marking.stabiliser moves the marking of 'mug' ")
