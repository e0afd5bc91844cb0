"""What rendering needs of a machine, and the one line that installs what is missing."""

import ctypes
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from symsol_annot.errors import RenderError
from symsol_annot.objects.spec import load_object
from symsol_annot.rendering.blender_process import RENDERING_PYTHON, check_blender_installed
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.engines import ENGINES
from symsol_annot.rendering.render_process import RenderProcess
from symsol_annot.rendering.settings import RenderSettings

# Shared library: the Debian package that holds it.
SYSTEM_LIBRARIES = {
    "libX11.so.6": "libx11-6",
    "libXrender.so.1": "libxrender1",
    "libXfixes.so.3": "libxfixes3",
    "libXi.so.6": "libxi6",
    "libXxf86vm.so.1": "libxxf86vm1",
    "libxkbcommon.so.0": "libxkbcommon0",
    "libSM.so.6": "libsm6",
    "libICE.so.6": "libice6",
    "libGL.so.1": "libgl1",
    "libEGL.so.1": "libegl1",
    "libEGL_mesa.so.0": "libegl-mesa0",
}
_DRIVERS = "libgl1-mesa-dri"  # loaded by EGL from a path of its own, installed with what is missing
_ENOUGH_DISK_BYTES = 5 * 2**30  # the seven published sets take less
_PROBE_SIZE = 32


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at.

    Attributes:
        what: its name.
        is_good: whether rendering can rely on it.
        found: what was found.
        remedy: what to do where it is not good, or where it may not last; else empty.
    """

    what: str
    is_good: bool
    found: str
    remedy: str = ""


def examine(folder: Path) -> Iterator[Finding]:
    """Look at Python, bpy, the system's libraries, the disk of `folder`, and draw a frame with each engine."""
    yield _python()
    libraries = _libraries()
    yield libraries
    yield _disk(folder)
    try:
        check_blender_installed()
    except RenderError as error:
        yield Finding("Blender (bpy)", False, "cannot be used", str(error))
        return
    for engine in ENGINES.values():
        if not engine.needs_gpu:
            yield _engine(engine.name)


def missing_packages() -> list[str]:
    """Return the Debian packages whose libraries cannot be loaded here."""
    return [package for library, package in SYSTEM_LIBRARIES.items() if not _is_loadable(library)]


def install_command(packages: list[str]) -> str:
    """Return the one line that installs Debian packages, and the drivers that EGL loads by itself."""
    sudo = "" if os.geteuid() == 0 else "sudo "
    return f"{sudo}apt-get update && {sudo}apt-get install -y --no-install-recommends {' '.join([*packages, _DRIVERS])}"


def install_missing_packages() -> list[str]:
    """Install the system libraries that are missing, where this user may; return what is still missing."""
    install(missing_packages())
    return missing_packages()


def install(packages: list[str]) -> None:
    """Install Debian packages, where this user may."""
    if packages and shutil.which("apt-get") and _may_install():
        subprocess.run(install_command(packages), shell=True, check=False)  # noqa: S602 - our own words


def _may_install() -> bool:
    if os.geteuid() == 0 or shutil.which("sudo") is None:
        return os.geteuid() == 0
    return subprocess.run(["sudo", "-n", "true"], capture_output=True, check=False).returncode == 0


def _python() -> Finding:
    version = ".".join(str(part) for part in sys.version_info[:3])
    can_render = sys.version_info[:2] == RENDERING_PYTHON
    if can_render:
        return Finding("Python", True, version)
    remedy = "rendering needs 3.11: in a clone, `python3.11 -m venv env && env/bin/pip install '.[render]'`"
    return Finding("Python", False, version, remedy)


def _libraries() -> Finding:
    missing = missing_packages()
    if not missing:
        return Finding("system libraries", True, f"all {len(SYSTEM_LIBRARIES)} load")
    return Finding("system libraries", False, f"missing: {', '.join(missing)}", install_command(missing))


def _is_loadable(library: str) -> bool:
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True


def _disk(folder: Path) -> Finding:
    existing = next(path for path in (folder.absolute(), *folder.absolute().parents) if _is_there(path))
    free = shutil.disk_usage(existing).free
    remedy = "" if free >= _ENOUGH_DISK_BYTES else "make room, or choose another disk with --out"
    return Finding("disk space", True, f"{free / 2**30:.1f} GiB free for {existing}", remedy)


def _is_there(path: Path) -> bool:
    try:
        return path.exists()
    except OSError:  # in a folder that may not be looked into
        return False


def _engine(engine: str) -> Finding:
    try:
        with RenderProcess(load_object("cylO"), Camera.filling(_PROBE_SIZE), RenderSettings(engine)) as renderer:
            return Finding(f"engine {engine}", True, "; ".join(renderer.versions.values()))
    except RenderError as error:
        return Finding(f"engine {engine}", False, "cannot draw", str(error))
