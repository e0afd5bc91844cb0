"""Wheels built from a copy of the project, and new Python environments that hold what is put into them."""

import os
import shutil
import subprocess
import sys
from importlib.metadata import distribution
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

PROJECT = Path(__file__).parents[2]
_BUILT_FROM = ("pyproject.toml", "MANIFEST.in", "README.md", "LICENSE", "CHANGELOG.md", "CITATION.cff")
_PACKAGES = ("symsol_annot", "cli", "blender_assets")


def build(source, out, *options):
    """Build a project in place with the setuptools of this environment; the files made, wheel last."""
    run(sys.executable, "-m", "build", "--no-isolation", *options, "--outdir", out, source)
    return sorted(out.iterdir(), key=lambda path: path.suffix == ".whl")


def project_copy(folder):
    """Copy what the package is built from, without what was built from it before."""
    for name in _BUILT_FROM:
        shutil.copy(PROJECT / name, folder)
    for name in _PACKAGES:
        shutil.copytree(PROJECT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    return folder


class Environment:
    """A new environment: nothing in it but Python."""

    def __init__(self, folder, python=sys.executable):
        run(python, "-m", "venv", "--without-pip", folder)
        self.bin = folder / "bin"
        self.packages = next(folder.glob("lib/python*/site-packages"))

    def pip(self, *words):
        """Let this environment's pip work on that one."""
        return run(sys.executable, "-m", "pip", "--python", self.bin / "python", *words)

    def borrow(self, *names):
        """Link distributions of this environment into that one, with all they require: pip takes them as installed."""
        for name in required_by(*names):
            for path in {Path(str(path)).parts[0] for path in distribution(name).files} - {"..", "__pycache__"}:
                (self.packages / path).symlink_to(distribution(name).locate_file(path))

    def run(self, program, *words, **options):
        """Run one of its programs."""
        return run(self.bin / program, *words, **options)

    def distributions(self):
        """The canonical names of what is installed."""
        lines = self.pip("list", "--format", "freeze").stdout.splitlines()
        return {canonicalize_name(line.partition("==")[0]) for line in lines}


def required_by(*names):
    """The distributions of these names and all that they require, without extras."""
    found, todo = set(), [canonicalize_name(name) for name in names]
    while todo:
        name = todo.pop()
        if name not in found:
            found.add(name)
            requirements = [Requirement(line) for line in distribution(name).requires or ()]
            todo += [
                canonicalize_name(r.name) for r in requirements if not r.marker or r.marker.evaluate({"extra": ""})
            ]
    return found


def run(*command, expected=0, cwd=None):
    """Run a program to its end, which must be the expected one and no traceback, outside of the project.

    It finds what is installed where it runs, and nothing by a PYTHONPATH of whoever calls.
    """
    words = [str(word) for word in command]
    own = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(
        words, capture_output=True, text=True, cwd=cwd or "/", env=own, stdin=subprocess.DEVNULL, check=False
    )
    assert done.returncode == expected, f"{words}: {done.returncode}\n{done.stdout[-3000:]}\n{done.stderr[-3000:]}"
    assert "Traceback" not in done.stderr
    return done
