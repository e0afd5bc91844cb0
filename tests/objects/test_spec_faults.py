"""Objects as data: files that are none, values that no object has, and parts that contradict each other."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from object_folders import (
    LINE_OF_KIND,
    MESH,
    REQUIRED,
    TOML,
    UNMARKED_MESH,
    UNMARKED_TOML,
    edited,
)

from symsol_annot.errors import ObjectError, UnknownObjectError
from symsol_annot.objects.spec import load_object, read_object
from symsol_annot.system.text.names import OBJECT_NAME_RULE


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


@pytest.mark.parametrize("title", ["", " ", "a\x1b[2Jb", "two\nlines", "\u202egum a", "x" * 201])
def test_a_title_is_printable_and_short(fault_of, title):
    toml, line = edited(TOML, REQUIRED["title"], f"title = {json.dumps(title)}")
    message, path = fault_of(toml)
    assert message.startswith(f"{path}, line {line}: title: expected 1 to 200 printable characters, found ")
    assert message.isprintable()


@pytest.mark.parametrize("axis", ["[1e-200, 0, 0]", "[5e-324, 0, 0]", "[1e308, 1e308, 0]", "[1e200, 0, 1]"])
def test_an_axis_whose_direction_is_lost_in_rounding_is_refused(fault_of, axis):
    toml, line = edited(TOML, "axis = [1, 1, 1]", f"axis = {axis}")
    message, path = fault_of(toml)
    assert message.startswith(
        f"{path}, line {line}: marking.stabiliser.axis: expected an axis of a length from 1e-09 to"
    )


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


@pytest.mark.parametrize("version", [0, 3, -1])
def test_another_format_version_is_refused(fault_of, version):
    toml, line = edited(TOML, "format_version = 1", f"format_version = {version}")
    message, path = fault_of(toml)
    assert message == f"{path}, line {line}: format_version: expected 1 or 2, found {version}"


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
    assert "format version 2" in message


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
