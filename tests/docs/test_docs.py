"""What the documents say is what the code does: their code runs, their links lead somewhere."""

import json
import re
import subprocess
import sys
from fractions import Fraction
from functools import partial
from pathlib import Path

import datasets
import h5py
import numpy as np
import pytest
from made_sets import make_set
from torch.utils.data import DataLoader

import symsol_annot
from symsol_annot.bench.predictions.foreign.forms import FORMS
from symsol_annot.bench.predictions.foreign.frames import FRAMES
from symsol_annot.bench.predictions.format import FILE_ATTRIBUTES, IMAGE_INDEX
from symsol_annot.bench.predictions.tracks.classifier import CLASSIFIER_ATTRIBUTES
from symsol_annot.bench.predictions.tracks.table import TRACKS
from symsol_annot.bench.predictions.truth import truth_of
from symsol_annot.bench.scoring import reference, scoring
from symsol_annot.rendering.camera import Camera
from symsol_annot.rotations.so3 import uniform_rotations
from symsol_annot.torch import SymsolDataset

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/*.md"), *ROOT.glob("examples/**/*.md")])


def code_blocks(page, language):
    return re.findall(rf"```{language}\n(.*?)```", (ROOT / page).read_text(), flags=re.DOTALL)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_to_files_and_headings(page):
    for target in re.findall(r"\]\((?!https?:)([^)]+)\)", page.read_text()):
        path, _, heading = target.partition("#")
        linked = (page.parent / path) if path else page
        assert linked.exists(), f"{page.name} links to {target}"
        if heading:
            headings = re.findall(r"^#+ (.+)$", linked.read_text(), flags=re.MULTILINE)
            assert heading in {re.sub(r"[^\w\- ]", "", h).strip().lower().replace(" ", "-") for h in headings}


def test_the_three_lines_of_the_format_page_read_a_shard(tmp_path, monkeypatch):
    """Exactly those lines, run where a set named data/cylO lies, give what load() gives."""
    block = code_blocks("docs/format.md", "python")[0]
    assert len(block.strip().splitlines()) == 3
    folder = make_set(tmp_path / "data", "tetX", test=20).rename(tmp_path / "data" / "cylO")
    (folder / "test-00000-of-00002.h5").rename(folder / "test-00000-of-00010.h5")
    monkeypatch.chdir(tmp_path)
    names = {"h5py": h5py, "i": 3}
    exec(block, names)
    with names["f"] as file:
        (folder / "test-00000-of-00010.h5").rename(folder / "test-00000-of-00002.h5")
        sample = symsol_annot.load(folder)[3]
        assert np.array_equal(names["image"], sample.image)
        assert np.array_equal(names["R"], sample.rotation)
        assert np.array_equal(names["S"], sample.symmetry_set)
        documented = set(re.findall(r"^\| `(\w+)`", (ROOT / "docs/format.md").read_text(), flags=re.MULTILINE))
        assert set(file) <= documented
    attributes = re.findall(r"`(\w+)`", (ROOT / "docs/format.md").read_text())
    with h5py.File(folder / "test-00000-of-00002.h5") as file:
        assert set(file.attrs) <= set(attributes)


def test_the_readme_example_runs(tmp_path, monkeypatch, capsys):
    make_set(tmp_path / "data", "tetX", test=4).rename(tmp_path / "data" / "cylO")
    monkeypatch.chdir(tmp_path)
    names = {}
    reading, scoring_it, _ = code_blocks("README.md", "python")
    exec(reading, names)
    assert names["sample"].symmetry_set.shape[1:] == (3, 3)
    exec(scoring_it, {})
    assert capsys.readouterr().out.startswith(
        "cylO, test split, 64 images: in memory\n  hypotheses: F-measure at 5 deg"
    )


@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
@pytest.mark.filterwarnings("ignore:This DataLoader will create")  # on a machine of one core
def test_the_examples_of_the_loading_page_read_every_image(tmp_path, monkeypatch):
    folder = make_set(tmp_path / "data", "tetX", train=20, test=0, annotate="all")
    folder.rename(tmp_path / "data" / "cylO")
    monkeypatch.chdir(tmp_path)
    *blocks, processes = code_blocks("docs/loading.md", "python")
    names = {"images": []}
    for block in blocks:
        exec(block.replace('batch["image"]', 'images.extend(batch["image"])').replace("range(10)", "range(2)"), names)
    assert {tuple(image.shape) for image in names["images"]} == {(3, 32, 32)}
    assert len(names["images"]) == 2 * 2 * 20  # loops, epochs
    assert sorted(names["order"]) == sorted(item["index"] for item in names["part"])
    Path("script.py").write_text(processes)
    done = subprocess.run([sys.executable, "script.py"], capture_output=True, text=True, check=True)
    means = [sample.image.mean() for sample in symsol_annot.load("data/cylO", "train")]
    assert np.mean(eval(done.stdout)) == pytest.approx(np.mean(means))


def test_each_line_of_the_loading_page_reads_the_same_rotations(tmp_path, monkeypatch):
    folder = make_set(tmp_path / "data", "tetX", train=6, test=0, annotate="all")
    folder.rename(tmp_path / "data" / "cylO")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HF_DATASETS_CACHE", str(tmp_path / "cache"))
    table = (ROOT / "docs/loading.md").read_text().split("## One line for each reader")[1].split("```")[0]
    lines = [row.split(" | ")[1].split("`")[1] for row in table.splitlines() if row.startswith("| ") and "`" in row]
    package, batches, tensors, rows = lines[:4]
    names = {"symsol_annot": symsol_annot, "DataLoader": DataLoader, "SymsolDataset": SymsolDataset}
    names["load_dataset"] = partial(datasets.load_dataset, cache_dir=str(tmp_path / "cache"))
    samples = eval(package, names)
    known = np.stack([sample.rotation for sample in samples])
    (batch,) = eval(batches, names)
    assert np.array_equal([sample.rotation for sample in batch], known)
    assert [len(sample.symmetry_set) for sample in batch] == [len(sample.symmetry_set) for sample in samples]
    (stacked,) = eval(tensors, names)
    assert np.allclose(stacked["rotation"], known, atol=1e-6)
    assert np.array_equal(eval(rows, names)["train"]["rotation"], known)


@pytest.mark.parametrize("page", ["README.md", "docs/install.md"])
def test_files_that_a_page_installs_are_named_after_this_version(page):
    names = re.findall(r"symsol_annot-([\d.]+)(?:-py3-none-any\.whl|\.tar\.gz)", (ROOT / page).read_text())
    assert names
    assert set(names) == {symsol_annot.__version__}


def test_the_projection_of_the_conventions_page_is_the_cameras():
    camera = Camera.filling(224)
    names = {"distance": camera.distance, "focal_px": camera.focal_px, "width": 224, "height": 224}
    for R_m2c, point_m in zip(uniform_rotations(5, np.random.default_rng(0)), np.eye(5, 3), strict=True):
        names |= {"R_m2c": R_m2c, "point_m": point_m}
        exec(code_blocks("docs/conventions.md", "python")[0], names)
        assert np.allclose([names["u"], names["v"]], camera.project(R_m2c @ point_m))
    assert f"{camera.focal_px:.3f}" in (ROOT / "docs/conventions.md").read_text()


def test_the_example_of_the_metrics_page_gives_what_it_says():
    lines = code_blocks("docs/metrics.md", "python")[0].splitlines()
    names = {}
    exec("\n".join(lines[:6]), names)
    said = {line.split("  # ")[0]: line.split("  # ")[1] for line in lines if "  # " in line}
    for code, comment in said.items():
        value = eval(code.split(" = ")[-1], names)
        names[code.split(" = ")[0]] = value
        numbers = [
            float(Fraction(n)) for n in re.findall(r"\d+(?:/\d+|\.\d+)?", comment.split(":")[0].split("from")[0])
        ]
        assert np.allclose(value, numbers, atol=1e-3), (code, value, comment)


def test_the_submission_page_is_enough_to_get_a_score(tmp_path, monkeypatch, capsys):
    """Its writers and its lines of h5py make files that are valid and score alike."""
    make_set(tmp_path / "data", "tetX", test=4)
    monkeypatch.chdir(tmp_path)
    blocks = code_blocks("docs/submission.md", "python")
    first, writers, by_hand = (block.replace("cylO", "tetX") for block in blocks)  # whose candidates are few
    hypotheses = uniform_rotations(4 * 5, np.random.default_rng(0)).reshape(4, 5, 3, 3)
    images = [sample.image.tobytes() for sample in symsol_annot.load("data/tetX")]
    names = {
        "predict": lambda image: hypotheses[images.index(image.tobytes())],
        "probability": lambda image, R: np.full(len(R), 0.05),
        "log_density": lambda image, R: np.zeros(len(R)),
    }
    exec(first, names)
    by_writer = scoring.score_file(Path("preds.h5"), Path("data"))
    exec(writers, names)
    tracks = scoring.score_file(Path("preds.h5"), Path("data")).tracks
    assert set(tracks) == {"hypotheses", "classifier", "density"}
    assert tracks["density"].figures["all"]["log_likelihood"].value == pytest.approx(-2.2895, abs=1e-4)
    Path("preds.h5").unlink()
    exec(by_hand, {"hypotheses": hypotheses})
    scored = scoring.score_file(Path("preds.h5"), Path("data"))
    assert str(scored.tracks["hypotheses"].figures) == str(by_writer.tracks["hypotheses"].figures)


def test_the_page_on_scoring_in_python_runs_and_gives_what_it_says(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    names = {}
    for block in code_blocks("docs/scoring-in-python.md", "python"):
        exec(block, names)
        if "headline" in block and "metric" not in block:
            (figure,) = re.findall(r'"hypotheses": (0\.\d+)\.\.\.', block)
            assert f"{names['scores'].headline['hypotheses']:.6f}".startswith(figure)
    printed = capsys.readouterr().out
    assert printed.startswith("tetX, test split, 64 images: in memory\n  hypotheses: F-measure at 5 deg 0.78")
    assert (tmp_path / "scores.json").is_file()
    assert names["scores"].image_index.tolist() == list(range(8))


def test_the_pages_name_every_form_and_frame():
    page = (ROOT / "docs/scoring-in-python.md").read_text()
    assert all(f"`{name}`" in page for name in FORMS)
    assert all(f"| `{name}` |" in (ROOT / "docs/conventions.md").read_text() for name in FRAMES)


def test_the_submission_page_names_every_attribute_and_data_set():
    text = (ROOT / "docs/submission.md").read_text()
    documented = set(re.findall(r"`(\w+)`", text))
    datasets = {name for track in TRACKS.values() for name in track.datasets} | {IMAGE_INDEX}
    assert datasets | set(FILE_ATTRIBUTES) | set(CLASSIFIER_ATTRIBUTES) <= documented


def test_the_metrics_page_defines_every_metric(tmp_path):
    folder = make_set(tmp_path, "tetX", test=2)
    text = (ROOT / "docs/metrics.md").read_text()
    dataset = symsol_annot.load(folder)
    known = truth_of(dataset)
    path = tmp_path / "preds.h5"
    reference.truth(path, dataset, known)
    for track in scoring.score_file(path, folder).tracks.values():
        for metric in track.per_image.values:
            name = re.sub(r"(_at|_above)_[\d.]+(_deg)?$", r"\1_T\2", metric)
            assert name in text or (name.endswith("_ceiling") and "`.._ceiling`" in text), metric


def test_the_table_of_attacks_is_what_was_recorded():
    recorded = json.loads((ROOT / "docs" / "results" / "attack.json").read_text())
    page = (ROOT / "docs" / "safety.md").read_text()
    for kind, now in recorded["after"]["kinds"].items():
        before = recorded["before"]["kinds"].get(kind)
        earlier = [f"{before['cases']:,}", failed(before)] if before else ["", ""]
        cells = [kind, *earlier, f"{now['cases']:,}", failed(now)]
        assert f"| {' | '.join(cells)} | {now['slowest_s']} | {now['peak_mib']} |" in page
    for kind, now in recorded["archives, BOP and meshes"]["kinds"].items():
        cells = [kind, f"{now['cases']:,}", failed(now), str(now["slowest_s"]), str(now["peak_mib"])]
        assert f"| {' | '.join(cells)} |" in page


def failed(row):
    return ", ".join(f"{count} {end}" for end, count in row["ends"].items() if end not in ("right", "refused")) or "0"
