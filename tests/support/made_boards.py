"""Leaderboards of made-up results on a small set, and what their pages say."""

import json
import re
import shutil
from pathlib import Path

from scipy.spatial.transform import Rotation

from symsol_annot.bench.leaderboard.page import to_markdown
from symsol_annot.bench.leaderboard.results import read_leaderboard
from symsol_annot.bench.predictions.writing.submission import write_classifier, write_hypotheses
from symsol_annot.bench.scoring.reports import report
from symsol_annot.bench.scoring.scoring import score_file

ROOT = Path(__file__).resolve().parents[2]
FILES = ROOT / "docs" / "results" / "leaderboard"
IMAGES = 24


def add_result(place, name, path, images, keys="", seed=7):
    """Score a predictions file as a result of a set's folder."""
    scores = score_file(path, images.folder)
    (place / f"{name}.json").write_text(report.to_json(report.to_document([scores])))
    (place / f"{name}.toml").write_text(
        f'title = "The {name} one"\nby = "a lab"\ndate = 2026-01-02\nhardware = "an abacus"\n'
        f'commands = ["./{name}.sh"]\n{keys}\n[objects.tetX]\nseed = {seed}\nminutes = 3.25\n'
    )


def turned(images, error_rad):
    """One hypothesis per image, R_gt with an error."""
    return (images.labels().rotation @ Rotation.from_rotvec([error_rad, 0, 0]).as_matrix())[:, None]


def make_board(folder, images):
    """Make a board with one set and two results on it, the second with larger errors and a classifier's track too."""
    shutil.copy(FILES / "thesis.toml", folder)
    place = folder / "tiny"
    place.mkdir()
    (place / "set.toml").write_text(
        f'title = "Tiny"\nsplit = "test"\nimages = {IMAGES}\ncommands = ["symsol-annot render --object tetX"]\n'
        f'[fingerprints]\ntetX = "{images.fingerprint}"\n'
    )
    for name, error_rad in {"near": 0.01, "far": 0.3}.items():
        path = folder / f"{name}.h5"
        write_hypotheses(path, images, turned(images, error_rad), method=name)
        if name == "far":
            write_classifier(path, images, lambda _, R: 0.9 * (R[:, 0, 0] > 0.5), method=name, level=4, progress=False)
        recipe = "ewta-von-mises" if name == "near" else "small-wta"
        add_result(place, name, path, images, f'recipe = "{recipe}"')
        path.unlink()
    return folder


def page_of(folder):
    return to_markdown(read_leaderboard(folder), str(folder), "files", "page.md")


def tables_of(page):
    """Title of each heading to the rows below it, cells stripped."""
    tables = {}
    for part in re.split(r"^#+ ", page, flags=re.MULTILINE)[1:]:
        rows = [
            [cell.strip() for cell in line.strip("|").split(" | ")] for line in part.splitlines() if line[:1] == "|"
        ]
        tables[part.splitlines()[0]] = rows
    return tables


def edited(path, *keys, value):
    """Change one value of a JSON file."""
    document = json.loads(path.read_text())
    table = document
    for key in keys[:-1]:
        table = table[key]
    table[keys[-1]] = value
    path.write_text(json.dumps(document))


def change_of(file, before, after):
    def change(place):
        text = (place / file).read_text()
        assert before in text
        (place / file).write_text(text.replace(before, after))

    return change
