"""Build wheel and sdist into dist/, and try the wheel in empty environments: each Python here, each extra alone.

`make release`. It installs from the package index without this project's constraints, as a user does. That takes some
minutes, most of them for torch and Blender. The table goes to build/release.md.

python tools/release.py --python 3.13 --extra none --extra publish   # some of it
"""

import argparse
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))

from environments import PROJECT, Environment, build, project_copy
from installed import EXTRAS, NEEDS, check_base, check_extra, check_refusal, check_together

_RENDERING_PYTHON = "3.11"
_PYTHONS = (_RENDERING_PYTHON, "3.12", "3.13")
_NO_EXTRA = "none"
_EXTRAS = (_NO_EXTRA, *EXTRAS)
_REPEATS = 20


def main():
    """Build, try, and write the table; exit with 1 if anything fails."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--python", choices=_PYTHONS, action="append", help="one version; may be repeated  [all]")
    parser.add_argument("--extra", choices=_EXTRAS, action="append", help="one extra; may be repeated  [all]")
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="release-") as workplace:
        files = built(Path(workplace))
        lines = [f"{path.name}: {path.stat().st_size / 1e6:.2f} MB" for path in files]
        lines += ["", "| Python | extra | installed, MB | import, ms | |", "|---|---|---|---|---|"]
        for version in chosen.python or _PYTHONS:
            python = interpreter(version)
            for extra in chosen.extra or _EXTRAS:
                if extra == "render" and version != _RENDERING_PYTHON:
                    continue
                lines.append(f"| {version} | {extra} | {outcome(Path(workplace), files[-1], python, extra)} |")
                print(lines[-1], flush=True)
    (PROJECT / "build").mkdir(exist_ok=True)
    (PROJECT / "build" / "release.md").write_text("\n".join(lines) + "\n")
    sys.exit(1 if any(word in line for line in lines for word in ("FAILED", "NOT TRIED")) else 0)


def built(workplace):
    """Build, and put what was built into dist/ in the place of what was there of this name."""
    (workplace / "project").mkdir()
    files = build(project_copy(workplace / "project"), workplace / "dist")
    (PROJECT / "dist").mkdir(exist_ok=True)
    for path in files:
        shutil.copy(path, PROJECT / "dist")
    return files


def interpreter(version):
    """Find a Python of that version which starts: on the path, or pyenv's; None where there is none."""
    candidates = [
        shutil.which(f"python{version}"),
        *map(str, Path.home().glob(f".pyenv/versions/{version}.*/bin/python")),
    ]
    for path in filter(None, candidates):
        command = [path, "-c", "import venv, sys; print(sys.version)"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.stdout.startswith(f"{version}."):
            return path
    return None


def outcome(workplace, wheel, python, extra):
    """Install and try; the last three columns of the table."""
    if python is None:
        return "| | NOT TRIED: no such Python here"
    folder = Path(tempfile.mkdtemp(dir=workplace))
    try:
        environment = Environment(folder / "env", python)
        environment.pip("install", "--quiet", wheel if extra == _NO_EXTRA else f"{wheel}[{extra}]")
        environment.pip("check")
        size = sum(path.lstat().st_size for path in environment.packages.rglob("*") if path.is_file()) / 1e6
        (folder / "work").mkdir()
        if extra != _NO_EXTRA:
            check_extra(environment, extra, folder / "work")
            check_together(environment, wheel, extra, folder / "work")
            return f"{size:.0f} | | works"
        check_base(environment, folder / "work")
        for needed, words in NEEDS:
            check_refusal(environment, needed, words, folder / "work")
        return f"{size:.0f} | {import_milliseconds(environment):.0f} | works"
    except AssertionError as error:
        print(error, file=sys.stderr)
        return "| | FAILED"
    finally:
        shutil.rmtree(folder)


def import_milliseconds(environment):
    """The median time of `import symsol_annot`, less that of Python's own start."""
    times = {"pass": [], "import symsol_annot": []}
    for _ in range(_REPEATS):
        for code, measured in times.items():
            started = time.perf_counter()
            environment.run("python", "-c", code)
            measured.append(time.perf_counter() - started)
    bare, loaded = (statistics.median(measured) for measured in times.values())
    return 1000 * (loaded - bare)


if __name__ == "__main__":
    main()
