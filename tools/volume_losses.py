"""What losses of classifiers make of sets that fill a volume, on the validation images of their trainings.

python tools/volume_losses.py data/sphereX runs/sphereX-volume-classifier .. [--json docs/results/volume_losses.json]

Of each checkpoint, the means of recall, precision and F-measure at 0.8 over the images whose sets have a volume, over
the others, and over all; without what was fitted on these images, and with it.
"""

import argparse
import json
from pathlib import Path

import numpy as np
import torch

from symsol_annot import load
from symsol_annot.bench.models.methods.classifier.method import ClassifierLearner
from symsol_annot.bench.models.methods.classifier.recipe import ClassifierRecipe
from symsol_annot.bench.models.networks.rotation_classifier import RotationClassifier
from symsol_annot.bench.models.training.checkpoints import open_checkpoint
from symsol_annot.bench.models.training.split_reader import SplitReader
from symsol_annot.bench.models.validation import classifier_figures


def main():
    """Evaluate each checkpoint, and print and keep the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="the set that they were trained on")
    parser.add_argument("checkpoints", type=Path, nargs="+")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    found = {path.name: figures_of(path, load(arguments.folder, "train")) for path in arguments.checkpoints}
    print(json.dumps(found, indent=1))
    if arguments.json:
        arguments.json.write_text(json.dumps(found, indent=1) + "\n")


def figures_of(path, dataset):
    """Return a checkpoint's figures by what was added to its logits, and by images."""
    checkpoint = open_checkpoint(path)
    recipe, model = checkpoint.record.recipe, checkpoint.model
    assert isinstance(recipe, ClassifierRecipe), f"{path}: is of no classifier"
    assert isinstance(model, RotationClassifier)
    held_out = dataset[len(dataset) - recipe.validation_images :]
    labels, images = held_out.labels(), SplitReader(recipe.input_size).read(held_out).images
    learner = ClassifierLearner(recipe, model, dataset.symmetry_group)
    logits = list(learner.validation_logits(images, labels))
    shifts = {"as trained": 0.0, "fitted": checkpoint.record.calibration["logit_shift"]}
    has_volume = labels.volume >= 0
    chosen = {"with volume": has_volume, "without": ~has_volume, "all": np.ones_like(has_volume)}
    return {
        name: {
            "shift": shift,
            **{
                which: {
                    "images": int(rows.sum()),
                    **classifier_figures(logits[i].counts(shift) for i in np.flatnonzero(rows)),
                }
                for which, rows in chosen.items()
            },
        }
        for name, shift in shifts.items()
    }


if __name__ == "__main__":
    main()
