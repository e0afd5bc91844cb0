"""The fields of an object.toml: every fault is one short error that names its field and line."""

import time

import pytest
from object_folders import (
    LINE_OF_KIND,
    REQUIRED,
    TOML,
    UNMARKED_MESH,
    UNMARKED_TOML,
    edited,
)

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


@pytest.mark.parametrize(
    "table", ['["body.group"]\nkind = "cyclic"', '["marking"."stabiliser.order"]', "[lights]", "[a.b]"]
)
def test_a_table_that_nobody_reads_is_refused_though_it_looks_like_one(fault_of, table):
    message, _ = fault_of(f"{TOML}\n{table}\n")
    assert message.endswith("is not a field of an object.toml")


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
