"""The sample set inside the package: a real one, small, whole, with every kind of view, made by one command."""

import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import symsol_annot
from symsol_annot.bench.predictions.truth import truth_of
from symsol_annot.errors import DataError
from symsol_annot.sets.manifest import read_manifest
from symsol_annot.sets.sample_set import SAMPLE_OBJECTS, sample_folder
from symsol_annot.sets.shard.reader import open_shard
from symsol_annot.sets.verify import verify
from symsol_annot.system.text.names import SPLITS

MAKEFILE = Path(__file__).parents[2] / "Makefile"
every_object = pytest.mark.parametrize("name", SAMPLE_OBJECTS)


@every_object
def test_the_sample_is_whole_and_consistent(name):
    assert verify(sample_folder() / name) == []


def test_the_folder_holds_these_objects_and_less_than_5_mb():
    assert sorted(path.name for path in sample_folder().iterdir()) == sorted(SAMPLE_OBJECTS)
    assert sum(path.stat().st_size for path in sample_folder().rglob("*.*")) < 5e6


@every_object
@pytest.mark.parametrize("split", SPLITS)
def test_it_opens_by_name_at_the_published_size_with_its_sets(name, split):
    dataset = symsol_annot.load_sample(name, split)
    assert (dataset.object, dataset.split, dataset.is_annotated) == (name, split, True)
    assert dataset[0].image.shape == (224, 224, 3)
    assert len(dataset[-1].symmetry_set) > 0


@every_object
def test_its_test_split_has_views_that_show_hide_and_barely_show_the_marking(name):
    strata = truth_of(symsol_annot.load_sample(name)).strata
    assert all(images.any() for images in strata.values()), strata
    assert {*strata} == {"all", "shown", "hidden", "barely"}


def test_without_arguments_it_is_the_test_split_of_cylO():
    assert repr(symsol_annot.load_sample()) == repr(symsol_annot.load(sample_folder() / "cylO", "test"))


@pytest.mark.parametrize("arguments", [("cube",), ("../data/cylO",), ("tetX", "validation")])
def test_what_the_sample_has_not_is_refused_with_what_it_has(arguments):
    with pytest.raises(DataError, match=r"cylO and tetX, found|it has train, test"):
        symsol_annot.load_sample(*arguments)


@every_object
def test_it_was_made_by_this_version(name):
    """Its version is in its bytes; `make sample` brings them up to date."""
    folder = sample_folder() / name
    for entry in read_manifest(folder).shards:
        with open_shard(folder / entry.file) as shard:
            assert shard.versions["symsol-annot"] == symsol_annot.__version__


@pytest.mark.blender
@every_object
def test_make_sample_makes_these_bytes(name, tmp_path):
    """Its own commands, given the set without one of its shards, make that again; another plan would be refused."""
    folder = Path(shutil.copytree(sample_folder() / name, tmp_path / name))
    lost = folder / read_manifest(folder).of_split("test")[-1].file
    bytes_before = {path.name: path.read_bytes() for path in folder.iterdir()}
    lost.unlink()
    words = [*render_of(name), "--out", str(tmp_path), "--workers", "1", "--repair"]
    command = [sys.executable, "-c", "from symsol_annot_cli.main import main; main()", *words]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if other_software := re.findall(r"^  - (.+: there .+, here .+)$", done.stderr, flags=re.MULTILINE):
        pytest.skip(f"the sample was made with other software: {other_software}")
    assert done.returncode == 0, done.stderr
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == bytes_before


def render_of(name):
    """The words of the Makefile's command for an object of the sample, from `render` on, without its --out."""
    command = rf"symsol-annot (render --object {name} .*) --out build/sample$"
    return shlex.split(re.search(command, MAKEFILE.read_text(), flags=re.MULTILINE)[1])
