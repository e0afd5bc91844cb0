"""Changes the code a little, many times, and names the changes that no test notices.

python tools/mutations.py [--room rotations] [--file FILE] [--count 60] [--seconds 1800] [--seed 0] [--json FOUND.json]

A mutation swaps one operator, comparison or constant of a module, in a copy of the packages; arguments of decorators
and annotations stay. The tests of the module's room run on the copy until one fails. A survivor is a change that all of
them pass: it names a law without a test, or a change that changes nothing. Mutations are drawn at random from all;
exits 1 if one survives or none was tried.
"""

import argparse
import ast
import copy
import json
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path

PROJECT = Path(__file__).resolve().parents[1]
PACKAGES = {"symsol_annot": "symsol_annot", "cli": "symsol_annot_cli", "blender_assets": "symsol_annot_assets"}
TESTS = {  # of each room that is mutated; those that start Blender are left out
    "rotations": ("tests/rotations",),
    "annotation": ("tests/annotation",),
    "bench/scoring": ("tests/bench/scoring",),
}
TIMEOUT_S = 600  # a mutation that makes a test hang is noticed
SWAPS = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.MatMult: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.And: ast.Or,
    ast.Or: ast.And,
}


@dataclass(frozen=True)
class Mutation:
    """One change.

    Attributes:
        file: of the project.
        line: where it is.
        before: the expression as it is.
        after: as it becomes.
        number: of the change among those of the file.
    """

    file: str
    line: int
    before: str
    after: str
    number: int

    def __str__(self):
        return f"{self.file}:{self.line}: {self.before}  ->  {self.after}"


def main():
    """Mutate until the count or the time is used up, and name the survivors."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--room", choices=TESTS, action="append", help="[default: all of these]")
    parser.add_argument("--file", action="append", help="of the project, in such a room [default: all of them]")
    parser.add_argument("--count", type=int, default=60)
    parser.add_argument("--seconds", type=float, default=1800.0, help="begin no mutation after so long")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    chosen = drawn(arguments.room or TESTS, arguments.count, arguments.seed, arguments.file)
    found = tried(chosen, arguments.seconds)
    survivors = [mutation for mutation, is_noticed in found if not is_noticed]
    print(f"{len(found)} of {len(chosen)} mutations tried, {len(survivors)} survived")
    for mutation in survivors:
        print(mutation)
    if arguments.json:
        rows = [{**asdict(mutation), "noticed": is_noticed} for mutation, is_noticed in found]
        arguments.json.write_text(json.dumps({"seed": arguments.seed, "mutations": rows}, indent=1) + "\n")
    sys.exit(1 if survivors or not found else 0)


def drawn(rooms, count, seed, files=None):
    """Return a random sample of all mutations of some rooms, or of some of their files; the same for code and seed."""
    paths = [path for room in rooms for path in sorted((PROJECT / "symsol_annot" / room).rglob("*.py"))]
    if files:
        paths = [PROJECT / name for name in files]
        if lost := [name for name in files if not (PROJECT / name).is_file() or _room_of_file(name) not in rooms]:
            raise SystemExit(f"{', '.join(lost)}: no file of {', '.join(rooms)}; name it as symsol_annot/ROOM/FILE.py")
    everything = [mutation for path in paths for mutation in mutations_of(path)]
    return random.Random(seed).sample(everything, min(count, len(everything)))


def tried(mutations, seconds):
    """Return the mutations that were tried in time, each with whether a test noticed it."""
    found, end = [], time.monotonic() + seconds
    with tempfile.TemporaryDirectory() as place:
        for source, package in PACKAGES.items():
            shutil.copytree(PROJECT / source, Path(place, package), ignore=shutil.ignore_patterns("__pycache__"))
        for room in {_room_of_file(mutation.file) for mutation in mutations}:
            if not passes(TESTS[room], place):
                raise SystemExit(f"the tests of {room} fail without a mutation")
        for mutation in mutations:
            if time.monotonic() > end:
                break
            path = Path(place, mutation.file)
            whole = path.read_text(encoding="utf-8")
            path.write_text(mutated(whole, mutation.number), encoding="utf-8")
            found.append((mutation, not passes(tests_of(mutation), place)))
            path.write_text(whole, encoding="utf-8")
            print("noticed " if found[-1][1] else "SURVIVED", mutation, flush=True)
    return found


def tests_of(mutation):
    """Return the tests that a mutation has to pass: first its module's, which are likely to notice, then its room's."""
    room, name = _room_of_file(mutation.file), f"test_{Path(mutation.file).stem}.py"
    own = [path.relative_to(PROJECT) for path in (PROJECT / TESTS[room][0]).rglob(name)]
    return (*map(str, own), *TESTS[room])


def passes(tests, place):
    """Say whether all of some tests pass on the packages in a folder."""
    options = ["-q", "-x", "-m", "not blender and not slow", "-p", "no:cacheprovider"]
    command = [sys.executable, "-B", "-P", "-m", "pytest", *options, *tests]
    environment = {**os.environ, "PYTHONPATH": str(place)}
    try:
        done = subprocess.run(
            command, cwd=PROJECT, env=environment, capture_output=True, timeout=TIMEOUT_S, check=False
        )
    except subprocess.TimeoutExpired:
        return False
    return done.returncode == 0


def mutations_of(path):
    """Return all mutations of a file."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    name = path.relative_to(PROJECT).as_posix()
    return [
        Mutation(name, node.lineno, ast.unparse(node), ast.unparse(changed), number)
        for number, (node, changed) in enumerate(_changes(tree))
    ]


def mutated(text, number):
    """Return a file's text with one mutation; comments are lost, and nothing else is changed."""
    tree = ast.parse(text)
    node, changed = list(_changes(tree))[number]
    return ast.unparse(_Replaced(node, changed).visit(tree))


class _Replaced(ast.NodeTransformer):
    """Puts one node in the place of another."""

    def __init__(self, old, new):
        self._old, self._new = old, new

    def visit(self, node):
        return self._new if node is self._old else super().visit(node)


def _changes(tree):
    """Yield each expression that can be changed, with what it becomes, in a fixed order."""
    skipped = {id(inner) for node in ast.walk(tree) for inner in _no_values(node)}
    for node in ast.walk(tree):
        if id(node) not in skipped:
            yield from ((node, changed) for changed in _changed(node))


def _no_values(node):
    """Yield what in a node is no value of its code: annotations, and what a decorator is told."""
    for part in (
        getattr(node, "annotation", None),
        getattr(node, "returns", None),
        *getattr(node, "decorator_list", ()),
    ):
        if part is not None:
            yield from ast.walk(part)


def _changed(node):
    """Yield what a node may become."""
    if isinstance(node, ast.BinOp | ast.BoolOp) and type(node.op) in SWAPS:
        yield _with(node, op=SWAPS[type(node.op)]())
    if isinstance(node, ast.Compare) and type(node.ops[0]) in SWAPS:
        yield _with(node, ops=[SWAPS[type(node.ops[0])](), *node.ops[1:]])
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.Not | ast.Invert):
        yield node.operand
    if isinstance(node, ast.Constant) and isinstance(node.value, bool):
        yield _with(node, value=not node.value)
    elif isinstance(node, ast.Constant) and isinstance(node.value, int | float):
        yield _with(node, value=node.value + 1)


def _with(node, **fields):
    changed = copy.copy(node)
    for name, value in fields.items():
        setattr(changed, name, value)
    return changed


def _room_of_file(name):
    return next((room for room in TESTS if name.startswith(f"symsol_annot/{room}/")), None)


if __name__ == "__main__":
    main()
