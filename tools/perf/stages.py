"""Where a view's time goes, inside Blender's process: python tools/perf/stages.py OBJECT [VIEWS] prints JSON.

Each stage, and each way not taken, is timed over the same views, in turn, and its median is given in ms. "rasteriser
alone" draws the object's window and writes nothing: what no change outside Blender and Mesa can undercut.
"""

import argparse
import json
import os
import statistics
import time

from symsol_annot.objects.spec import load_object
from symsol_annot.rendering.blender import BlenderRenderer, _Window
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.renderer import Scene
from symsol_annot.rendering.settings import RenderSettings
from symsol_annot.rendering.supersampling import pixel_averages
from symsol_annot.sets.plan import label_rotation

WARM_UP = 5


def stages_of(name, views):
    """Return the median ms of each stage of a view, of a count, and of ways not taken."""
    renderer = BlenderRenderer(Scene(load_object(name).mesh, Camera.filling(224), RenderSettings()))
    times = {}
    for index in range(views + WARM_UP):
        for stage, ms in _times_of(renderer, label_rotation(0, name, "test", index)).items():
            times.setdefault(stage, []).append(ms)
    return {stage: round(statistics.median(ms[WARM_UP:]), 3) for stage, ms in times.items()}


def _times_of(renderer, R):
    import bpy

    renderer._turn(R)
    whole, counted = renderer._windows(R)
    samples = renderer._draw(whole)
    height, width = samples.shape[:2]
    stages = {
        "whole view": lambda: renderer.render(R),
        "draw the object's window, write and read it": lambda: renderer._draw(whole),
        "rasteriser alone": lambda: bpy.ops.render.render(write_still=False),
        "read the frame": lambda: renderer._frame.read(width, height),
        "draw the marking's window as well": lambda: renderer._draw(counted) if counted != whole else None,
        "ids of all samples": lambda: renderer._ids.of(samples),
        "average": lambda: pixel_averages(samples, 2),
        "an empty frame of 17 x 17 samples": lambda: renderer._draw(_Window(0, 0, 8, 8)),
        "count of one candidate": lambda: renderer.marking_pixels(R[None]),
    }
    return {stage: _ms(call) for stage, call in stages.items()} | _ways_not_taken(renderer, R, whole)


def _ways_not_taken(renderer, R, whole):
    """Time the object's window with one thing changed: its file, its light, or Blender's own anti-aliasing."""
    scene = renderer._blender_scene
    image, shading, display = scene.render.image_settings, scene.display.shading, scene.display
    changes = {
        "the window as BMP": (image, "file_format", "BMP"),
        "the window as PNG": (image, "file_format", "PNG"),
        "the window in Workbench's studio light": (shading, "light", "STUDIO"),
    }
    renderer._draw(whole)  # sets up the camera
    times = {name: _changed(*change, lambda: _write(scene)) for name, change in changes.items()}
    everything = _Window(0, 0, renderer._camera.width, renderer._camera.height)
    times["the whole image's samples, not the window"] = _ms(lambda: renderer._draw(everything))
    renderer._draw(whole)
    scene.render.resolution_percentage = 50
    times["Blender's 8-sample anti-aliasing in place of the lattice"] = _changed(
        display, "render_aa", "8", lambda: _write(scene)
    )
    times["a segmentation beside it"] = _ms(lambda: _write(scene))
    scene.render.resolution_percentage = 100
    return times


def _changed(owner, attribute, value, call):
    before = getattr(owner, attribute)
    setattr(owner, attribute, value)
    try:
        call()  # the first after a change may build shaders
        return _ms(call)
    finally:
        setattr(owner, attribute, before)


def _write(scene):
    import bpy

    bpy.ops.render.render(write_still=True, scene=scene.name)


def _ms(call):
    start = time.perf_counter()
    call()
    return 1e3 * (time.perf_counter() - start)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("name", help="of the object")
    parser.add_argument("views", type=int, nargs="?", default=60)
    arguments = parser.parse_args()
    os.environ.update(LP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # Blender talks
    print(json.dumps(stages_of(arguments.name, arguments.views)), file=answers, flush=True)
    os._exit(0)
