"""How fast a set loads, beside the same images as a folder of PNG files.

python tools/perf/loading.py FOLDER [--split test] [--rounds 9] [--json FILE]

A sample is an image, its segmentation, its rotation and its symmetry mask. Each way reads all samples of a split in one
shuffled order, in one process, from files that were read before; the ways take turns within a round, and a ratio is
taken within its round.
"""

import argparse
import json
import multiprocessing
import os
import statistics
import tempfile
import time
from pathlib import Path

import h5py
import numpy as np
from PIL import Image
from sets import peak_mib

from symsol_annot import load
from symsol_annot.sets.shard.reader import opened_shard

PNG = "PNG folder, Pillow"
_MEETING = None  # where a process waits for the others


def measure(folder, rounds=9, split="test"):
    """Time all ways of reading a split.

    Returns:
        images, rounds; bytes_a_sample of the shards and of the PNG twin; ms_a_sample, the median of each way;
        times_faster_than_png, the median over rounds of how many times faster each way is than PNG of the same content.
    """
    with tempfile.TemporaryDirectory() as temporary, load(folder, split) as dataset:
        twin = _PngTwin(Path(temporary), dataset)
        files = _OpenFiles(Path(folder), split)
        readers = {
            "load()": dataset.__getitem__,
            "plain h5py": files.sample,
            PNG: twin.sample,
            "raw chunks, not inflated": files.raw,
            "StoredArray, image alone": files.image_by_bytes,
            "plain h5py, image alone": files.image,
            f"{PNG}, image alone": twin.image,
        }
        _check_that_all_read_the_same(dataset, files, twin)
        rng = np.random.default_rng(0)
        times = {way: [] for way in readers}
        for _ in range(rounds):
            order = rng.permutation(len(dataset)).tolist()
            for way in rng.permutation(list(readers)).tolist():
                times[way].append(_ms_a_sample(readers[way], order))
        sizes = {"shards": sum(path.stat().st_size for path in files.paths), PNG: twin.bytes}
    return {
        "images": len(dataset),
        "rounds": rounds,
        "bytes_a_sample": {name: round(size / len(dataset)) for name, size in sizes.items()},
        "ms_a_sample": {way: statistics.median(ms) for way, ms in times.items()},
        "times_faster_than_png": {way: _times_faster(times, way) for way in readers},
    }


def load_together(folder, processes, split="test"):
    """Return samples_per_second and peak_mib of processes that `load()` a shuffled split together, each its share."""
    context = multiprocessing.get_context("spawn")
    meeting = context.Barrier(processes)
    with context.Pool(processes, _meet_at, (meeting,)) as pool:
        spans = pool.starmap(_read_share, [(folder, split, k, processes) for k in range(processes)], chunksize=1)
    starts, ends, reads, peaks = zip(*spans, strict=True)
    return {"samples_per_second": round(sum(reads) / (max(ends) - min(starts))), "peak_mib": max(peaks)}


def _meet_at(meeting):
    global _MEETING  # noqa: PLW0603 - multiprocessing has no other place for it
    _MEETING = meeting


def _read_share(folder, split, number, of):
    """Read a share of the split twice, the second time with the others; return start, end, size and peak MiB."""
    with load(folder, split) as dataset:
        share = np.random.default_rng(0).permutation(len(dataset))[number::of].tolist()
        for index in share:
            dataset[index]
        _MEETING.wait()
        start = time.monotonic()
        for index in share:
            dataset[index]
        end = time.monotonic()
    return start, end, len(share), peak_mib()


def _ms_a_sample(read, order):
    start = time.perf_counter()
    for index in order:
        read(index)
    return 1e3 * (time.perf_counter() - start) / len(order)


def _times_faster(times, way):
    png = f"{PNG}, image alone" if "image alone" in way else PNG
    return statistics.median(there / here for here, there in zip(times[way], times[png], strict=True))


class _PngTwin:
    """The same images as PNG files as Pillow writes them, with their labels in arrays."""

    def __init__(self, folder, dataset):
        samples = list(dataset)
        self._images = [str(folder / f"{i:05d}.png") for i in range(len(samples))]
        self._segmentations = [str(folder / f"{i:05d}-segmentation.png") for i in range(len(samples))]
        for image, segmentation, sample in zip(self._images, self._segmentations, samples, strict=True):
            Image.fromarray(sample.image).save(image)
            Image.fromarray(sample.segmentation).save(segmentation)
        self._rotation = np.array([sample.rotation for sample in samples])
        self._mask = np.array([sample.symmetry_mask for sample in samples])
        self.bytes = sum(Path(path).stat().st_size for path in (*self._images, *self._segmentations))

    def image(self, index):
        with Image.open(self._images[index]) as image:
            return np.asarray(image.convert("RGB"))

    def sample(self, index):
        with Image.open(self._segmentations[index]) as segmentation:
            return self.image(index), np.asarray(segmentation), self._rotation[index], self._mask[index]


class _OpenFiles:
    """The shards, kept open: the three lines of docs/format.md, and the stages of the fast way one by one."""

    def __init__(self, folder, split):
        self.paths = sorted(folder.glob(f"{split}-*.h5"))
        self._files = [h5py.File(path) for path in self.paths]
        self._place = [(f, row) for f in self._files for row in range(len(f["image"]))]
        shards = {f: opened_shard(Path(f.filename)) for f in self._files}
        self._rows = [(shards[f].image, shards[f].file, row) for f, row in self._place]
        self._chunks = [self._chunks_of(f, row) for f, row in self._place]

    def _chunks_of(self, f, row):
        infos = [f[name].id.get_chunk_info(row) for name in ("image", "segmentation")]
        return f.id.get_vfd_handle(), [(info.size, info.byte_offset) for info in infos]

    def image(self, index):
        f, row = self._place[index]
        return f["image"][row]

    def sample(self, index):
        f, row = self._place[index]
        mask = f["symmetry_mask"][row] if "symmetry_mask" in f else None
        return f["image"][row], f["segmentation"][row], f["rotation"][row], mask

    def image_by_bytes(self, index):
        array, file, row = self._rows[index]
        return array.row(row, file)

    def raw(self, index):
        descriptor, chunks = self._chunks[index]
        return [os.pread(descriptor, size, offset) for size, offset in chunks]


def _check_that_all_read_the_same(dataset, files, twin):
    for index, sample in enumerate(dataset):
        fields = (sample.image, sample.segmentation, sample.rotation, sample.symmetry_mask)
        for other in (files.sample(index), twin.sample(index)):
            assert all(np.array_equal(ours, theirs) for ours, theirs in zip(fields, other, strict=True))
        assert np.array_equal(files.image_by_bytes(index), sample.image)
        assert np.array_equal(files.image(index), twin.image(index))


def main():
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--split", default="test")
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    found = measure(arguments.folder, arguments.rounds, arguments.split)
    sizes = ", ".join(f"{name} {size}" for name, size in found["bytes_a_sample"].items())
    print(f"{arguments.folder}: {found['images']} images, {found['rounds']} rounds; bytes a sample: {sizes}")
    for way, ms in found["ms_a_sample"].items():
        print(f"  {way:<32} {ms:7.3f} ms a sample {found['times_faster_than_png'][way]:7.1f} x PNG")
    if arguments.json:
        arguments.json.write_text(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
