"""Cases by name: what was found once, and what is no file under every name that is read."""

import os
import socket
import tempfile
from functools import partial
from pathlib import Path

from attack import bombs
from attack.commands import outcome_of_command
from attack.damage import nested_deeply
from attack.kinds import READING_SETS, Attempt, Kind
from attack.sets import put_set, read_originals
from attack.shards import load_and_hold, verify_and_hold
from attack.signing import read_document, sign

_NAMES = (
    "../../../outside",
    "/symsol-annot-attack",
    "a/b",
    "..",
    ".",
    "",
    "nul\0l",
    "\x1b]0;owned\x07tetX",
    "x" * 300,
    "-rf",
)


class Found(Kind):
    """What was found to crash, to hang, to fill memory or to end in a traceback, by all commands that read a set."""

    name, cases, modules = "found before", None, READING_SETS

    def __init__(self, root):
        makers = {f"shard that {name}": partial(_damaged, content) for name, content in bombs.damaged_shards().items()}
        makers |= {
            f"signed shard that {n}": partial(_damaged, c, is_signed=True) for n, c in bombs.damaged_shards().items()
        }
        makers |= {bomb.__name__: partial(bombs.put_bomb, bomb) for bomb in bombs.BOMBS}
        makers |= {f"manifest: {name}": partial(_edited, edit) for name, edit in _EDITS.items()}
        makers |= {f"object named {name[:30]!r}": partial(_edited, partial(_name_it, name)) for name in _NAMES}
        with tempfile.TemporaryDirectory() as folder:
            bombs.put_whole(Path(folder) / "sets")
            self._whole = read_originals(Path(folder))[0]
        self._attempts = [(name, make, read) for name, make in makers.items() for read in _READERS]

    @staticmethod
    def count():
        """Return how many there are."""
        makers = 2 * len(bombs.damaged_shards()) + len(bombs.BOMBS) + len(_EDITS) + len(_NAMES)
        return makers * len(_READERS)

    def attempt(self, place, number, rng):
        name, make, read = self._attempts[number]
        folder = make(place.case)
        is_signed = not name.startswith("shard that")
        return Attempt([name, read], partial(_READERS[read], self._whole, folder, place, is_signed))


_READERS = {
    "load": lambda original, folder, place, is_signed: load_and_hold(original, folder, is_signed=is_signed),
    "load unchecked": lambda original, folder, place, is_signed: load_and_hold(
        original, folder, is_signed=True, check=False
    ),
    "verify": lambda original, folder, place, is_signed: verify_and_hold(
        original, folder, is_signed=is_signed, by_command=True
    ),
    "info": lambda original, folder, place, is_signed: outcome_of_command("info", folder),
    "publish": lambda original, folder, place, is_signed: outcome_of_command(
        "publish", folder, "--out", place.out / "bundle"
    ),
}


def _damaged(content, folder, *, is_signed=False):
    to = bombs.put_whole(folder)
    (to / bombs.SHARD).write_bytes(content)
    if is_signed:
        sign(to, read_document(to), contents=False)
    return to


def _edited(edit, folder):
    from attack.manifests import follow

    to = bombs.put_whole(folder)
    document = read_document(to)
    edit(document)
    with nested_deeply():
        follow(to, document)
    sign(to, document, contents=False)
    return to


def _name_it(name, document):
    document["object"] = name


def _without_engine(document):
    del document["render"]["engine"]


def _set(*path, to):
    def edit(document):
        *holders, last = path
        for key in holders:
            document = document[key]
        document[last] = to

    return edit


def _nested(depth):
    def edit(document):
        value = 0.5
        for _ in range(depth):
            value = [value]
        document["render"]["body_colour"] = value

    return edit


def _many(document):
    split, count = document["splits"]["test"], 200_000
    first = split["shards"][0]
    split["shards"] = [dict(first, file=f"test-{i:05d}-of-{count:05d}.h5", first_index=8 * i) for i in range(count)]
    split["images"] = 8 * count


_FIRST = ("splits", "test", "shards", 0)
_EDITS = {
    "no engine": _without_engine,
    "an engine that is a table": _set("render", "engine", to={"a": 1}),
    "10^30 images": _set(*_FIRST, "images", to=10**30),
    "2^62 images": _set(*_FIRST, "images", to=2**62),
    "nested 900 deep": _nested(900),
    "nested 5,000 deep": _nested(5000),
    "a lone surrogate": _set("object", to="\ud800"),
    "width 0": _set("camera", "width", to=0),
    "width -5": _set("camera", "width", to=-5),
    "width 10^6": _set("camera", "width", to=10**6),
    "a focal length that is NaN": _set("camera", "focal_px", to=float("nan")),
    "a tolerance that is NaN": _set("tolerance_px", to=float("nan")),
    "200,000 shards": _many,
    "a shard elsewhere": _set(*_FIRST, "file", to="../../outside/canary.h5"),
    "a seed of 10^400": _set("seed", to=10**400),
}


class NoFiles(Kind):
    """A pipe, a device, a socket, a folder, a link, a file without end under every name that is read."""

    name, cases = "no files", None
    modules = ("sets.dataset", "bench.leaderboard.results", "bench.models.recipe", "cli")
    bases = ("sets", "scores", "checkpoints", "zips", "predictions")

    def __init__(self, root):
        self._root = root
        self._attempts = [(target, what) for target in _TARGETS for what in _NO_FILES]

    @staticmethod
    def count():
        """Return how many there are."""
        return len(_TARGETS) * len(_NO_FILES)

    def attempt(self, place, number, rng):
        target, what = self._attempts[number]
        path, action = _TARGETS[target](self._root, place)
        whole = place.out / "whole"
        path.rename(whole)
        _NO_FILES[what](path, whole)
        return Attempt([target, what], action)


def _fifo(path, whole):
    os.mkfifo(path)


def _fifo_through_link(path, whole):
    os.mkfifo(whole.with_name("pipe"))
    path.symlink_to(whole.with_name("pipe"))


def _socket(path, whole):
    here = Path.cwd()
    os.chdir(path.parent)  # a socket's path is short
    with socket.socket(socket.AF_UNIX) as opened:
        opened.bind(path.name)
    os.chdir(here)


def _sparse(size):
    def make(path, whole):
        with path.open("wb") as file:
            file.truncate(size)

    return make


def _grown(path, whole):
    path.write_bytes(whole.read_bytes())
    os.truncate(path, 2**34)


_NO_FILES = {
    "a pipe": _fifo,
    "a pipe, through a link": _fifo_through_link,
    "a socket": _socket,
    "a link to /dev/zero": lambda path, whole: path.symlink_to("/dev/zero"),
    "a link to /dev/random": lambda path, whole: path.symlink_to("/dev/random"),
    "a link to /dev/null": lambda path, whole: path.symlink_to("/dev/null"),
    "a link to /dev/stdin": lambda path, whole: path.symlink_to("/dev/stdin"),
    "a folder": lambda path, whole: path.mkdir(),
    "a link to nothing": lambda path, whole: path.symlink_to("nothing"),
    "a link to itself": lambda path, whole: path.symlink_to(path.name),
    "a link to the whole file": lambda path, whole: path.symlink_to(whole),
    "an empty file": _sparse(0),
    "a file of 8 GiB": _sparse(2**33),
    "the whole file, grown to 16 GiB": _grown,
}


def _of_a_set(name, read):
    def target(root, place):
        original = next(one for one in read_originals(root / "sets") if one.folder.match("rendered/tetX"))
        folder = put_set(original, place.case)
        path = folder / (original.shards[0].name if name == "shard" else name)
        return path, partial(_READERS[read], original, folder, place, False)

    return target


def _of_an_object(name):
    def target(root, place):
        from symsol_annot.objects.spec import load_object

        for path in load_object("tetX").folder.glob("*.*"):
            (place.case / path.name).write_bytes(path.read_bytes())

        def read():
            load_object(str(place.case))
            return "right"

        return place.case / name, read

    return target


def _recipe(root, place):
    from importlib import resources

    from symsol_annot.bench.models.recipe import builtin_recipes, load_recipe

    source = resources.files("symsol_annot.bench.models").joinpath("recipes", f"{builtin_recipes()[0]}.toml")
    path = place.case / "recipe.toml"
    path.write_text(source.read_text())

    def read():
        load_recipe(str(path))
        return "right"

    return path, read


def _scores(root, place):
    paths = [place.case / f"{name}.json" for name in ("first", "second")]
    for path in paths:
        path.write_bytes((root / "scores" / path.name).read_bytes())
    return paths[0], partial(outcome_of_command, "compare", *paths)


def _weights(name, *command):
    def target(root, place):
        run = next((root / "checkpoints" / "runs").iterdir())
        for path in run.iterdir():
            (place.case / path.name).write_bytes(path.read_bytes())
        path, data = place.case / name, root / "checkpoints" / "data"

        def read():
            from symsol_annot.bench.models.weights.state_dicts import read_weights

            read_weights(path)
            return "right"

        by_command = partial(outcome_of_command, "predict", path, "--data", data, "--out", place.out / "p.h5")
        return path, by_command if command else read

    return target


def _zip(root, place):
    path = place.case / "symsol.zip"
    path.write_bytes((root / "zips" / path.name).read_bytes())
    return path, partial(outcome_of_command, "import-symsol", path, "--out", place.out / "sets", "--workers", 1)


def _predictions(command):
    def target(root, place):
        path = place.case / "preds.h5"
        path.write_bytes((root / "predictions" / "bases" / "gzip-earliest-all.h5").read_bytes())
        return path, partial(outcome_of_command, command, path, "--data", root / "predictions" / "data")

    return target


def _leaderboard(name):
    def target(root, place):
        for source in (root / "scores" / "board").rglob("*.*"):
            path = place.case / source.relative_to(root / "scores" / "board")
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(source.read_bytes())
        out = place.out / "page.md"
        return place.case / name, partial(outcome_of_command, "leaderboard", place.case, "--out", out)

    return target


def _scheduler_file(root, place):
    path = place.case / "scheduler.json"
    path.write_text('{"address": "tcp://127.0.0.1:1"}')

    def read():
        from symsol_annot.generation.dask.address import address_in

        address_in(path)
        return "right"

    return path, read


_TARGETS = {
    "manifest.json, load": _of_a_set("manifest.json", "load"),
    "manifest.json, info": _of_a_set("manifest.json", "info"),
    "shard, load": _of_a_set("shard", "load"),
    "shard, load unchecked": _of_a_set("shard", "load unchecked"),
    "shard, verify": _of_a_set("shard", "verify"),
    "object.toml": _of_an_object("object.toml"),
    "mesh.obj": _of_an_object("mesh.obj"),
    "recipe": _recipe,
    "scores": _scores,
    "weights.safetensors": _weights("weights.safetensors"),
    "weights.safetensors, predict": _weights("weights.safetensors", "predict"),
    "weights.pt": _weights("weights.pt"),
    "zip": _zip,
    "predictions, validate": _predictions("validate"),
    "predictions, score": _predictions("score"),
    "leaderboard's set.toml": _leaderboard("small/set.toml"),
    "leaderboard's result": _leaderboard("small/first.toml"),
    "leaderboard's thesis.toml": _leaderboard("thesis.toml"),
    "scheduler file": _scheduler_file,
}
