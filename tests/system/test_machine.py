"""Extras that are not installed: every command that needs one says so before it does anything."""

import sys
from importlib.metadata import requires

import pytest
from packaging.requirements import Requirement
from symsol_annot_cli.main import app

from symsol_annot.errors import MissingExtraError
from symsol_annot.system.machine import PACKAGES, check_extra

# A package that is missing, its extra, and a command line whose files are missing, too.
NEEDS = [
    ("matplotlib", "plot", "plot images nowhere"),
    ("matplotlib", "plot", "plot sets nowhere --out sets.png"),
    ("matplotlib", "plot", "plot slice nowhere --out slice.png"),
    ("matplotlib", "plot", "plot precision-recall nowhere --object tetX --out curve.png"),
    ("matplotlib", "plot", "plot coverage nowhere --object tetX --out coverage.png"),
    ("matplotlib", "plot", "plot losses --out nowhere/losses.png"),
    ("torch", "bench", "plot slice nowhere --out slice.png"),
    ("torch", "bench", "plot losses --out nowhere/losses.png"),
    ("torch", "bench", "train nowhere.toml --data nowhere"),
    ("torch", "bench", "predict nowhere"),
    ("roma", "bench", "predict nowhere"),
    ("safetensors", "bench", "train nowhere.toml"),
    ("pyarrow", "publish", "publish nowhere --out bundle"),
    ("plotly", "gallery", "gallery nowhere"),
    ("distributed", "cluster", "render --object tetX --scheduler-file nowhere"),
]


@pytest.mark.parametrize(("package", "extra", "line"), NEEDS)
def test_a_command_whose_extra_is_missing_says_which_before_anything_else(monkeypatch, tmp_path, package, extra, line):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(MissingExtraError) as caught:
        app.main(line.split(), standalone_mode=False)
    assert caught.value.extra == extra
    assert str(caught.value).endswith(
        f" needs {package}, which is not installed: `pip install 'symsol-annot[{extra}]'`"
    )
    assert list(tmp_path.iterdir()) == []


def test_what_extras_bring_is_what_the_package_declares():
    declared = {}
    for requirement in map(Requirement, requires("symsol-annot")):
        for extra in PACKAGES:
            if requirement.marker and requirement.marker.evaluate({"extra": extra}):
                declared.setdefault(extra, set()).add(requirement.name)
    assert declared == {extra: set(packages) for extra, packages in PACKAGES.items()}


@pytest.mark.parametrize("extra", PACKAGES)
def test_an_extra_that_is_here_is_no_error_and_a_missing_one_is_an_import_error(monkeypatch, extra):
    check_extra(extra, "this")
    monkeypatch.setitem(sys.modules, PACKAGES[extra][-1], None)
    with pytest.raises(ImportError, match=r"^this needs"):
        check_extra(extra, "this")
