"""Who hands out the cases, gathers how they ended, prints a table and keeps everything as JSON."""

import argparse
import json
import math
import os
import platform
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from shutil import copy, copytree, ignore_patterns

ENDS = ("right", "refused", "CRASH", "HANG", "SILENT", "TRACEBACK", "ESCAPE", "OUTSIDE", "PEAK")
GOOD = ENDS[:2]
_HERE = Path(__file__).resolve().parent
RECORDED = _HERE.parents[1] / "docs" / "results" / "attack.json"
_LEAST_LISTED = 12  # cases, however few are wanted of all
_BATCH, _BATCH_LISTED = 100, 15  # cases that a process attempts; a fresh one after that
_FOLDERS = {
    "symsol_annot": "symsol_annot",
    "symsol_annot_cli": "cli",
    "symsol_annot_assets": "blender_assets",
    "support": "tests/support",
}


def main(words=None):
    """Attack, print the table, keep the results; exit with 1 where an attempt failed."""
    arguments = _parsed(words)
    with tempfile.TemporaryDirectory(prefix="attack-", ignore_cleanup_errors=True) as temporary:
        root = Path(temporary)
        found = attack(root, arguments.tree, arguments.only, arguments.scale, arguments.seed, arguments.jobs)
        if (root / "kept").exists():
            copytree(root / "kept", arguments.keep, symlinks=True, dirs_exist_ok=True)
    arguments.json.parent.mkdir(parents=True, exist_ok=True)
    arguments.json.write_text(json.dumps(found, indent=1) + "\n")
    if arguments.record:
        record(found, arguments.record)
    print("\n".join(table(found)))
    print(f"\nAll figures: {arguments.json}; files that failed: {arguments.keep}")
    sys.exit(1 if failures(found) else 0)


def _parsed(words):
    from attack import __doc__ as description

    parser = argparse.ArgumentParser(prog="python tools/attack", description=description)
    parser.add_argument("--scale", type=float, default=1.0, help="how many times the cases of a whole run")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", action="append", metavar="KIND", help="may be repeated")
    parser.add_argument("--jobs", type=int, default=len(os.sched_getaffinity(0)))
    parser.add_argument("--tree", type=Path, default=_HERE.parents[1], help="another checkout, to attack that")
    parser.add_argument("--json", type=Path, default=Path("build/attack.json"))
    parser.add_argument("--record", metavar="NAME", help="also put the counts into docs/results/attack.json, as NAME")
    parser.add_argument("--keep", type=Path, default=Path("build/attack"), help="where files that fail go")
    return parser.parse_args(words)


def attack(root, tree, only=None, scale=1.0, seed=0, jobs=1, say=print):
    """Attack a checkout; return the results, as JSON has them.

    Args:
        root: an empty folder to work in.
        tree: the checkout.
        only: names of kinds; all by default.
        scale: how many times the cases of a whole run; cases that are listed are all attempted, from 1 on.
        seed: decides each case together with its kind and number.
        jobs: how many at a time.
        say: is told of each failure.
    """
    start, run = time.monotonic(), _Run(_environment(root, tree), root, seed, say)
    asked = _ask(run.environment, only or [])
    bases = dict.fromkeys(name for kind in asked.values() for name in kind["bases"])
    run.make(bases)
    results = {name: [] for name in asked}
    with ThreadPoolExecutor(jobs) as pool:
        runs = []
        for name, kind in asked.items():
            numbers, batch = _numbers(kind, scale), _BATCH_LISTED if kind["is_listed"] else _BATCH
            batches = [numbers[at : at + batch] for at in range(0, len(numbers), batch)]
            runs += [(name, pool.submit(run.attempt, name, numbers)) for numbers in batches]
        for name, attempts in runs:
            results[name] += attempts.result()
    seconds = round(time.monotonic() - start)
    about = {"seed": seed, "scale": scale, "jobs": jobs, "seconds": seconds, **_machine()}
    return {**about, "kinds": {name: _summary(found) for name, found in results.items()}}


def table(found):
    """Return the lines of a Markdown table: a row per kind, a column per end."""
    ends = [end for end in ENDS if end != "ESCAPE" or any(row["ends"].get(end) for row in found["kinds"].values())]
    lines = ["| kind | cases | " + " | ".join(ends) + " | slowest s | peak MiB |", "|---" * (len(ends) + 4) + "|"]
    for name, row in found["kinds"].items():
        counts = " | ".join(str(row["ends"].get(end, 0)) for end in ends)
        lines.append(f"| {name} | {row['cases']} | {counts} | {row['slowest_s']} | {row['peak_mib']} |")
    return lines


def record(found, name, path=RECORDED):
    """Put the counts of a run beside those that are recorded; a kind's earlier ones under that name go."""
    there = json.loads(path.read_text()) if path.exists() else {}
    kinds = {kind: {key: row[key] for key in row if key != "failures"} for kind, row in found["kinds"].items()}
    about = {key: found[key] for key in found if key != "kinds"}
    there[name] = {**about, "kinds": {**there.get(name, {}).get("kinds", {}), **kinds}}
    path.write_text(json.dumps(there, indent=1) + "\n")


def failures(found):
    """Return how many attempts failed."""
    return sum(count for row in found["kinds"].values() for end, count in row["ends"].items() if end not in GOOD)


def _environment(root, tree):
    """Return the environment of processes that import a checkout as it is now, whatever is installed."""
    imported = root / "import"
    for name, folder in _FOLDERS.items():
        copytree(tree / folder, imported / name, ignore=ignore_patterns("__pycache__"))
    copytree(_HERE, imported / "attack", ignore=ignore_patterns("__pycache__"))
    for name in ("forked_readers.py", "fuzz_predictions.py", "valid_predictions.py"):
        copy(_HERE.parent / name, imported)
    paths = os.pathsep.join(str(imported / name) for name in ("", "support"))
    (root / "home").mkdir()
    own = {"PYTHONPATH": paths, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MPLBACKEND": "agg"}
    return {
        **os.environ,
        **own,
        "MPLCONFIGDIR": str(root / "home"),
        "PYTHONSAFEPATH": "1",
        "PYTHONDONTWRITEBYTECODE": "1",
    }


_ASK = """
import json, sys
from pathlib import Path
from attack.catalogue import KINDS
listed = lambda kind: kind.cases is None
print(json.dumps({name: {"bases": kind.bases, "is_listed": listed(kind),
    "cases": kind.count() if listed(kind) else kind.cases} for name, kind in KINDS.items()}))
"""


def _ask(environment, only):
    """Return what there is of each kind that is wanted."""
    done = subprocess.run([sys.executable, "-c", _ASK], env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(done.stderr)
    kinds = json.loads(done.stdout)
    if strange := [name for name in only if name not in kinds]:
        raise SystemExit(f"--only {strange[0]!r}: expected one of {', '.join(map(repr, kinds))}")
    return {name: kind for name, kind in kinds.items() if not only or name in only}


def _numbers(kind, scale):
    """Return which cases to attempt: of those that are listed, evenly chosen ones."""
    if kind["is_listed"]:
        step = min(round(1 / scale), kind["cases"] // _LEAST_LISTED)
        return range(0, kind["cases"], max(1, step))
    return range(math.ceil(kind["cases"] * scale))


@dataclass(frozen=True)
class _Run:
    """What all processes of a run share.

    Attributes:
        environment: of the processes.
        root: the folder that they work in.
        seed: of the cases.
        say: is told of each failure.
    """

    environment: dict
    root: Path
    seed: int
    say: Callable

    def make(self, bases):
        """Make the valid files."""
        command = self._command("bases", *bases)
        done = subprocess.run(command, env=self.environment, capture_output=True, text=True, check=False)
        if done.returncode:
            raise RuntimeError(f"{' '.join(command)}: {done.stderr}")

    def attempt(self, kind, numbers):
        """Have a process attempt some cases; where it dies itself, the case that it was at counts as a crash."""
        found = []
        while len(found) < len(numbers):
            left, errors = numbers[len(found) :], self.root / f"errors-{threading.get_ident()}"
            with errors.open("w") as stderr:
                command = self._command(self.seed, kind, *left)
                with subprocess.Popen(command, env=self.environment, stdout=subprocess.PIPE, stderr=stderr) as process:
                    if not process.stdout.readline():
                        raise RuntimeError(f"{kind}: no case could be attempted: {errors.read_text()}")
                    found += [self._told(kind, json.loads(line)) for line in process.stdout]
            if len(found) < len(numbers):
                lost = {"number": numbers[len(found)], "how": "CRASH", "seconds": 0, "peak": 0, "done": []}
                found.append(self._told(kind, {**lost, "words": f"the harness died: {errors.read_text()[-2000:]}"}))
        return found

    def _told(self, kind, one):
        if one["how"] not in GOOD:
            self.say(f"{one['how']} {kind} {one['number']}: {one['done']}: {one['words'][-300:]}")
        return one

    def _command(self, *words):
        return [sys.executable, "-m", "attack.worker", str(self.root), *map(str, words)]


def _summary(found):
    failed = [one for one in found if one["how"] not in GOOD]
    return {
        "cases": len(found),
        "ends": dict(Counter(one["how"] for one in found)),
        "median_s": round(statistics.median(one["seconds"] for one in found), 3),
        "slowest_s": round(max(one["seconds"] for one in found), 1),
        "peak_mib": max(one["peak"] for one in found),
        "failures": failed,
    }


def _machine():
    lines = Path("/proc/cpuinfo").read_text().splitlines() if Path("/proc/cpuinfo").exists() else []
    model = next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), platform.processor())
    return {"processor": model, "cores": len(os.sched_getaffinity(0)), "python": platform.python_version()}
