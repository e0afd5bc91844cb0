"""Fixtures of the leaderboard: a folder with a small set, and two results on it."""

import shutil
from pathlib import Path

import pytest
from bench_sets import small_set
from leaderboard_files import FILES, IMAGES
from scipy.spatial.transform import Rotation

from symsol_annot.bench.predictions.writing.submission import write_classifier, write_hypotheses
from symsol_annot.bench.scoring import report
from symsol_annot.bench.scoring.scoring import score_file


@pytest.fixture(scope="module")
def images(tmp_path_factory):
    return small_set(tmp_path_factory.mktemp("sets"), "tetX", IMAGES)


@pytest.fixture(scope="module")
def original(images, tmp_path_factory):
    """A folder with one set and two results on it, the second with larger errors and a classifier's track as well."""
    folder = tmp_path_factory.mktemp("board")
    shutil.copy(FILES / "thesis.toml", folder)
    place = folder / "tiny"
    place.mkdir()
    (place / "set.toml").write_text(
        f'title = "Tiny"\nsplit = "test"\nimages = {IMAGES}\ncommands = ["symsol-annot render --object tetX"]\n'
        f'[fingerprints]\ntetX = "{images.fingerprint}"\n'
    )
    for name, error_rad in {"near": 0.01, "far": 0.3}.items():
        path = folder / f"{name}.h5"
        turn = Rotation.from_rotvec([error_rad, 0, 0]).as_matrix()
        write_hypotheses(path, images, (images.labels().rotation @ turn)[:, None], method=name)
        if name == "far":
            write_classifier(path, images, lambda _, R: 0.9 * (R[:, 0, 0] > 0.5), method=name, level=4, progress=False)
        scores = score_file(path, images.folder)
        (place / f"{name}.json").write_text(report.to_json(report.to_document([scores])))
        path.unlink()
        (place / f"{name}.toml").write_text(
            f'title = "The {name} one"\nby = "a lab"\ndate = 2026-01-02\nhardware = "an abacus"\n'
            f'commands = ["./{name}.sh"]\nrecipe = "{"ewta-von-mises" if name == "near" else "small-wta"}"\n'
            "[objects.tetX]\nseed = 7\nminutes = 3.25\n"
        )
    return folder


@pytest.fixture
def folder(original, tmp_path):
    return Path(shutil.copytree(original, tmp_path / "board"))
