"""Implicit-PDF: its loss is its equation, and what it predicts is the softmax of its logits over the grid."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from read_predictions import density_rows
from tiny_training import IMPLICIT_PDF

from symsol_annot.bench.models.batches import Batch
from symsol_annot.bench.models.inference import predict
from symsol_annot.bench.models.methods.classifier.negatives import random_rotations
from symsol_annot.bench.models.methods.implicit_pdf.method import METHOD, ImplicitPdfLearner
from symsol_annot.bench.models.training.checkpoints import open_checkpoint
from symsol_annot.bench.scoring.scoring import score_file
from symsol_annot.rotations.grid import equivolumetric_grid
from symsol_annot.rotations.so3 import uniform_rotations
from symsol_annot.sets.dataset import load

torch.set_num_threads(1)


@torch.no_grad()
def test_the_loss_is_the_softmaxs_at_the_images_rotation():
    rng = np.random.default_rng(0)
    images = torch.from_numpy(rng.integers(0, 256, (3, 16, 16, 3), dtype=np.uint8))
    batch = Batch(images, torch.from_numpy(uniform_rotations(3, rng)).float())
    recipe = replace(IMPLICIT_PDF, queries=9)
    model = METHOD.new_model(recipe, None, torch.Generator().manual_seed(0)).eval()
    losses = ImplicitPdfLearner(recipe, model).losses(batch, 0.0, torch.Generator().manual_seed(5))
    others = random_rotations((3, 8), torch.Generator().manual_seed(5))
    embeddings = model.first_stage(images)
    for i in range(3):
        asked = torch.cat([batch.R_gt[i : i + 1], others[i]])
        z = model.logits(embeddings[i : i + 1], asked)[0].double()
        assert float(losses[i]) == pytest.approx(-math.log(z[0].exp() / z.exp().mean()), abs=1e-4)


def test_what_is_predicted_is_the_softmax_over_the_grid(trained, data, tmp_path):
    checkpoint = open_checkpoint(trained["implicit-pdf"])
    with load(data / "tetX") as test:
        path = tmp_path / "preds.h5"
        assert predict(checkpoint, test, path, torch.device("cpu"), level=1) == ("density",)
        image = torch.from_numpy(test[1].image)[None]
    grid = torch.from_numpy(equivolumetric_grid(1)).float()
    with torch.no_grad():
        expected = torch.log_softmax(checkpoint.model(image, grid)[0].double(), 0).numpy()
    indices, log_p = density_rows(path)[1]
    np.testing.assert_array_equal(indices, np.arange(len(grid)))
    np.testing.assert_allclose(log_p, expected, atol=1e-4)
    assert set(score_file(path, data).tracks) == {"density"}
