"""Reads a shard with h5py alone.

python plain_h5py.py data/cylO/test-00000-of-00010.h5
"""

import json
import sys

import h5py

with h5py.File(sys.argv[1]) as shard:
    tolerance_px = shard.attrs["tolerance_px"]  # NaN without a marking: nothing is shown then
    print(shard.attrs["object"], shard.attrs["split"], "from image", shard.attrs["first_index"])
    parts = json.loads(shard.attrs["parts"])  # names; of part_pixels' columns and, from 1 on, of segmentation's ids
    group = shard.attrs["symmetry_group"]  # (G, 3, 3)
    masks = shard.get("symmetry_mask")  # (N, G) bool; None in a split without symmetry sets
    for row in range(len(shard["image"])):
        image = shard["image"][row]  # (H, W, 3) uint8; "segmentation" is (H, W), and so is "depth" where it is there
        rotation = shard["rotation"][row]  # (3, 3), model to camera
        areas = ", ".join(f"{area:g} px of {part}" for part, area in zip(parts, shard["part_pixels"][row], strict=True))
        shown = shard["marking_pixels"][row] >= tolerance_px
        marking = "shown" if shown else "not shown"
        if masks is None:
            found = "no symmetry set"
        else:
            symmetry_set = rotation @ group[masks[row]]  # (k, 3, 3)
            found = f"{len(symmetry_set)} rotations"
        print(f"{row}: mean {image.mean():.3f}, {areas}, marking {marking}, {found}")
