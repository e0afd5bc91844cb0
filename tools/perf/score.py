"""How long scoring takes, stage by stage and beside roma; run by hand: python tools/perf/score.py [--images 5000].

Makes a set of cylO's size and symmetry sets without drawing anything (a candidate is hidden where the disc's centre
faces away), 30 hypotheses per image, and prints one table. Everything is timed in one run, and the ratios with it.
"""

import argparse
import resource
import subprocess
import sys
import tempfile
import time
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import roma
import torch

from symsol_annot import load
from symsol_annot.annotation.volume import Volume
from symsol_annot.bench.predictions.predictions_reader import Predictions
from symsol_annot.bench.predictions.sandboxed_file import SandboxedFile
from symsol_annot.bench.predictions.tracks.hypotheses import HypothesesBlock, HypothesesReader
from symsol_annot.bench.predictions.truth import Truth, truth_of
from symsol_annot.bench.predictions.writing.submission import write_columns, write_hypotheses
from symsol_annot.bench.scoring.averages import figures, merge
from symsol_annot.bench.scoring.scorers.hypotheses import HypothesesScorer
from symsol_annot.generation.executors import in_process
from symsol_annot.generation.generate import generate
from symsol_annot.objects.spec import load_object
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.renderer import View
from symsol_annot.rendering.settings import RenderSettings
from symsol_annot.rotations.groups import cyclic_group
from symsol_annot.rotations.so3 import uniform_rotations
from symsol_annot.sets.plan import SetPlan
from symsol_annot.sets.shard.labels import Labels

SIZE = 16
M = 30
_START = "import time; t = time.perf_counter(); import symsol_annot_cli.main; print(time.perf_counter() - t)"


class FacingRenderer:
    """Draws nothing; the disc counts as shown where the middle of it faces the camera."""

    def __init__(self, spec, camera):
        self.versions = {"renderer": "facing"}
        self._middle = spec.mesh.marking_vertices.mean(axis=0)
        self._normal = self._middle * [1, 1, 0] / np.linalg.norm(self._middle[:2])
        self._camera = np.array([0, 0, -camera.distance])

    def render(self, R_m2c):
        parts = np.array([100.0, *self.marking_pixels(R_m2c[None])])
        return View(np.zeros((SIZE, SIZE, 3), np.uint8), np.zeros((SIZE, SIZE), np.uint8), parts)

    def label_windows(self, R_m2c):
        raise NotImplementedError("nothing is drawn")

    def lit_windows(self, R_m2c):
        raise NotImplementedError("nothing is drawn")

    def marking_pixels(self, R_m2c):
        return 100.0 * (((self._camera - R_m2c @ self._middle) * (R_m2c @ self._normal)).sum(axis=1) > 0)

    def __enter__(self):
        return self

    def __exit__(self, *exc):
        pass

    def close(self):
        pass


def main():
    """Make the set, time everything, print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=int, default=5000)
    parser.add_argument("--volumes", action="store_true", help="score sets that all fill a volume, and nothing else")
    parser.add_argument("--classifier", action="store_true", help="also score a classifier that claims 1%% of the grid")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    if arguments.volumes:
        time_volumes(arguments.images)
        return
    with tempfile.TemporaryDirectory() as temporary:
        data = Path(temporary)
        dataset = make_set(data, arguments.images)
        truth = truth_of(dataset)
        sizes = truth.set_sizes
        print(f"cylO, {len(truth)} images, |S| {sizes.min()} to {sizes.max()}, {sizes.sum()} members, M = {M}")
        path = data / "preds.h5"
        rng = np.random.default_rng(0)
        hypotheses = uniform_rotations(M * len(truth), rng).reshape(-1, M, 3, 3)
        write_hypotheses(path, dataset, hypotheses, method="uniform")
        time_command(path, data)
        track = time_stages(path, dataset)
        time_against_roma(truth, track, hypotheses)
        if arguments.classifier:
            write_dense_classifier(path, dataset)
            time_command(path, data)


def time_volumes(images):
    """Time the metrics of images whose sets are all a third of SO(3), of hypotheses half of which are inside."""
    rng = np.random.default_rng(0)
    centre, hole = np.array([0.48, -0.6, 0.64]), np.array([-0.6, 0.48, 0.64])
    volume = Volume.of_directions(lambda v: (v @ centre > 0.3) & (v @ hole < 0.9))
    group = cyclic_group(360)
    mask = np.arange(360)[None].repeat(images, axis=0) == 0
    none, pixels = np.zeros(images, bool), np.zeros(images, np.float32)
    index = np.zeros(images, np.int32)
    labels = Labels(volume.sample(images, rng), mask, group, pixels, none, None, index, (volume,))
    truth = Truth("ball", "test", "made up", True, SIZE * SIZE, labels)
    hypotheses = uniform_rotations(images * M, rng).reshape(images, M, 3, 3)
    hypotheses[:, ::2] = volume.sample(images * M // 2, rng).reshape(images, -1, 3, 3)
    start, cpu = time.perf_counter(), time.process_time()
    scorer = HypothesesScorer(cast("Any", SimpleNamespace(count=M)), truth)
    rows = [np.arange(at, min(at + 500, images)) for at in range(0, images, 500)]
    merge([scorer.score_block(HypothesesBlock(some, hypotheses[some], None)) for some in rows])
    wall, cpu = time.perf_counter() - start, time.process_time() - cpu
    rss = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**10
    print(f"{images} images, each set {volume.measure:.1%} of SO(3), M = {M}")
    print(f"metrics {wall:.1f} s, {cpu:.1f} s of them of the CPU; largest process {rss:.0f} MiB")


def make_set(data, images):
    """Make the set and return it."""
    spec, camera = load_object("cylO"), Camera.filling(SIZE)
    plan = SetPlan(spec, {"train": 0, "test": images}, 0, camera, RenderSettings(), "test")
    generate(
        plan, data / "cylO", partial(in_process, open_renderer=partial(FacingRenderer, spec, camera), exhaustive=True)
    )
    return load(data / "cylO")


def time_command(path, data):
    """Time the whole command, and what starting it takes."""
    walls, rss = [], []
    for _ in range(3):
        start = time.perf_counter()
        command = [sys.executable, "-c", "from symsol_annot_cli.main import main; main()", "score", str(path)]
        subprocess.run([*command, "--data", str(data), "--json", str(data / "s.json")], check=True, capture_output=True)
        walls.append(time.perf_counter() - start)
        rss.append(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 2**10)
    start_up = [
        float(subprocess.run([sys.executable, "-c", _START], check=True, capture_output=True).stdout) for _ in range(3)
    ]
    written = (data / "s.json").stat().st_size / 2**20
    print(f"whole command      {np.median(walls):6.2f} s   scores.json has {written:.1f} MiB")
    print(f"  largest process so far    {max(rss):.0f} MiB")
    print(f"  start-up        {np.median(start_up):7.2f} s   imports")


def time_stages(path, dataset):
    """Time the command's stages in this process."""
    start = time.perf_counter()
    truth = truth_of(dataset)
    labels = time.perf_counter() - start
    with SandboxedFile(path) as file:
        start = time.perf_counter()
        predictions = Predictions(file, truth)
        opening = time.perf_counter() - start
        start = time.perf_counter()
        file.read("hypotheses", 0, len(truth))
        reading = time.perf_counter() - start
        start = time.perf_counter()
        predictions.check()
        checking = time.perf_counter() - start - reading
        (track,) = predictions.readers
        blocks = list(predictions.blocks(track))
    assert isinstance(track, HypothesesReader)
    scorer = HypothesesScorer(track, truth)
    start = time.perf_counter()
    table = merge([scorer.score_block(b) for b in blocks])
    scoring = time.perf_counter() - start
    start = time.perf_counter()
    figures(table, truth.strata)
    bootstrap = time.perf_counter() - start
    stages = {
        "reading the labels": labels,
        "opening": opening,
        "reading": reading,
        "checking": checking,
        "metrics": scoring,
        "bootstrap": bootstrap,
    }
    for name, seconds in stages.items():
        print(f"  {name:<18} {seconds:5.2f} s")
    return track


def time_against_roma(truth, track, hypotheses, rounds=3):
    """Time both errors of every image: ours, roma on all pairs of an image, roma hypothesis by hypothesis."""
    scorer, index = HypothesesScorer(track, truth), np.arange(len(truth))
    ways = {
        "ours": lambda: scorer.errors(index, hypotheses),
        "roma, all pairs of an image": lambda: with_roma(truth, hypotheses, roma_vectorised),
        "roma, a hypothesis at a time": lambda: with_roma(truth, hypotheses, roma_looped),
    }
    taken, expected = {name: [] for name in ways}, None
    for _ in range(rounds):
        for name, way in ways.items():
            start = time.perf_counter()
            found = way()
            taken[name].append(time.perf_counter() - start)
            expected = expected or found
            worst = max(
                max(abs(a - x).max(), abs(b - y).max()) for (a, b, *_), (x, y, *_) in zip(found, expected, strict=True)
            )
            assert worst < 1e-7, worst
    for name, seconds in taken.items():
        ratios = np.array(seconds) / np.array(taken["ours"])
        print(f"  {name:<30} {np.median(seconds):7.2f} s   {np.median(ratios):5.1f} times ours")


def with_roma(truth, hypotheses, way):
    """Compute both errors, image by image."""
    sets = (torch.from_numpy(truth.labels.members(i)) for i in range(len(truth)))
    return [way(S, H) for S, H in zip(sets, torch.from_numpy(hypotheses), strict=True)]


def roma_vectorised(S, H):
    """All pairs of an image at once."""
    d = roma.rotmat_geodesic_distance(S[:, None], H[None])
    return d.min(1).values.numpy(), d.min(0).values.numpy()


def roma_looped(S, H):
    """A hypothesis at a time."""
    d = torch.stack([roma.rotmat_geodesic_distance(S, h[None]) for h in H])
    return d.min(0).values.numpy(), d.min(1).values.numpy()


def write_dense_classifier(path, dataset):
    """Write a classifier that claims the same 1% of the grid for every image."""
    path.unlink()
    images, group = len(dataset), len(dataset.symmetry_group)
    claimed = np.arange(0, 294912, 100, dtype=np.int32)
    columns = {
        "query_probability": np.full((images, 9 * group), 0.01, np.float32),
        "grid_offsets": len(claimed) * np.arange(images + 1, dtype=np.int64),
        "grid_indices": np.tile(claimed, images),
        "grid_probabilities": np.full(len(claimed) * images, 0.9, np.float32),
    }
    write_columns(path, dataset, "classifier", columns, method="a hundredth")


if __name__ == "__main__":
    main()
