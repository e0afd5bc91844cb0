"""Scoring from outside imports neither torch nor roma nor Blender."""

import os
import sys

import h5py
import pytest
from bench_sets import SUPPORT, run

FORBIDDEN = ("torch", "roma", "bpy")
WITH_A_GUARD = f"""
import sys

class Guard:
    @staticmethod
    def find_spec(name, path=None, target=None):
        if name.partition(".")[0] in {FORBIDDEN}:
            raise SystemExit(f"{{name}} was imported")

sys.meta_path.insert(0, Guard)
"""
GUARDED_MAIN = f"""{WITH_A_GUARD}
import atexit
from symsol_annot_cli.main import main
try:
    main()
finally:
    print([name for name in {FORBIDDEN} if name in sys.modules], file=sys.stderr)
"""
GUARDED_WRITING = f"""{WITH_A_GUARD}
import numpy as np
import symsol_annot
from symsol_annot.bench.predictions.writing.submission import write_classifier, write_density, write_hypotheses
test = symsol_annot.load(sys.argv[1])
write_hypotheses(sys.argv[2], test, lambda i: test[i].rotation[None], method="mine")
write_classifier(sys.argv[2], test, lambda i, R: np.zeros(len(R)), method="mine", level=0)
write_density(sys.argv[2], test, lambda i, R: R[:, 0, 0], method="mine", level=0)
print([name for name in {FORBIDDEN} if name in sys.modules], file=sys.stderr)
"""


@pytest.fixture
def guarded(tmp_path):
    """Runs Python where importing one of these ends the process, in whatever process; the modules are there."""
    trap = tmp_path / "trap"
    trap.mkdir()
    for name in FORBIDDEN:
        (trap / f"{name}.py").write_text(f"raise SystemExit('{name} was imported')")
    path = os.pathsep.join(filter(None, [str(trap), str(SUPPORT), os.environ.get("PYTHONPATH")]))

    def call(code, *arguments):
        return run(sys.executable, "-c", code, *arguments, env={"PYTHONPATH": path})

    return call


@pytest.mark.parametrize("name", FORBIDDEN)
def test_the_guard_sees_what_is_imported(guarded, name):
    assert guarded(f"{WITH_A_GUARD}\nimport {name}").stderr == f"{name} was imported\n"
    assert guarded(f"import {name}").stderr == f"{name} was imported\n"


def test_scoring_validating_and_comparing_import_neither_torch_nor_roma_nor_blender(preds, data, guarded, tmp_path):
    for words in (
        ["score", preds["tetX"], "--data", data, "--json", tmp_path / "s.json", "--per-image", tmp_path / "i.csv"],
        ["validate", preds["tetX"], "--data", data],
        ["compare", tmp_path / "s.json", tmp_path / "s.json"],
    ):
        done = guarded(GUARDED_MAIN, *words)
        assert (done.returncode, done.stderr) == (0, "[]\n")
        assert done.stdout != ""


def test_writing_predictions_imports_neither_torch_nor_roma_nor_blender(sets, guarded, tmp_path):
    done = guarded(GUARDED_WRITING, sets["cylO"].folder, tmp_path / "preds.h5")
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "[]\n")
    with h5py.File(tmp_path / "preds.h5") as file:
        assert {"hypotheses", "query_probability", "density_offsets"} <= set(file)
