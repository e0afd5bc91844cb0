"""The common recipe of this field, to be timed beside ours: Cycles, masks in a second render, an HDF5 file a frame.

Follows BlenderProc 2.8 where that is its default: persistent data, its light bounces, all pictures before all masks,
masks in flat emission with one sample and no filter, frames by way of memory-backed files, gzip. What would slow it
down is left out: no denoiser (BlenderProc's default is Intel's), no adaptive sampling (no gain at 16 samples), no light
tree, the quicker sampling pattern, BMP in place of PNG and EXR. Shares no code with the package's renderer.

python tools/perf/recipe.py OBJECT THREADS FOLDER: a line "FIRST COUNT" on stdin draws those poses of the test split of
seed 0, and a JSON line on stdout says what it took.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from functools import partial
from pathlib import Path

import h5py
import numpy as np
from PIL import Image

from symsol_annot.objects.spec import load_object
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.settings import RenderSettings
from symsol_annot.sets.plan import label_rotation

SIZE, SAMPLES = 224, 16
MASK_COLOURS = ((0.0, 1.0, 0.0), (1.0, 0.0, 0.0))  # body, marking
PICTURE_BOUNCES = {"diffuse": 3, "glossy": 0, "max": 3, "transmission": 0, "transparent_max": 8, "volume": 0}
MASK_BOUNCES = {"diffuse": 1, "glossy": 0, "max": 1, "transmission": 0, "transparent_max": 8, "volume": 0}


class Recipe:
    """Processes that draw by the recipe, each with its own Blender, ready to be asked."""

    def __init__(self, name, processes, threads, folder):
        self._folders = [Path(folder, f"recipe-{processes}x{threads}-{k}") for k in range(processes)]
        command = [sys.executable, __file__, name, str(threads)]
        open_process = partial(
            subprocess.Popen, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        )
        self._processes = [open_process([*command, str(path)]) for path in self._folders]
        self._answers()

    def draw(self, frames):
        """Draw some poses, shared out evenly; return what it took in seconds, wall and CPU, and of all its stages."""
        share = frames // len(self._processes)
        start = time.perf_counter()
        for k, process in enumerate(self._processes):
            print(k * share, share, file=process.stdin, flush=True)
        answers = self._answers()
        wall = time.perf_counter() - start
        stages = {key: sum(answer[key] for answer in answers) for key in answers[0]}
        return {"frames": share * len(self._processes), "wall": wall, **stages}

    def _answers(self):
        return [json.loads(process.stdout.readline()) for process in self._processes]

    def __enter__(self):
        return self

    def __exit__(self, *exc):
        for process in self._processes:
            process.communicate()  # its stdin ends


def serve(name, threads, folder):
    """Answer requests until stdin ends."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # Blender talks
    folder.mkdir(parents=True, exist_ok=True)
    frames = Path(tempfile.mkdtemp(prefix="recipe-", dir="/dev/shm"))
    try:
        scene = RecipeScene(load_object(name).mesh, threads, frames)
        scene.draw_frames(name, 0, 1, folder)
        print("{}", file=answers, flush=True)
        for line in sys.stdin:
            first, count = line.split()
            print(json.dumps(scene.draw_frames(name, int(first), int(count), folder)), file=answers, flush=True)
    finally:
        shutil.rmtree(frames)


class RecipeScene:
    """The object, a diffuse material each for body and marking, and a sun along the camera's axis."""

    def __init__(self, mesh, threads, frames):
        import bpy

        self._bpy, self._frames = bpy, frames
        bpy.ops.wm.read_factory_settings(use_empty=True)
        self._scene = scene = bpy.context.scene
        self._object = self._add("object", _mesh_of(bpy, mesh))
        settings = RenderSettings()
        self._looks = [self._material("Diffuse", c) for c in (settings.body_colour, settings.marking_colour)]
        self._masks = [self._material("Emission", colour) for colour in MASK_COLOURS]
        for material in self._looks:
            self._object.data.materials.append(material)
        self._object.data.polygons.foreach_set("material_index", mesh.is_marking.astype(np.int32))
        self._add_camera_and_light()
        scene.world = bpy.data.worlds.new("world")
        scene.world.use_nodes = True
        scene.world.cycles_visibility.diffuse = False  # the white background sheds no light
        self._set_up_cycles(threads)

    def draw_frames(self, name, first, count, folder):
        """Draw all pictures, then all masks, and write a file a frame; return the seconds of each."""
        times, cpu = [time.perf_counter()], time.process_time()
        poses = [label_rotation(0, name, "test", index) for index in range(first, first + count)]
        self._show(self._looks, "Standard", 1.0, SAMPLES, PICTURE_BOUNCES, filter_width=1.5)
        pictures = self._draw(poses)
        times.append(time.perf_counter())
        self._show(self._masks, "Raw", 0.0, 1, MASK_BOUNCES, filter_width=0.01)
        masks = [_ids(frame) for frame in self._draw(poses)]
        times.append(time.perf_counter())
        for index, (picture, mask) in enumerate(zip(pictures, masks, strict=True), start=first):
            with h5py.File(folder / f"{index}.hdf5", "w") as file:
                file.create_dataset("colors", data=picture, compression="gzip")
                file.create_dataset("segmap", data=mask, compression="gzip")
        times.append(time.perf_counter())
        stages = dict(zip(("pictures", "masks", "files"), np.diff(times).tolist(), strict=True))
        return {"cpu": time.process_time() - cpu, **stages}

    def _draw(self, poses):
        """Return all poses' frames, drawn as one animation."""
        self._object.animation_data_clear()
        for frame, R in enumerate(poses):
            self._object.rotation_quaternion = _quaternion(R)
            self._object.keyframe_insert("rotation_quaternion", frame=frame)
        self._scene.frame_start, self._scene.frame_end = 0, len(poses) - 1
        self._bpy.ops.render.render(animation=True, write_still=True)
        return [np.asarray(Image.open(self._frames / f"{frame:04d}.bmp")) for frame in range(len(poses))]

    def _show(self, materials, transform, background, samples, bounces, filter_width):
        for slot, material in enumerate(materials):
            self._object.data.materials[slot] = material
        self._scene.view_settings.view_transform = transform
        self._scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (*[background] * 3, 1.0)
        self._scene.cycles.samples, self._scene.cycles.filter_width = samples, filter_width
        for kind, number in bounces.items():
            setattr(self._scene.cycles, f"{kind}_bounces", number)

    def _set_up_cycles(self, threads):
        render, cycles = self._scene.render, self._scene.cycles
        render.engine, cycles.device = "CYCLES", "CPU"
        render.threads_mode, render.threads = "FIXED", threads
        render.resolution_x = render.resolution_y = SIZE
        render.use_persistent_data = True
        render.use_compositing = render.use_sequencer = False
        render.dither_intensity = 0.0
        render.image_settings.file_format, render.image_settings.color_mode = "BMP", "RGB"
        render.filepath = f"{self._frames}/"
        cycles.use_denoising = cycles.use_adaptive_sampling = False
        cycles.use_light_tree, cycles.sampling_pattern = False, "TABULATED_SOBOL"
        cycles.debug_use_spatial_splits = True

    def _add_camera_and_light(self):
        camera = Camera.filling(SIZE)
        lens = self._bpy.data.cameras.new("camera")
        lens.sensor_width, lens.lens = SIZE, camera.focal_px
        sun = self._bpy.data.lights.new("sun", "SUN")
        sun.energy, sun.angle = np.pi, 0.0
        for data in (lens, sun):
            made = self._add(data.name, data)
            made.location, made.rotation_quaternion = (0.0, 0.0, -camera.distance), (0.0, 1.0, 0.0, 0.0)
        self._scene.camera = self._bpy.data.objects["camera"]

    def _add(self, name, data):
        made = self._bpy.data.objects.new(name, data)
        made.rotation_mode = "QUATERNION"
        self._scene.collection.objects.link(made)
        return made

    def _material(self, kind, colour):
        material = self._bpy.data.materials.new(kind)
        material.use_nodes = True
        tree = material.node_tree
        tree.nodes.clear()
        surface = tree.nodes.new("ShaderNodeBsdfDiffuse" if kind == "Diffuse" else "ShaderNodeEmission")
        surface.inputs["Color"].default_value = (*colour, 1.0)
        tree.links.new(surface.outputs[0], tree.nodes.new("ShaderNodeOutputMaterial").inputs["Surface"])
        return material


def _mesh_of(bpy, mesh):
    data = bpy.data.meshes.new("object")
    data.from_pydata(mesh.vertices.tolist(), [], mesh.triangles.tolist())
    data.normals_split_custom_set(mesh.corner_normals.reshape(-1, 3).tolist())
    return data


def _quaternion(R):
    from mathutils import Matrix

    return Matrix(R.tolist()).to_quaternion()


def _ids(frame):
    """Return the mask of a frame in MASK_COLOURS on black: 0 background, 1 body, 2 marking."""
    return (frame[..., 1] > 127).astype(np.uint8) + 2 * (frame[..., 0] > 127).astype(np.uint8)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("name", help="of the object")
    parser.add_argument("threads", type=int)
    parser.add_argument("folder", type=Path, help="where the files go")
    serve(**vars(parser.parse_args()))
    os._exit(0)  # Blender's own shutdown has nothing to save
