"""Names are names: what may stand in a path, a link or a line on a terminal, and nothing that leads elsewhere."""

import string

import pytest
from hypothesis import given
from hypothesis import strategies as st

from symsol_annot.sets.manifest import SPLITS as MANIFEST_SPLITS
from symsol_annot.system.text.names import SPLITS, is_method_name, is_object_name, is_split

NO_TEXT = [None, 0, 1, True, 1.5, b"tet", [], ["tet"], ("tet",), {}, {"tet": 1}, object()]


@pytest.mark.parametrize("name", ["tet", "tetX", "cylO", "a", "0", "my-mug_2", "A" * 64, "con", "test", "0-", "x_"])
def test_letters_digits_and_two_marks_are_an_objects_name(name):
    assert is_object_name(name)


@pytest.mark.parametrize(
    "name",
    [
        "",
        ".",
        "..",
        "../tet",
        "/tmp/tet",
        "a/b",
        "a\\b",
        "C:tet",
        "~",
        "~root",
        "-tet",
        "_tet",
        ".tet",
        "tet.",
        "tet.h5",
        "a b",
        " tet",
        "tet ",
        "tet\n",
        "\ntet",
        "tet\0",
        "tet\x1b[2J",
        "tet\u202e",
        "tét",
        "٣",
        "\uff54et",
        "A" * 65,
        "$HOME",
        "`id`",
        "a;b",
        "%2e%2e",
        "a'b",
        '"',
        "<b>",
        "*",
    ],
)
def test_anything_else_is_none(name):
    assert not is_object_name(name)


@pytest.mark.parametrize("name", NO_TEXT)
def test_what_is_no_text_is_no_name(name):
    assert not is_object_name(name)
    assert not is_method_name(name)
    assert not is_split(name)


@given(st.text(max_size=70))
def test_objects_name_is_a_folders_name_that_leads_nowhere_else(name):
    if is_object_name(name):
        assert set(name) <= set(string.ascii_letters + string.digits + "_-")
        assert name[0] not in "-_"
        assert 0 < len(name) <= 64


@pytest.mark.parametrize(
    "name", ["x", "ours", "Müller et al. (2024)", "method / 2", "../x", "x" * 200, "a b", "<b>", "方法"]
)
def test_a_method_calls_itself_what_it_likes_where_that_can_be_printed(name):
    assert is_method_name(name)


@pytest.mark.parametrize(
    "name", ["", " ", "\t", "\u00a0", "x" * 201, "a\nb", "a\0", "\x1b[2J", "\u202eevil", "\u2028", "\ud800", "a\x7f"]
)
def test_a_method_without_a_printable_name_has_none(name):
    assert not is_method_name(name)


@given(st.text(max_size=220))
def test_methods_name_cannot_act_on_a_terminal(name):
    assert not is_method_name(name) or (name.isprintable() and name.strip())


def test_there_are_two_splits_and_each_reader_means_the_same():
    assert SPLITS == MANIFEST_SPLITS == ("train", "test")
    assert [name for name in ("train", "test", "Test", "val", "", "test ", "tes") if is_split(name)] == [
        "train",
        "test",
    ]
