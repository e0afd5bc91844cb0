"""What is run by hand starts: each tool explains itself, and what it names in the package is there."""

import ast
import importlib.util
import json
import subprocess
import sys
from pathlib import Path

import mutations
import pytest
from attack.catalogue import KINDS
from made_sets import make_set

TOOLS = Path(__file__).resolve().parents[2] / "tools"
STARTED_BY_OTHERS = {"attack/worker.py"}  # a module of a package, which takes its words from attack/harness.py
RUN = sorted(
    path
    for path in TOOLS.rglob("*.py")
    if '\nif __name__ == "__main__":' in path.read_text() and str(path.relative_to(TOOLS)) not in STARTED_BY_OTHERS
)


@pytest.mark.parametrize("path", RUN, ids=lambda path: path.relative_to(TOOLS).as_posix())
def test_a_tool_explains_itself_and_does_nothing_else(path, tmp_path):
    """Called from anywhere; whoever asks for help waits for no proof, installation or benchmark."""
    words = [sys.executable, str(path.parent if path.name == "__main__.py" else path), "--help"]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("usage: ")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", KINDS)
def test_the_modules_that_an_attack_imports_once_are_there(name):
    modules = [f"symsol_annot.{module}" for module in KINDS[name].modules if module != "cli"]
    assert [module for module in modules if importlib.util.find_spec(module) is None] == []


def test_a_mutation_changes_the_expression_that_it_names_and_nothing_else(tmp_path, monkeypatch):
    monkeypatch.setattr(mutations, "PROJECT", tmp_path)
    path = tmp_path / "it.py"
    path.write_text(
        '"""It."""\n\n\n@cache(size=4)\n'
        'def sum_of(a: int = 1) -> "list[int]":\n    return [a + 2] if not a < 3 else [-a]\n'
    )
    whole = ast.unparse(ast.parse(path.read_text()))
    changes = {(m.before, m.after) for m in mutations.mutations_of(path)}
    assert changes == {
        ("1", "2"), ("2", "3"), ("3", "4"),
        ("a + 2", "a - 2"), ("a < 3", "a <= 3"), ("not a < 3", "a < 3"), ("-a", "a"),
    }  # fmt: skip
    for mutation in mutations.mutations_of(path):
        changed = mutations.mutated(path.read_text(), mutation.number)
        assert changed != whole
        assert changed == whole.replace(mutation.before, mutation.after, 1)


def test_the_mutations_of_a_seed_are_the_same_and_of_the_rooms_that_were_asked_for():
    drawn = mutations.drawn(["rotations"], 5, seed=1)
    assert drawn == mutations.drawn(["rotations"], 5, seed=1) != mutations.drawn(["rotations"], 5, seed=2)
    assert all(mutation.file.startswith("symsol_annot/rotations/") for mutation in drawn)
    file = "symsol_annot/rotations/spreading.py"
    of_file = mutations.drawn(mutations.TESTS, 1000, seed=0, files=[file])
    assert sorted(m.number for m in of_file) == [m.number for m in mutations.mutations_of(mutations.PROJECT / file)]
    for rooms, name in ((mutations.TESTS, "symsol_annot/errors.py"), (["annotation"], file), (["rotations"], "no.py")):
        with pytest.raises(SystemExit, match=f"{name}: no file of {', '.join(rooms)}"):
            mutations.drawn(rooms, 1, seed=0, files=[name])
    assert all((mutations.PROJECT / folder).is_dir() for folders in mutations.TESTS.values() for folder in folders)


def test_the_speed_of_a_training_is_measured_beside_the_bare_network(tmp_path):
    folder = make_set(tmp_path, train=160, test=0, size=16, annotate="all")
    words = [folder, "small-wta", "--rounds", "1", "--seconds", "0.1", "--json", tmp_path / "speed.json"]
    subprocess.run(
        [sys.executable, TOOLS / "perf" / "training.py", *words], check=True, capture_output=True, timeout=300
    )
    measured = json.loads((tmp_path / "speed.json").read_text())["small-wta"]
    assert set(measured["images_per_second"]) == {"training", "network alone"}
    assert 0.1 < measured["share"] < 3.0
