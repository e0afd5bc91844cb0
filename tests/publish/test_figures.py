"""The figures of a card are counted again in the shards, with h5py alone."""

import json

import h5py
import numpy as np
from bundles import SPLITS


def test_the_cards_figures_are_those_of_the_shards(bundle, data):
    """Counted here with h5py alone."""
    text = (bundle / "README.md").read_text()
    rows = {tuple(cells[:2]): cells for cells in table_rows(text, "marking shows")}
    contents = {tuple(cells[:2]): cells for cells in table_rows(text, "focal_px")}
    assert set(rows) == set(contents) == set(SPLITS)
    drawn = 0
    for name, split in SPLITS:
        shards = [h5py.File(path) for path in sorted((data / name).glob(f"{split}-*.h5"))]
        images = sum(len(shard["image"]) for shard in shards)
        pixels = np.concatenate([shard["marking_pixels"][:] for shard in shards])
        camera = json.loads(shards[0].attrs["camera"])
        assert contents[name, split][2] == str(images)
        assert contents[name, split][5] == f"{camera['focal_px']:.3f}"
        assert contents[name, split][6] == str(len(shards[0].attrs["symmetry_group"]))
        if name == "tet":
            assert rows[name, split][2:] == ["", "", "12 in 110", "", ""]
            continue
        shown = pixels >= shards[0].attrs["tolerance_px"]
        assert rows[name, split][2] == f"{shown.sum()} ({100 * shown.mean():.1f}%)"
        if "symmetry_mask" not in shards[0]:
            assert rows[name, split][3:] == ["", "no symmetry sets", "", ""]
            continue
        barely = shown & (pixels < 20 * camera["width"] ** 2 / 224**2)
        sizes = np.concatenate([shard["symmetry_mask"][:].sum(axis=1) for shard in shards])
        candidates, within = (
            sum(int(s.attrs[key]) for s in shards) for key in ("candidates_drawn", "candidates_within_tolerance")
        )
        assert rows[name, split][3] == str(barely.sum())
        counts = zip(*np.unique(sizes, return_counts=True), strict=True)
        assert rows[name, split][4] == ", ".join(f"{size} in {count}" for size, count in counts)
        assert rows[name, split][5:] == [f"{candidates:,}", f"{within:,}"]
        drawn += candidates
    assert f"of {drawn:,} candidates" in text


def table_rows(text, heading):
    """The cells of the table whose head has a word."""
    table = next(block for block in text.split("\n\n") if block.startswith("|") and heading in block.splitlines()[0])
    return [[cell.strip() for cell in line.split("|")[1:-1]] for line in table.splitlines()[2:]]
