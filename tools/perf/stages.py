"""Where a view's time goes, inside Blender's process: python tools/perf/stages.py OBJECT [VIEWS] prints JSON.

Each stage, and each way not taken, is timed over the same views, in turn, and its median is given in ms. "rasteriser
alone" draws the object's window in one colour and reads a single point: what no change outside Mesa can undercut.
"""

import argparse
import json
import os
import statistics
import time

from symsol_annot.objects.spec import load_object
from symsol_annot.rendering.blender import opengl
from symsol_annot.rendering.blender.pipeline import PipelineRenderer
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.frames.projection import projected
from symsol_annot.rendering.frames.supersampling import part_pixels_of, pixel_averages
from symsol_annot.rendering.renderer import Scene
from symsol_annot.rendering.settings import RenderSettings
from symsol_annot.rendering.windows import Window
from symsol_annot.sets.plan import label_rotation

WARM_UP = 5


def stages_of(name, views):
    """Return the median ms of each stage of a view, of a count, and of ways not taken."""
    renderers = _renderers(name)
    times = {}
    for index in range(views + WARM_UP):
        for stage, ms in _times_of(renderers, label_rotation(0, name, "test", index)).items():
            times.setdefault(stage, []).append(ms)
    return {stage: round(statistics.median(ms[WARM_UP:]), 3) for stage, ms in times.items() if len(ms) > WARM_UP}


def _renderers(name):
    mesh, camera = load_object(name).mesh, Camera.filling(224)
    cut, opengl.with_few_slivers = opengl.with_few_slivers, lambda mesh: mesh
    uncut = opengl.OpenGLRenderer(Scene(mesh, camera, RenderSettings()))
    opengl.with_few_slivers = cut
    with_depth = opengl.OpenGLRenderer(Scene(mesh, camera, RenderSettings(depth=True)))
    ours = opengl.OpenGLRenderer(Scene(mesh, camera, RenderSettings()))
    pipeline = PipelineRenderer(Scene(mesh, camera, RenderSettings("workbench")))  # last: it holds Blender's own scene
    return ours, uncut, with_depth, pipeline


def _times_of(renderers, R):
    renderer, uncut, with_depth, pipeline = renderers
    canvas, lattice = renderer._canvas, renderer._lattice
    points, z = projected(renderer._mesh.vertices, R, lattice)
    places = canvas.clip_space(points, z)
    window = Window.around(points / 2, 224, 224).lattice(2)
    point = Window(window.left, window.top, 1, 1)

    def draw(shape, *light, around=window):
        with canvas.bound():
            return canvas.draw(shape.batch(places, *light), around)[0]

    def rasterise():
        """Draw as `canvas.draw` does, and read one point, for which the device has to be done."""
        with canvas.bound():
            batch = renderer._labelled.batch(places)
            opengl.gpu.state.viewport_set(0, 0, canvas._side, canvas._side)
            opengl.gpu.state.scissor_set(window.left, window.top, window.width, window.height)
            canvas._buffer.clear(color=(0.0, 0.0, 0.0, 0.0), depth=1.0)
            batch.draw()
            canvas._buffer.read_color(point.left, point.top, 1, 1, 1, 0, "UINT")

    words = draw(renderer._lit, R)
    ids, colours = opengl._ids_in(words), renderer._colours.take(words)
    stages = {
        "whole view": lambda: renderer.render(R),
        "project and round vertices": lambda: canvas.clip_space(*projected(renderer._mesh.vertices, R, lattice)),
        "draw the object's window and read it": lambda: draw(renderer._lit, R),
        "rasteriser alone": rasterise,
        "draw and read a single point": lambda: draw(renderer._lit, R, around=point),
        "ids and areas": lambda: part_pixels_of(opengl._ids_in(words), 2, renderer._parts),
        "colours from the table": lambda: renderer._colours.take(words),
        "average": lambda: pixel_averages(colours, 2).copy(),
        "the view with flat faces as the mesh has them": lambda: uncut.render(R),
        "the view with depth": lambda: with_depth.render(R),
        "the view through Blender's render pipeline": lambda: pipeline.render(R),
    }
    if (ids > 1).any():
        stages["count of one candidate that is drawn"] = lambda: renderer.marking_pixels(R[None])
        stages["count of it through Blender's render pipeline"] = lambda: pipeline.marking_pixels(R[None])
    return {stage: _ms(call) for stage, call in stages.items()}


def _ms(call):
    start = time.perf_counter()
    call()
    return 1e3 * (time.perf_counter() - start)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("name", help="of the object")
    parser.add_argument("views", type=int, nargs="?", default=60)
    arguments = parser.parse_args()
    os.environ.update(LP_NUM_THREADS="0", OPENBLAS_NUM_THREADS="1")
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # Blender talks
    print(json.dumps(stages_of(arguments.name, arguments.views)), file=answers, flush=True)
    os._exit(0)
