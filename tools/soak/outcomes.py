"""What a soak found: a table that grows as it goes, and a part of build/soak.json."""

import argparse
import json
import os
import platform
import sys
import time
from dataclasses import asdict, dataclass, field
from importlib.metadata import version
from pathlib import Path

RESULTS = Path(__file__).parents[2] / "build" / "soak.json"
PARTS = ("kills", "folder_faults", "worker_faults", "dask_faults", "flips", "sets", "heap_damage")
_WIDTHS = (36, 42, 7)


@dataclass(frozen=True)
class Outcome:
    """One thing that was done to a set, and how it ended.

    Attributes:
        fault: what was done.
        where: where and when.
        seconds: until it had ended.
        outcome: how.
        contradictions: in what it is not as promised; empty where all is well.
    """

    fault: str
    where: str
    seconds: float
    outcome: str
    contradictions: list[str] = field(default_factory=list)


class Table:
    """Prints each outcome as it comes, and keeps it."""

    def __init__(self):
        self.outcomes = []
        self._line("fault", "where", "seconds", "outcome")

    def add(self, outcome):
        self.outcomes.append(outcome)
        self._line(outcome.fault, outcome.where, f"{outcome.seconds:.1f}", outcome.outcome)
        for contradiction in outcome.contradictions:
            print(f"  CONTRADICTION {contradiction}", flush=True)

    def _line(self, *cells):
        *narrow, last = cells
        print(*(f"{cell:{width}}" for cell, width in zip(narrow, _WIDTHS, strict=True)), last, sep="  ", flush=True)


def run_alone(description, part, prove, **options):
    """Be a script: read its options, prove, keep the results, and exit.

    Args:
        description: for --help.
        part: which of PARTS the results are.
        prove: from a table and the options to what the JSON says beside the outcomes.
        options: by name, their default values.
    """
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, default in options.items():
        if isinstance(default, bool):
            parser.add_argument(f"--{name}", action="store_true")
        else:
            parser.add_argument(f"--{name}", type=type(default), default=default, help=f"[default: {default}]")
    parser.add_argument("--json", type=Path, default=RESULTS, help="[default: build/soak.json]")
    arguments = vars(parser.parse_args())
    path, start, table = arguments.pop("json"), time.monotonic(), Table()
    about = prove(table, **arguments)
    contradictions = sum(len(outcome.contradictions) for outcome in table.outcomes)
    seconds = time.monotonic() - start
    print(f"{part}: {len(table.outcomes)} outcomes, {contradictions} contradictions, {seconds:.0f} s\n")
    found = {**arguments, **about, "seconds": round(seconds), "contradictions": contradictions}
    _keep(path, part, {**found, "outcomes": [_rounded(outcome) for outcome in table.outcomes]})
    sys.exit(1 if contradictions else 0)


def _rounded(outcome):
    return {**asdict(outcome), "seconds": round(outcome.seconds, 1)}


def _keep(path, part, found):
    """Replace one part of the results; a line each for outcomes, so that two of them can be compared."""
    there = json.loads(path.read_text()) if path.exists() else {}
    there = {"machine": _machine(), **{name: there[name] for name in PARTS if name in there}, part: found}
    path.parent.mkdir(exist_ok=True)
    parts = [f"{json.dumps(name)}: {_compact(there[name])}" for name in ("machine", *PARTS) if name in there]
    path.write_text("{\n" + ",\n".join(parts) + "\n}\n")


def _compact(found):
    outcomes = [json.dumps(outcome) for outcome in found.get("outcomes", [])]
    rest = json.dumps({key: value for key, value in found.items() if key != "outcomes"})
    return rest[:-1] + ', "outcomes": [\n  ' + ",\n  ".join(outcomes) + "\n]}" if outcomes else rest


def _machine():
    lines = Path("/proc/cpuinfo").read_text().splitlines() if Path("/proc/cpuinfo").exists() else []
    model = next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), platform.processor())
    versions = {name: version(name) for name in ("bpy", "h5py", "numpy", "distributed")}
    cores = len(os.sched_getaffinity(0))
    return {"processor": model, "cores": cores, "python": platform.python_version(), **versions}
