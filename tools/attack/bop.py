"""BOP datasets with half of their files, or with damaged ones, and CSV files of results."""

import json
import os
import shutil

import numpy as np

from attack import laws
from attack.commands import outcome_of_command, run_command
from attack.damage import damage_json, damage_text, json_bytes
from attack.kinds import SCORING, Attempt, Kind
from attack.signing import read_document

_LARGE = 2**25
_OBJECT_ID = 5
_DATASETS = {"lone": _OBJECT_ID, "exported": 1}  # to the id of an object in it
_NUMBERS = ("nan", "inf", "-1e400", "1e308", "0", "-0", "", "1_0", "0x1", "1.0", "٣", "9" * 400, "\x1b[2J", '"', "1 2")
_LINES = ("", ",,,,,,", "scene_id,im_id,obj_id,score,R,t,time", "\0" * 50, "x" * 10**6, "1,0,1", "﻿1,0,1,1")


def make_bop(folder):
    """Make a small BOP dataset, one that is exported from a set, that set, and results about it."""
    from bop_scene import write_dataset
    from made_sets import make_set

    from symsol_annot import load
    from symsol_annot.bop.export import export_bop, objects_in
    from symsol_annot.bop.numbering import scene_and_image

    folder.mkdir()
    write_dataset(folder / "lone", _OBJECT_ID)
    made = make_set(folder / "sets", "tetX", test=6, size=32)
    export_bop(objects_in([made]), folder / "exported")
    lines = ["scene_id,im_id,obj_id,score,R,t,time"]
    for index, R in enumerate(load(made).labels().rotation):
        scene_id, im_id = scene_and_image(1, index)
        matrix = " ".join(map(repr, R.ravel().tolist()))
        lines += [f"{scene_id},{im_id},1,{score},{matrix},0 0 400,0.1" for score in (1.0, 0.5)]
    (folder / "results.csv").write_text("\n".join(lines) + "\n")


class BopFolders(Kind):
    """The files of a BOP dataset: missing, of another kind, damaged."""

    name, cases = "BOP folders", 500
    modules, bases = ("bop.importing", "objects.importing.bop_models", "sets.dataset", "cli"), ("bop",)

    def __init__(self, root):
        self._folder = root / "bop"

    def attempt(self, place, number, rng):
        name = ("lone", "exported")[int(rng.random() < 0.3)]
        root = shutil.copytree(self._folder / name, place.case / name)
        done = [name]
        for _ in range(rng.choice([1, 1, 2, 3])):
            files = sorted(path for path in root.rglob("*") if _is_small(path))
            if not files:
                break
            change = CHANGES[rng.integers(len(CHANGES))]
            done.append(f"{change.__name__}: {change(root, files, rng)}")
        by_command = bool(rng.random() < 0.3)
        return Attempt(done, lambda: self._imported(root, _DATASETS[name], place.out, by_command=by_command))

    @staticmethod
    def _imported(root, obj_id, out, *, by_command):
        from symsol_annot import load
        from symsol_annot.bop.importing import Choice, import_bop

        outcome = "right"
        if by_command:
            outcome = outcome_of_command(
                "import-bop", root, "--id", obj_id, "--size", 32, "--out", out, "--workers", 1, "--name", "thing"
            )
        else:
            import_bop(root, out, Choice(obj_id, name="thing", size=32))
        shown = sorted(path.name for path in out.iterdir())
        if shown != (["thing"] if outcome == "right" else []):
            raise laws.SilentError(f"the folder of sets holds {shown}")
        if outcome == "right":
            if not read_document(out / "thing")["fingerprint"]:
                raise laws.SilentError("a set that is not finished")
            with load(out / "thing") as dataset:
                laws.check_labels(dataset.labels(), has_marking=False)
                for sample in dataset:
                    laws.check_sample(sample, dataset.image_size, len(dataset.parts))
        return outcome


def _is_small(path):
    """Tell whether a path is a file that can be damaged further: one of gigabytes would be read here."""
    return path.is_file() and not path.is_symlink() and path.stat().st_size < _LARGE


def _one(files, rng, endings=("",)):
    found = [path for path in files if path.name.endswith(endings)] or files
    return found[rng.integers(len(found))]


def half_of_the_files_missing(root, files, rng):
    for path in rng.permutation(np.array(files, dtype=object))[: max(1, len(files) // 2)]:
        path.unlink()
    return f"{len(files) // 2} of {len(files)}"


def file_missing(root, files, rng):
    path = _one(files, rng)
    path.unlink()
    return path.name


def folder_missing(root, files, rng):
    folders = sorted(path for path in root.rglob("*") if path.is_dir())
    shutil.rmtree(path := folders[rng.integers(len(folders))])
    return path.name


def json_damaged(root, files, rng):
    path = _one(files, rng, (".json",))
    try:
        document = json.loads(path.read_bytes())
    except ValueError:
        return "was damaged already"
    done = damage_json(document, rng)
    path.write_bytes(json_bytes(document))
    return f"{path.name} {done}"


def json_of_another_kind(root, files, rng):
    odd = (b"", b"[]", b"null", b"{", b"[" * 100_000, b"\xff\xfe", b'{"0": 1}', b'{"0": [[]]}', b"1" * 5000, b"NaN")
    path = _one(files, rng, (".json",))
    path.write_bytes(odd[rng.integers(len(odd))])
    return path.name


def text_damaged(root, files, rng):
    path = _one(files, rng, (".json", ".ply", ".txt"))
    text, done = damage_text(path.read_bytes().decode("latin-1"), rng)
    path.write_bytes(text.encode("latin-1", errors="replace"))
    return f"{path.name} {done}"


def bytes_damaged(root, files, rng):
    path = _one(files, rng, (".ply", ".png", ".jpg"))
    content = bytearray(path.read_bytes())
    if rng.random() < 0.3:
        path.write_bytes(content[: rng.integers(len(content) + 1)])
        return f"{path.name} cut"
    end = min(len(content), 300) if rng.random() < 0.5 else len(content)
    for at in rng.integers(0, max(1, end), rng.integers(1, 6)):
        if content:
            content[at] ^= 1 << int(rng.integers(8))
    path.write_bytes(content)
    return f"{path.name} flipped"


def pictures_swapped(root, files, rng):
    path, other = _one(files, rng, (".png", ".jpg")), _one(files, rng)
    path.write_bytes(other.read_bytes())
    return f"{path.name} is {other.name}"


def no_file(root, files, rng):
    """A pipe, a device or a folder in the place of a file."""
    path, kind = _one(files, rng), int(rng.integers(4))
    path.unlink()
    if kind == 0:
        os.mkfifo(path)
    elif kind == 1:
        path.mkdir()
    else:
        path.symlink_to(("/dev/zero", path.name)[kind - 2])
    return f"{path.name} {('a pipe', 'a folder', 'a device', 'a link to itself')[kind]}"


def larger_than_all(root, files, rng):
    """A file of gigabytes, most of which is a hole."""
    path = _one(files, rng)
    with path.open("r+b") as file:
        file.truncate(int(rng.choice([2**26, 2**33])))
    return path.name


CHANGES = (
    *(half_of_the_files_missing, half_of_the_files_missing, file_missing, folder_missing, json_of_another_kind),
    *(json_damaged, json_damaged, json_damaged, json_damaged, text_damaged, text_damaged, bytes_damaged, bytes_damaged),
    *(bytes_damaged, pictures_swapped, no_file, larger_than_all),
)


class BopResults(Kind):
    """CSV files of BOP's results."""

    name, cases = "BOP results", 500
    modules, bases = (*SCORING, "bop.results"), ("bop",)

    def __init__(self, root):
        self._data = root / "bop" / "sets" / "tetX"
        self._text = (root / "bop" / "results.csv").read_text()

    def attempt(self, place, number, rng):
        text, done = self._text, []
        for _ in range(rng.choice([1, 1, 2])):
            if rng.random() < 0.4:
                text, more = damage_text(text, rng)
                done += more
            else:
                change = CSV_CHANGES[rng.integers(len(CSV_CHANGES))]
                text = change(text, rng)
                done.append(change.__name__)
        content = bytearray(text.encode(errors="surrogatepass"))
        if rng.random() < 0.15 and content:
            content[rng.integers(len(content))] = int(rng.integers(256))
        path = place.case / "results.csv"
        path.write_bytes(content)
        by_command = bool(rng.random() < 0.3)
        return Attempt(done, lambda: self._written(path, place.out / "preds.h5", by_command=by_command))

    def _written(self, path, out, *, by_command):
        from symsol_annot import load
        from symsol_annot.bop.results import read_results, write_results

        if by_command:
            if run_command("import-bop-results", path, "--data", self._data, "--out", out):
                return "refused" if not out.exists() else self._silent("a refused file left predictions")
            return outcome_of_command("score", out, "--data", self._data)
        with load(self._data) as dataset:
            results = read_results(path, len(dataset))
            if not np.isfinite(results.score).all() or (results.score < 0).any():
                self._silent("a score that is none")
            laws.check_rotations(results.rotation)
            if results.index.min() < 0 or results.index.max() >= len(dataset):
                self._silent("an index of no image")
            write_results(out, dataset, results, method="mine", fill_missing=True)
        return outcome_of_command("validate", out, "--data", self._data)

    @staticmethod
    def _silent(words):
        raise laws.SilentError(words)


def odd_number(text, rng):
    lines = text.split("\n")
    at = int(rng.integers(len(lines)))
    fields = lines[at].split(",")
    place = int(rng.integers(len(fields)))
    words = fields[place].split(" ")
    words[rng.integers(len(words))] = _NUMBERS[rng.integers(len(_NUMBERS))]
    fields[place] = " ".join(words)
    lines[at] = ",".join(fields)
    return "\n".join(lines)


def field_more_or_less(text, rng):
    lines = text.split("\n")
    at = int(rng.integers(len(lines)))
    fields = lines[at].split(",")
    place = int(rng.integers(len(fields)))
    fields[place : place + 1] = [] if rng.random() < 0.5 else [fields[place], "1"]
    lines[at] = ",".join(fields)
    return "\n".join(lines)


def odd_line(text, rng):
    lines = text.split("\n")
    lines.insert(int(rng.integers(len(lines) + 1)), _LINES[rng.integers(len(_LINES))])
    return "\n".join(lines)


def other_separators(text, rng):
    old, new = ((",", ";"), (",", "\t"), (" ", "  "), (" ", ","), ("\n", "\r\n"), ("\n", "\r"), (".", ","))[
        rng.integers(7)
    ]
    return text.replace(old, new)


def quoted(text, rng):
    return "\n".join(",".join(f'"{field}"' for field in line.split(",")) for line in text.split("\n"))


def many_lines(text, rng):
    line = text.split("\n")[:2][-1]
    return text + f"{line}\n" * int(rng.choice([100, 5000, 40_000]))


def nothing(text, rng):
    return ("", "\n", text.split("\n")[0])[rng.integers(3)]


CSV_CHANGES = (
    odd_number,
    odd_number,
    odd_number,
    field_more_or_less,
    odd_line,
    other_separators,
    quoted,
    many_lines,
    nothing,
)
