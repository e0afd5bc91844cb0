"""The card of the published sets, dataset_card.md, and the figures that it states.

python tools/dataset_card.py write                        # dataset_card.md, from docs/results/dataset_card.json
python tools/dataset_card.py measure [--sets data]        # those figures, measured again; then the card
python tools/dataset_card.py measure --object tetX --split test

A split of 45,000 or 5,000 images that was rendered into a folder of --sets is measured as `publish` measures it, and a
test split must have the fingerprint that docs/results/leaderboard/published/set.toml states. Of the others, the labels
alone are made, in the same way but for the pictures: a marking's area is bounded by geometry and counted by Blender
where that does not decide, on about 5 ms per image. How large their files are is not measured then.
"""

import argparse
import json
import tempfile
import tomllib
from collections import Counter
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from tqdm import tqdm

from symsol_annot.annotation.visibility import MarkingVisibility
from symsol_annot.bench.predictions.truth import BARELY_PX
from symsol_annot.generation.events import ImagesMade
from symsol_annot.generation.executors import in_process
from symsol_annot.generation.generate import generate
from symsol_annot.objects.spec import load_object
from symsol_annot.publish.about import About
from symsol_annot.publish.bundle import Bundle
from symsol_annot.publish.card import card
from symsol_annot.publish.figures import SplitFigures, from_document, measure, measure_labels, to_document
from symsol_annot.publish.publication import publish
from symsol_annot.publish.sets import PublishedSet, sets_in
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.render_process import RenderProcess
from symsol_annot.rendering.renderer import View
from symsol_annot.rendering.settings import RenderSettings
from symsol_annot.sets.dataset import load
from symsol_annot.sets.manifest import read_manifest
from symsol_annot.sets.plan import SetPlan
from symsol_annot.sets.statistics import SplitStatistics
from symsol_annot.system.closing import Closing

PROJECT = Path(__file__).resolve().parents[1]
CARD = PROJECT / "dataset_card.md"
FIGURES = PROJECT / "docs" / "results" / "dataset_card.json"
PUBLISHED = PROJECT / "docs" / "results" / "leaderboard" / "published" / "set.toml"
IMAGES = {"train": 45_000, "test": 5_000}  # what `render` makes unless told otherwise
SIZE = 224


def main():
    """Measure, or write the card of what was measured."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("write", "measure"))
    parser.add_argument("--sets", type=Path, default=Path("data"))
    parser.add_argument("--object", choices=objects(), action="append")
    parser.add_argument("--split", choices=IMAGES, action="append")
    arguments = parser.parse_args()
    if arguments.what == "measure":
        for name in arguments.object or objects():
            for split in arguments.split or IMAGES:
                keep(name, split, figures_of(name, split, arguments.sets / name))
    CARD.write_text(rendered(), encoding="utf-8")


def rendered():
    """Return the card of the splits that were measured, as `publish` writes it."""
    kept = json.loads(FIGURES.read_text(encoding="utf-8"))
    sets = [
        PublishedSet(name, Path(name), plan_of(name, {split: IMAGES[split] for split in splits}).manifest())
        for name, splits in sorted(kept.items())
    ]
    return card(About(), tuple(sets), from_document(kept))


def objects():
    """Return the names of the objects of the published sets."""
    return tuple(tomllib.loads(PUBLISHED.read_text(encoding="utf-8"))["fingerprints"])


def plan_of(name, images):
    """Return the plan by which `render --object NAME` makes its set."""
    return SetPlan(load_object(name), images, 0, Camera.filling(SIZE), RenderSettings(), "all")


def keep(name, split, figures):
    """Put the figures of one split into the file, beside those of the others."""
    document = json.loads(FIGURES.read_text(encoding="utf-8")) if FIGURES.exists() else {}
    document.setdefault(name, {}).update(to_document({(name, split): figures})[name])
    in_order = {
        name: {split: document[name][split] for split in IMAGES if split in document[name]} for name in document
    }
    FIGURES.write_text(json.dumps(in_order, indent=1) + "\n", encoding="utf-8")


def figures_of(name, split, folder):
    """Return the figures of a split: of the rendered set where it is there, else of labels alone."""
    if (folder / "manifest.json").exists() and read_manifest(folder).images(split) == IMAGES[split]:
        return of_rendered(name, split, folder)
    plan = plan_of(name, {split: IMAGES[split]})
    return of_labels(plan, split) if plan.spec.marking else without_marking(plan, split)


def of_rendered(name, split, folder):
    """Return what `publish` measures of a split, if it is the published one."""
    if split == "test":
        stated = tomllib.loads(PUBLISHED.read_text(encoding="utf-8"))["fingerprints"][name]
        with load(folder, split) as dataset:
            assert dataset.fingerprint == stated, f"{folder} is not the published set: {dataset.fingerprint}"
    (published,) = sets_in(folder)
    with tempfile.TemporaryDirectory() as place:
        publish((published,), Path(place) / "bundle", About())
        return measure(published, split, Bundle(Path(place) / "bundle", {}))


def of_labels(plan, split):
    """Return the figures of a marked object's split, made without its pictures."""
    with tempfile.TemporaryDirectory() as place, tqdm(total=plan.images[split], unit="image") as bar:
        folder = Path(place) / plan.spec.name
        executor = partial(in_process, open_renderer=lambda: Unpictured(plan))
        generate(plan, folder, executor, lambda event: bar.update(isinstance(event, ImagesMade) and event.images))
        (published,) = sets_in(folder)
        return measure_labels(published, split)


def without_marking(plan, split):
    """Return the figures of a split without a marking: by the rule, every candidate is in every set."""
    images, order = plan.images[split], len(plan.spec.symmetry_group)
    statistics = SplitStatistics(
        has_marking=False, is_annotated=True, images=images, set_sizes=Counter({order: images})
    )
    return SplitFigures(order, replace(statistics, candidates_drawn=images * order), None, None, None)


class Unpictured(Closing):
    """A renderer whose views are blank, and show a marking by an area that counts as the real one does.

    An area is 0 where the real one is, below T where it is, and below the 20 pixels that "barely" stands for where it
    is: geometry tells most of that, and Blender counts the others.
    """

    def __init__(self, plan):
        camera, settings = plan.camera, plan.settings
        self._renderer = RenderProcess(plan.spec, camera, settings)
        self._visibility = MarkingVisibility(plan.spec.mesh, camera, settings)
        self._per_pixel = settings.points_per_pixel
        self._rgb = np.full((camera.height, camera.width, 3), 255, dtype=np.uint8)

    @property
    def versions(self):
        """The software that counts."""
        return self._renderer.versions

    def render(self, R_m2c):
        """Return a blank view under one rotation (3, 3)."""
        enough = BARELY_PX * self._per_pixel
        (lower,), (upper,) = self._visibility.bounds(R_m2c[None], enough)
        is_decided = lower >= enough or upper == 0
        area_px = lower / self._per_pixel if is_decided else self.marking_pixels(R_m2c[None])[0]
        return View(self._rgb, np.zeros_like(self._rgb[..., 0]), np.array([0.0, area_px]))

    def marking_pixels(self, R_m2c):
        """Return the marking's visible area under each of (n, 3, 3) rotations, as Blender counts it: (n,)."""
        return self._renderer.marking_pixels(R_m2c)

    def label_windows(self, R_m2c):
        """Return what lies around the marking under each of (n, 3, 3) rotations, as Blender draws it."""
        return self._renderer.label_windows(R_m2c)

    def lit_windows(self, R_m2c):
        """Return what `label_windows` does, and the colour at each point, as Blender draws it."""
        return self._renderer.lit_windows(R_m2c)

    def close(self):
        """End Blender's process."""
        self._renderer.close()


if __name__ == "__main__":
    main()
