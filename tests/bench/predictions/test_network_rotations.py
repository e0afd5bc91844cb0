"""Rotations as networks of float32 give them are accepted, and keep their type in every frame."""

import h5py
import numpy as np
import pytest
from remedy_lines import IMAGES

from symsol_annot.bench.predictions.writing.submission import write_hypotheses
from symsol_annot.errors import RotationError
from symsol_annot.rotations.grid import e3nn_to_grid_frame, grid_frame_to_e3nn, implicit_pdf_to_grid_frame
from symsol_annot.rotations.so3 import uniform_rotations


def gram_schmidt(rng, n):
    x, y = rng.normal(size=(2, n, 3)).astype(np.float32)
    x /= np.linalg.norm(x, axis=-1, keepdims=True)
    y -= (x * y).sum(-1, keepdims=True) * x
    y /= np.linalg.norm(y, axis=-1, keepdims=True)
    return np.stack([x, y, np.cross(x, y)], axis=-1)


def from_quaternions(rng, n):
    q = rng.normal(size=(n, 4)).astype(np.float32)
    w, x, y, z = (q / np.linalg.norm(q, axis=-1, keepdims=True)).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, -1) for row in rows], -2)


def by_svd(rng, n):
    left, _, right = np.linalg.svd(rng.normal(size=(n, 3, 3)).astype(np.float32))
    left[..., -1] *= np.sign(np.linalg.det(left @ right)).astype(np.float32)[:, None]
    return left @ right


@pytest.mark.parametrize("network", [gram_schmidt, from_quaternions, by_svd])
@pytest.mark.parametrize(
    "then",
    [
        lambda R: R,
        lambda R: R.astype(np.float64),
        implicit_pdf_to_grid_frame,
        e3nn_to_grid_frame,
        grid_frame_to_e3nn,
        lambda R: implicit_pdf_to_grid_frame(R.astype(np.float64)),
        lambda R: uniform_rotations(1, np.random.default_rng(1))[0] @ R,
    ],
    ids=["as it is", "float64", "implicit_pdf", "e3nn", "to e3nn", "float64 implicit_pdf", "turned in float64"],
)
def test_rotations_of_float32_networks_are_accepted_in_either_type_and_every_frame(dozen, tmp_path, network, then):
    made = network(np.random.default_rng(0), IMAGES * 5000).reshape(IMAGES, 5000, 3, 3)
    assert made.dtype == np.float32
    write_hypotheses(tmp_path / "preds.h5", dozen, then(made), method="mine")
    with h5py.File(tmp_path / "preds.h5") as file:
        assert file["hypotheses"].dtype == then(made).dtype


@pytest.mark.parametrize("convert", [implicit_pdf_to_grid_frame, e3nn_to_grid_frame])
def test_frames_keep_the_type_and_each_number(convert):
    made = by_svd(np.random.default_rng(0), 50)
    for dtype in (np.float16, np.float32, np.float64, np.longdouble):
        turned = convert(made.astype(dtype))
        assert turned.dtype == dtype
        assert np.array_equal(np.sort(turned, axis=None), np.sort(made.astype(dtype), axis=None))
    with pytest.raises(RotationError, match=r"expected an array of shape \(\.\.\., 3, 3\), found \(50, 9\)"):
        convert(made.reshape(50, 9))
