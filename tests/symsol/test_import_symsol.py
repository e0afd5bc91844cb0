"""The command `import-symsol`: what it says, what it leaves, and the page about it."""

import re
from pathlib import Path

import pytest
from imported_sets import imported

from symsol_annot.errors import OutputError, SettingsError


def test_the_command_imports_and_leaves_what_is_there(source, here, tmp_path):
    path, _, _ = source
    done = here("import-symsol", path, "--out", tmp_path / "sets", "--object", "cone", "--object", "tetX")
    assert done.returncode == 0
    assert "sets of 359 rotations (360 listed, 1 of them twice)" in done.stdout
    assert "tetX: 20 train, 6 test images, no symmetry sets are known" in done.stdout
    before = {name: path.stat().st_mtime_ns for name, path in _files(tmp_path).items()}
    again = here("import-symsol", path, "--out", tmp_path / "sets", "--object", "cone")
    assert "was there already" in again.stdout
    assert {name: path.stat().st_mtime_ns for name, path in _files(tmp_path).items()} == before


def test_the_lines_of_the_symsol_page_run(source, here, tmp_path, monkeypatch):
    page = (Path(__file__).parents[2] / "docs" / "symsol.md").read_text()
    commands, code = (text for text in re.findall(r"```(?:python)?\n(.*?)```", page, flags=re.DOTALL))
    (tmp_path / "symsol_dataset.zip").symlink_to(source[0])
    monkeypatch.chdir(tmp_path)
    for command in commands.strip().splitlines():
        assert here(*command.split()[1:]).returncode == 0
    names = {}
    exec(code, names)
    assert len(names["sample"].symmetry_set) == 718


def _files(folder):
    return {str(path.relative_to(folder)): path for path in folder.rglob("*") if path.is_file()}


def test_what_cannot_be_asked_is_said(source, here, tmp_path):
    path, _, _ = source
    with pytest.raises(SettingsError, match="has no cylO; it has tet, cone, cyl, tetX"):
        imported(path, tmp_path / "sets", "cylO")
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="is a file"):
        imported(path, tmp_path / "file", "tet")
    done = here("import-symsol", tmp_path / "file", "--out", tmp_path / "sets")
    assert (done.returncode, done.stdout) == (1, "")
    assert "File is not a zip file" in done.stderr
    assert not (tmp_path / "sets").exists()
