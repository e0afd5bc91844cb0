"""The doctor's findings on machines that lack something; the real machine is examined in tests/cli."""

import ctypes
import os
import shutil
import subprocess
import sys

import gallery_browser
import pytest

from symsol_annot.errors import RendererMissingError
from symsol_annot.rendering import doctor


class FakeRenderer:
    """Starts at once with any engine but those that are broken."""

    broken = ()

    def __init__(self, spec, camera, settings):
        if settings.engine in self.broken:
            raise RendererMissingError("no OpenGL; use --engine cycles")
        self.versions = {"bpy": "4.5.0", "engine": settings.engine}

    def __enter__(self):
        return self

    def __exit__(self, *exc):
        pass


@pytest.fixture(autouse=True)
def healthy(monkeypatch):
    """A machine that lacks nothing, and on which no command runs."""
    monkeypatch.setattr(ctypes, "CDLL", lambda name: object())
    monkeypatch.setattr(doctor, "RenderProcess", FakeRenderer)
    monkeypatch.setattr(doctor, "check_blender_installed", lambda: None)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: shutil._ntuple_diskusage(2**40, 0, 2**40))
    monkeypatch.setattr(sys, "version_info", (3, 11, 7))
    monkeypatch.setattr(subprocess, "run", refuse_to_run)


def refuse_to_run(command, **options):
    pytest.fail(f"ran {command}")


def lack(monkeypatch, *libraries):
    def load(name):
        if name in libraries:
            raise OSError(f"{name}: cannot open shared object file")

    monkeypatch.setattr(ctypes, "CDLL", load)


def finding(what, folder):
    return next(found for found in doctor.examine(folder) if found.what == what)


def test_a_machine_that_lacks_nothing_gets_no_remedy(tmp_path):
    findings = list(doctor.examine(tmp_path))
    assert all(found.is_good for found in findings)
    assert not any(found.remedy for found in findings)
    whats = [found.what for found in findings]
    assert whats == ["Python", "system libraries", "disk space", "engine opengl", "engine workbench", "engine cycles"]


@pytest.mark.parametrize(("user", "sudo"), [(0, ""), (1000, "sudo ")])
def test_the_install_command_is_one_line_with_sudo_for_who_is_not_root(monkeypatch, user, sudo):
    monkeypatch.setattr(os, "geteuid", lambda: user)
    assert doctor.install_command(["libegl1", "libsm6"]) == (
        f"{sudo}apt-get update && {sudo}apt-get install -y --no-install-recommends libegl1 libsm6 libgl1-mesa-dri"
    )


@pytest.mark.parametrize(
    ("library", "package"),
    [
        ("libX11.so.6", "libx11-6"),
        ("libXrender.so.1", "libxrender1"),
        ("libXfixes.so.3", "libxfixes3"),
        ("libXi.so.6", "libxi6"),
        ("libXxf86vm.so.1", "libxxf86vm1"),
        ("libxkbcommon.so.0", "libxkbcommon0"),
        ("libSM.so.6", "libsm6"),
        ("libICE.so.6", "libice6"),
        ("libGL.so.1", "libgl1"),
        ("libEGL.so.1", "libegl1"),
        ("libEGL_mesa.so.0", "libegl-mesa0"),
    ],
)
def test_a_library_that_does_not_load_is_named_by_its_debian_package(monkeypatch, library, package):
    assert doctor.missing_packages() == []
    lack(monkeypatch, library)
    assert doctor.missing_packages() == [package]


def test_missing_libraries_are_named_together_with_the_line_that_installs_them(monkeypatch, tmp_path):
    lack(monkeypatch, "libSM.so.6", "libEGL.so.1")
    found = finding("system libraries", tmp_path)
    assert not found.is_good
    assert found.found == "missing: libsm6, libegl1"
    assert found.remedy == doctor.install_command(["libsm6", "libegl1"])


def test_another_python_is_told_how_to_get_the_one_that_renders(monkeypatch, tmp_path):
    monkeypatch.setattr(sys, "version_info", (3, 12, 1))
    found = finding("Python", tmp_path)
    assert (found.is_good, found.found) == (False, "3.12.1")
    assert "python3.11 -m venv" in found.remedy
    assert ".[render]" in found.remedy


def test_a_nearly_full_disk_is_a_warning_for_a_folder_that_does_not_exist_yet(monkeypatch, tmp_path):
    looked_at = []

    def usage(path):
        looked_at.append(path)
        return shutil._ntuple_diskusage(2**40, 2**40 - 2**30, 2**30)

    monkeypatch.setattr(shutil, "disk_usage", usage)
    found = finding("disk space", tmp_path / "not" / "there")
    assert found.is_good  # it may be enough for a small set
    assert found.found == f"1.0 GiB free for {tmp_path}"
    assert "--out" in found.remedy
    assert looked_at == [tmp_path]


def test_without_bpy_no_engine_is_tried(monkeypatch, tmp_path):
    def lack_bpy():
        raise RendererMissingError("pip install 'symsol-annot[render]'")

    monkeypatch.setattr(doctor, "check_blender_installed", lack_bpy)
    findings = list(doctor.examine(tmp_path))
    assert [found.what for found in findings if not found.is_good] == ["Blender (bpy)"]
    assert findings[-1].remedy == "pip install 'symsol-annot[render]'"


def test_one_engine_that_cannot_draw_leaves_the_other_to_be_tried(monkeypatch, tmp_path):
    monkeypatch.setattr(FakeRenderer, "broken", ("workbench",))
    by_name = {found.what: found for found in doctor.examine(tmp_path)}
    assert not by_name["engine workbench"].is_good
    assert by_name["engine workbench"].remedy == "no OpenGL; use --engine cycles"
    assert by_name["engine cycles"].is_good


def test_nothing_is_installed_where_nothing_is_missing(monkeypatch):
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    assert doctor.install_missing_packages() == []


def test_root_installs_what_is_missing_and_looks_again(monkeypatch):
    ran = []

    def install(command, **options):
        ran.append(command)
        lack(monkeypatch)

    monkeypatch.setattr(os, "geteuid", lambda: 0)
    monkeypatch.setattr(shutil, "which", lambda program: f"/usr/bin/{program}")
    monkeypatch.setattr(subprocess, "run", install)
    lack(monkeypatch, "libSM.so.6")
    assert doctor.install_missing_packages() == []
    assert ran == ["apt-get update && apt-get install -y --no-install-recommends libsm6 libgl1-mesa-dri"]


def test_the_tests_set_up_installs_the_browsers_program_that_is_not_there(monkeypatch):
    ran = []
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    monkeypatch.setattr(shutil, "which", lambda program: None if program == "chromedriver" else f"/usr/bin/{program}")
    monkeypatch.setattr(subprocess, "run", lambda command, **options: ran.append(command))
    gallery_browser.install_missing()
    assert ran == ["apt-get update && apt-get install -y --no-install-recommends chromium-driver libgl1-mesa-dri"]


def test_without_rights_nothing_is_installed_and_what_is_missing_is_returned(monkeypatch):
    ran = []

    def ask_sudo(command, **options):
        ran.append(command)
        return subprocess.CompletedProcess(command, returncode=1)

    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    monkeypatch.setattr(shutil, "which", lambda program: f"/usr/bin/{program}")
    monkeypatch.setattr(subprocess, "run", ask_sudo)
    lack(monkeypatch, "libSM.so.6")
    assert doctor.install_missing_packages() == ["libsm6"]
    assert ran == [["sudo", "-n", "true"]]


def test_a_machine_without_sudo_is_one_without_rights(monkeypatch, tmp_path):
    monkeypatch.undo()
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    monkeypatch.setenv("PATH", str(tmp_path))
    lack(monkeypatch, "libSM.so.6")
    assert doctor.install_missing_packages() == ["libsm6"]
