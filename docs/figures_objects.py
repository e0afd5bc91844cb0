"""Draws the pictures of docs/objects.md, of the objects that ship with parts: .venv/bin/python docs/figures_objects.py.

Each shows four images of a test split of seed 0, at 224 pixels, with their segmentations and their symmetry sets; of
sphereX, a second shows the volume of the image that hides all on the map of directions.
"""

import sys
from pathlib import Path

import numpy as np

from symsol_annot.annotation.annotator import Annotator
from symsol_annot.objects.spec import load_object
from symsol_annot.plotting.contact_sheet import contact_sheet
from symsol_annot.plotting.rotations import plot_sets
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.render_process import RenderProcess
from symsol_annot.rendering.settings import RenderSettings
from symsol_annot.sets.dataset import Sample
from symsol_annot.sets.plan import label_rotation
from symsol_annot.sets.stated.equality import PartsOfSet

IMAGES = {
    "sphereX": (6, 31, 1736, 0),  # X and disc in view, the X alone, the disc alone, neither
    "mug": (0, 1, 4, 5),  # the handle in view, out of sight, by a sliver, from above
    "nut": (0, 2, 3, 5),
    "screw": (3, 0, 2, 1),  # the socket in view, out of sight, by a sliver, out of sight
    "dots": (6, 1, 7, 16),  # both dots in view, one, none from the end, none from the side
    "die": (0, 9, 32, 4),  # two and three faces in view, and one
    "box": (1, 39, 30, 6),
}


def main():
    """Draw the pictures of the objects that are named, or of all."""
    for name in sys.argv[1:] or IMAGES:
        path = Path(__file__).parent / "images" / f"object-{name}.png"
        draw(name, path)
        print(path)


def draw(name, path):
    """Draw four images of an object, and what is known of them."""
    spec, camera, settings = load_object(name), Camera.filling(224), RenderSettings()
    parts = PartsOfSet(tuple(part.name for part in spec.parts), spec.mesh.breaking, spec.tolerance_px)
    with RenderProcess(spec, camera, settings) as renderer:
        annotator = Annotator.for_object(spec, camera, settings, renderer)
        samples = [sample_of(annotator, label_rotation(0, name, "test", index), index) for index in IMAGES[name]]
    contact_sheet(samples, path, columns=2, parts=parts)
    if samples[-1].symmetry_set.volume is not None:
        plot_sets(samples[-1:], path.with_name(f"volume-{name}.png"), "mollweide")


def sample_of(annotator, R_gt, index):
    """Draw and annotate one image."""
    view = annotator.renderer.render(R_gt)
    shown_px = annotator.shown_px(R_gt, view)
    annotation = annotator.annotate(R_gt, shown_px, view)
    return Sample(
        index,
        view.rgb,
        view.segmentation,
        R_gt,
        shown_px,
        bool(annotator.is_shown(shown_px)),
        annotation.mask,
        annotator.spec.symmetry_group,
        view.part_pixels.astype(np.float32),
        volume=annotation.volume,
    )


if __name__ == "__main__":
    main()
