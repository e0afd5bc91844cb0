"""Sets made with the numpy renderer, which cost little."""

from functools import partial

from numpy_renderer import NumpyRenderer

from symsol_annot.annotation.annotator import Annotator
from symsol_annot.generation.events import ImagesMade, Started
from symsol_annot.generation.executors import in_process
from symsol_annot.generation.generate import generate
from symsol_annot.objects.spec import load_object
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.settings import RenderSettings
from symsol_annot.sets.plan import SetPlan

SIZE = 32


def make_plan(name="tetX", train=0, test=40, seed=0, size=SIZE, annotate="test", depth=False):
    images, settings = {"train": train, "test": test}, RenderSettings(depth=depth)
    return SetPlan(load_object(name), images, seed, Camera.filling(size), settings, annotate)


def pixels_of(spec, R, renderer):
    """The area by which the image at R shows the marking, as a set would store it."""
    view_px = float(renderer.marking_pixels(R[None])[0]) if spec.marking else 0.0
    return Annotator(spec, renderer).coset_px(R, view_px)


def threads(open_renderer, workers=1, *, exhaustive=False):
    """Who makes the shards in most tests: threads of this process, each with a renderer."""
    return partial(in_process, open_renderer=open_renderer, workers=workers, exhaustive=exhaustive)


def on_images(call):
    """From what is to be called for each image to what is told of events."""

    def on_event(event):
        count = {Started: "images_there", ImagesMade: "images"}.get(type(event))
        for _ in range(getattr(event, count) if count else 0):
            call()

    return on_event


def make_set(folder, name="tetX", workers=1, **plan):
    """Make a set with the numpy renderer; the folder of the set is returned."""
    made = make_plan(name, **plan)
    renderer = partial(NumpyRenderer, name, made.camera.width, has_depth=made.settings.depth)
    generate(made, folder / name, threads(renderer, workers=workers))
    return folder / name
