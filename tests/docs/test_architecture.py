"""The page on the code says what the code is: its drawing, its tables, the files that it names."""

import ast
import re
from pathlib import Path

import pytest
import rooms

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs/architecture.md").read_text()
HEADING = re.compile(r"^### (\S+)(?: and \S+)?$\n\n(.+)$\n\n((?:^\|.*$\n)+)", flags=re.MULTILINE)


def tables():
    """Folder to the modules that its table names."""
    return {
        folder: [f"{folder}/{name}" for name in re.findall(r"^\| `(\S+\.py)` ", rows, flags=re.MULTILINE)]
        for folder, _, rows in HEADING.findall(PAGE)
    }


def imported_by(path):
    """The files of the package that a file imports, by its lines of import alone."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("symsol_annot"):
            for name in (node.module, *(f"{node.module}.{alias.name}" for alias in node.names)):
                file = ROOT / (name.replace(".", "/").replace("symsol_annot_cli", "cli") + ".py")
                if file.is_file():
                    yield file


def test_the_drawing_and_the_tables_are_those_of_the_code():
    """If this fails: .venv/bin/python docs/rooms.py."""
    assert rooms.drawing(rooms.imports_of_rooms()) == (ROOT / "docs/images/rooms.svg").read_text()
    assert rooms.tables() in PAGE


def test_every_module_stands_once_in_the_page_and_no_other():
    there = [p for folder in ("symsol_annot", "cli") for p in (ROOT / folder).rglob("*.py") if p.name != "__init__.py"]
    listed = [name for names in tables().values() for name in names]
    assert sorted(listed) == sorted(path.relative_to(ROOT).as_posix() for path in there)


def test_rooms_stand_after_all_that_their_modules_import():
    place = {name: number for number, names in enumerate(tables().values()) for name in names}
    outside = {name for name in place if re.fullmatch(r"symsol_annot/(bench/)?\w+\.py", name)}
    late = [
        f"{name} imports {other.relative_to(ROOT)}"
        for name in place.keys() - outside
        for other in imported_by(ROOT / name)
        if place[other.relative_to(ROOT).as_posix()] > place[name] and other.name != "errors.py"
    ]
    assert late == []


@pytest.mark.parametrize("page", ["docs/architecture.md", "CONTRIBUTING.md"])
def test_files_that_the_pages_on_the_code_name_exist(page):
    text = (ROOT / page).read_text().split(rooms.BEGIN)[0]
    named = re.findall(r"`([\w./]+(?:/|\.(?:py|toml|md|json|svg)))`", text)
    assert len(named) > 10
    assert [name for name in named if not (_exists(name) or name.startswith(("build/", "dist/")))] == []


def _exists(name):
    return any((ROOT / top / name).exists() for top in ("", "symsol_annot", "symsol_annot/bench"))


def test_an_arrow_that_follows_from_others_is_left_out_of_the_drawing():
    imports = {"a": frozenset(), "b": frozenset("a"), "c": frozenset("ab"), "d": frozenset("a")}
    assert rooms.needed_arrows(imports) == [("b", "a"), ("c", "b"), ("d", "a")]
    drawn = rooms.drawing(imports)
    assert drawn.count("<polyline") == 3
    assert re.findall(r">(\w)</text>", drawn) == list("abcd")


def test_an_import_that_is_new_changes_the_drawing():
    imports = rooms.imports_of_rooms()
    assert "rotations" not in imports["system"]
    assert rooms.drawing({**imports, "system": frozenset({"rotations"})}) != rooms.drawing(imports)
