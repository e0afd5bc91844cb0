"""The lock of an installation with Blender, constraints-render.txt: each package's version and SHA-256.

    .venv/bin/python tools/lock_render.py           write it anew, with the newest versions that pyproject.toml allows
    .venv/bin/python tools/lock_render.py --check   see whether pip resolves it, with every hash compared

pip resolves what `pip install '.[render,plot]'` and its build need, and downloads it, but installs nothing. The hashes
are of the wheels for this machine's system and Python, which the file names.
"""

import argparse
import json
import platform
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path
from typing import Any

PROJECT = Path(__file__).resolve().parents[1]
LOCK = PROJECT / "constraints-render.txt"
EXTRAS = ("render", "plot")  # of the line in README.md that makes sets
_DRY_RUN = ("install", "--dry-run", "--ignore-installed", "--only-binary", ":all:", "--quiet")
_HEADER = """\
# What `pip install '.[render,plot]'` installs, by version and SHA-256: wheels for Python {python} on {system}.
# Made by tools/lock_render.py. torch, which rendering does not need, is pinned in constraints.txt, without a hash,
# since each accelerator has a build of its own.
#
#   pip install --require-hashes --requirement constraints-render.txt
#   pip install --no-index --no-build-isolation '.[render,plot]'
"""


def main() -> None:
    """Write the lock, or check it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="change nothing; see whether pip resolves the lock")
    if parser.parse_args().check:
        _pip(*_DRY_RUN, "--require-hashes", "--requirement", str(LOCK))
        print(f"{LOCK.name}: pip resolves it, and every hash is right")
        return
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.json"
        _pip(*_DRY_RUN, "--report", str(report), *requirements())
        LOCK.write_text(lock(json.loads(report.read_text(encoding="utf-8"))), encoding="utf-8")
    print(f"{LOCK.name}: written")


def requirements() -> list[str]:
    """Return what the package, its extras and its build require, as pyproject.toml has it."""
    project = tomllib.loads((PROJECT / "pyproject.toml").read_text(encoding="utf-8"))
    extras = project["project"]["optional-dependencies"]
    asked = [*project["build-system"]["requires"], *project["project"]["dependencies"]]
    return asked + [line for extra in EXTRAS for line in extras[extra]]


def lock(report: dict[str, Any]) -> str:
    """Return the lock of what pip's report says that it would install.

    Raises:
        KeyError: a package has no SHA-256, as one that was built here.
    """
    lines = [_HEADER.format(python=platform.python_version().rpartition(".")[0], system=_system())]
    for item in sorted(report["install"], key=lambda item: str(item["metadata"]["name"]).lower()):
        name, version = item["metadata"]["name"], item["metadata"]["version"]
        sha256 = item["download_info"]["archive_info"]["hashes"]["sha256"]
        lines.append(f"{name.lower()}=={version} \\\n    --hash=sha256:{sha256}\n")
    return "".join(lines)


def _system() -> str:
    return f"{platform.system()} {platform.machine()}"


def _pip(*words: str) -> None:
    done = subprocess.run([sys.executable, "-m", "pip", *words], check=False)
    if done.returncode != 0:
        sys.exit(f"pip ended with {done.returncode}; what it said stands above")


if __name__ == "__main__":
    main()
