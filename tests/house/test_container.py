"""The container and the lock: what they name is there, and is what the README and the doctor name."""

import json
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import lock_render
import pytest
from environments import PROJECT, build
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from symsol_annot.rendering.doctor import SYSTEM_LIBRARIES, install_command

INSTRUCTIONS = {"FROM", "RUN", "WORKDIR", "COPY", "USER", "ENV", "ENTRYPOINT", "CMD"}


def instructions():
    """The Dockerfile's instructions in order, each with its words in one line."""
    text = (PROJECT / "Dockerfile").read_text(encoding="utf-8")
    lines = [line for line in text.splitlines() if not line.lstrip().startswith("#")]
    joined = re.sub(r"\\\n\s*", "", "\n".join(lines))
    return [tuple(line.split(maxsplit=1)) for line in joined.splitlines() if line.strip()]


def words_of(kind):
    return [words for found, words in instructions() if found == kind]


def copied():
    """What is copied into the image, from where."""
    for words in words_of("COPY"):
        *sources, target = words.split()
        for source in sources:
            yield source, source if target == "./" else target


def test_the_dockerfile_has_known_instructions_in_an_order_that_builds():
    kinds = [kind for kind, _ in instructions()]
    assert set(kinds) <= INSTRUCTIONS
    assert kinds[0] == "FROM"
    assert kinds[-2:] == ["ENTRYPOINT", "CMD"]
    assert kinds.index("COPY") < len(kinds) - 1 - kinds[::-1].index("RUN")
    assert words_of("FROM") == ["python:3.11-slim-bookworm"]


@pytest.mark.parametrize("words", words_of("RUN"), ids=lambda words: words[:30])
def test_a_shell_takes_each_command(words):
    subprocess.run(["sh", "-n", "-c", words], check=True)


def test_it_starts_the_command_that_the_package_installs():
    scripts = tomllib.loads((PROJECT / "pyproject.toml").read_text())["project"]["scripts"]
    assert json.loads(words_of("ENTRYPOINT")[0]) == list(scripts)
    assert json.loads(words_of("CMD")[0]) == ["--help"]


def test_it_installs_the_libraries_that_the_doctor_names_by_the_doctors_line():
    (line,) = (words for words in words_of("RUN") if "apt-get" in words)
    by_doctor = install_command([*SYSTEM_LIBRARIES.values()]).replace("sudo ", "").split(" && ")
    by_image = line.split(" && ")
    assert by_image[0].split() == by_doctor[0].split()
    assert sorted(by_image[1].split()) == sorted(by_doctor[1].split())


def test_it_installs_what_the_readme_installs():
    readme = (PROJECT / "README.md").read_text()
    lines = [shlex.split(line, comments=True) for line in re.findall(r"^pip install .*$", readme, flags=re.MULTILINE)]
    installed = [shlex.split(words)[-1] for words in words_of("RUN") if words.startswith("pip ")]
    assert installed == ["constraints-render.txt", f".[{','.join(lock_render.EXTRAS)}]"]
    assert ["pip", "install", installed[1]] in lines


def test_what_it_copies_is_there_is_not_ignored_and_is_enough_to_build_the_package(tmp_path):
    allowed = {line[1:] for line in (PROJECT / ".dockerignore").read_text().split() if line.startswith("!")}
    for source, target in copied():
        path = PROJECT / source
        assert source in allowed
        if path.is_dir():
            shutil.copytree(path, tmp_path / "image" / target, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            (tmp_path / "image").mkdir(exist_ok=True)
            shutil.copy(path, tmp_path / "image" / target)
    assert {source for source, _ in copied()} == allowed
    (wheel,) = build(tmp_path / "image", tmp_path / "dist", "--wheel")
    assert wheel.suffix == ".whl"


# The lock


def locked():
    """Name to version of the lock, each with a hash."""
    text = re.sub(r"\\\n\s*", "", lock_render.LOCK.read_text(encoding="utf-8"))
    lines = [line for line in text.splitlines() if not line.startswith("#")]
    found = [re.fullmatch(r"([a-z0-9._-]+)==(\S+) --hash=sha256:[0-9a-f]{64}", line) for line in lines]
    assert all(found), lines
    return {canonicalize_name(match[1]): match[2] for match in found}


def test_the_lock_pins_what_the_extras_and_the_build_require_and_no_torch():
    """If this fails: .venv/bin/python tools/lock_render.py."""
    pinned = locked()
    assert len(pinned) > len(lock_render.requirements())
    for line in lock_render.requirements():
        requirement = Requirement(line)
        assert requirement.specifier.contains(pinned[canonicalize_name(requirement.name)]), line
    assert "torch" not in pinned
    assert re.search(r"^torch==\S+$", (PROJECT / "constraints.txt").read_text(), flags=re.MULTILINE)


def test_a_report_of_pip_becomes_a_lock_that_pip_parses(tmp_path):
    report = {
        "install": [
            {
                "metadata": {"name": name, "version": "1.2"},
                "download_info": {"archive_info": {"hashes": {"sha256": "0" * 64}}},
            }
            for name in ("Zeta", "alpha")
        ]
    }
    text = lock_render.lock(report)
    assert re.findall(r"^(\S+)==1\.2 ", text, flags=re.MULTILINE) == ["alpha", "zeta"]
    (tmp_path / "lock.txt").write_text(text)
    words = ["install", "--dry-run", "--no-index", "--no-deps", "--require-hashes", "-r", tmp_path / "lock.txt"]
    done = subprocess.run([sys.executable, "-m", "pip", *words], capture_output=True, text=True, check=False)
    assert "No matching distribution found for alpha==1.2" in done.stderr
    del report["install"][0]["download_info"]["archive_info"]["hashes"]["sha256"]
    with pytest.raises(KeyError):
        lock_render.lock(report)
    assert Path(lock_render.LOCK).is_file()
