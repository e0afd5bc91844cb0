"""The command `gallery`: what it writes and says, and the object that it draws with."""

from functools import partial

import pytest
from gallery_files import documents
from numpy_renderer import NumpyRenderer

from symsol_annot.gallery.redrawn import Redrawer


def test_the_command_writes_the_folder_and_says_where(here, data, preds, tmp_path):
    out = tmp_path / "page"
    words = (data, "--predictions", preds["tetX"], "--redrawn", "0", "--out", out)
    done = here("gallery", *words)
    assert (done.returncode, done.stdout, done.stderr) == (0, f"{out / 'index.html'}: 110 images, 3 runs\n", "")
    _, index = documents(out / "data" / "index.js")
    assert {one["redrawn"]["missing"] for one in index["sets"]} == {"the gallery was made with --redrawn 0"}
    refused = here("gallery", data, "--predictions", tmp_path / "none.h5", "--out", out)
    assert (refused.returncode, refused.stderr.count("Error:")) == (1, 1)
    assert here("gallery", data, "--split", "validation").returncode == 2


@pytest.mark.parametrize(("name", "reason"), [("flask", ""), ("other", "was made from another flask")])
def test_the_command_draws_with_the_object_that_it_is_given(monkeypatch, here, mugs, tmp_path, name, reason):
    drawn_by_numpy = partial(Redrawer, open_renderer=lambda spec, camera, settings: NumpyRenderer("tetX", camera.width))
    monkeypatch.setattr("symsol_annot_cli.gallery.Redrawer", drawn_by_numpy)
    assert here("gallery", mugs / "set", "--object", mugs / name, "--out", tmp_path / "page").returncode == 0
    _, index = documents(tmp_path / "page" / "data" / "index.js")
    redrawn = index["sets"][0]["redrawn"]
    assert redrawn["images"] == ([] if reason else [0, 1, 2])
    assert reason in redrawn["missing"]
