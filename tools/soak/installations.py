"""Python environments that lack a distribution, or have another version of one: what a Dask worker may run in."""

import re
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import symsol_annot

OURS = "symsol-annot"
_ROOT = Path(__file__).parents[2]
_SITE = Path(sysconfig.get_path("purelib"))


def environment(folder, *, without=(), versions=None):
    """Make an environment like this one, of links, and return its Python.

    Args:
        folder: where it goes.
        without: distributions that it lacks.
        versions: of distributions that it has in another version. Of symsol-annot that is a copy of the package that
            was given another number; of any other, the metadata alone says so.
    """
    versions = versions or {}
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(folder)], check=True)
    packages = next(folder.glob("lib/python*/site-packages"))
    for path in _SITE.iterdir():
        name = _distribution_of(path)
        if name == OURS or name in without:
            continue
        if name in versions and path.suffix == ".dist-info":
            _copy_metadata(path, packages, versions[name])
        else:
            (packages / path.name).symlink_to(path)
    if OURS not in without:
        _install_ours(packages, versions.get(OURS, symsol_annot.__version__))
    return folder / "bin" / "python"


def _install_ours(packages, version):
    sources = {"symsol_annot": "symsol_annot", "symsol_annot_cli": "cli", "symsol_annot_assets": "blender_assets"}
    for name, source in sources.items():
        shutil.copytree(_ROOT / source, packages / name, ignore=shutil.ignore_patterns("__pycache__"))
    about = packages / "symsol_annot" / "__init__.py"
    about.write_text(re.sub(r'__version__ = ".*"', f'__version__ = "{version}"', about.read_text()))
    _copy_metadata(next(_SITE.glob("symsol_annot-*.dist-info")), packages, version)


def _copy_metadata(path, packages, version):
    shutil.copytree(path, packages / path.name)
    metadata = packages / path.name / "METADATA"
    metadata.write_text(re.sub(r"(?m)^Version: .*$", f"Version: {version}", metadata.read_text(), count=1))


def _distribution_of(path):
    name = re.split(r"-\d|\.", path.name.removeprefix("__editable__."))[0]
    return name.replace("_", "-").lower()
