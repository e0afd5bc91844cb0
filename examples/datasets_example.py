"""Reads a published bundle with Hugging Face datasets.

python datasets_example.py bundle cylO test
"""

import sys

import numpy as np
from datasets import load_dataset

bundle, name, split = sys.argv[1:]
samples = load_dataset(bundle, name, split=split)
groups = load_dataset(bundle, "symmetry_groups", split="train")
about = next(row for row in groups if row["set"] == name)
group, parts = np.array(about["symmetry_group"]), about["parts"]  # (G, 3, 3), P names

for sample in samples:
    image = np.asarray(sample["image"])  # (H, W, 3) uint8; sample["image"] is a PIL image, as is "segmentation"
    rotation = np.array(sample["rotation"])  # (3, 3) float64, model to camera; not through with_format, which rounds
    areas = ", ".join(f"{area:g} px of {part}" for part, area in zip(parts, sample["part_pixels"], strict=True))
    marking = "shown" if sample["marking_visible"] else "not shown"
    mask = sample["symmetry_mask"]
    if mask is None:  # a split without symmetry sets
        found = "no symmetry set"
    else:
        symmetry_set = rotation @ group[np.array(mask)]  # (k, 3, 3)
        found = f"{len(symmetry_set)} rotations"
    print(f"{sample['index']}: mean {image.mean():.3f}, {areas}, marking {marking}, {found}")
