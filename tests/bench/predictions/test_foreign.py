"""Rotations in other forms, frames and files: each way here gives back what went there, and nothing is guessed."""

import io
import zipfile

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from symsol_annot.bench.predictions.foreign.conversion import Given, to_hypotheses
from symsol_annot.bench.predictions.foreign.files import read_arrays
from symsol_annot.bench.predictions.foreign.forms import FORMS, to_rotations
from symsol_annot.bench.predictions.foreign.frames import FRAMES, to_opencv
from symsol_annot.errors import PredictionsError, RotationError, SettingsError
from symsol_annot.rotations.so3 import uniform_rotations

N, M = 6, 5
R = uniform_rotations(N * M, np.random.default_rng(0)).reshape(N, M, 3, 3)
AS_SCIPY = Rotation.from_matrix(R.reshape(-1, 3, 3))  # whose conversions are not this package's
WAYS = {
    "matrix": (R, {}),
    "entries": (R.reshape(N, M, 9), {}),
    "float32": (R.astype(np.float32), {}),
    "pose 4x4": (np.pad(R, [(0, 0), (0, 0), (0, 1), (0, 1)]), {}),
    "pose 3x4": (np.pad(R, [(0, 0), (0, 0), (0, 0), (0, 1)]), {}),
    "pose 16": (np.pad(R, [(0, 0), (0, 0), (0, 1), (0, 1)]).reshape(N, M, 16), {}),
    "xyzw": (AS_SCIPY.as_quat().reshape(N, M, 4), {"order": "xyzw"}),
    "wxyz": (AS_SCIPY.as_quat(scalar_first=True).reshape(N, M, 4), {"order": "wxyz"}),
    "rotvec": (AS_SCIPY.as_rotvec().reshape(N, M, 3), {"form": "rotvec"}),
    "6d columns": (np.concatenate([R[..., 0], R[..., 1]], -1), {"form": "6d-columns"}),
    "6d rows": (np.concatenate([R[..., 0, :], R[..., 1, :]], -1), {"form": "6d-rows"}),
}


@pytest.mark.parametrize("way", WAYS)
def test_each_form_gives_back_the_matrices(way):
    given, options = WAYS[way]
    found = to_rotations(given, options.get("form"), options.get("order"))
    np.testing.assert_allclose(found, R, atol=1e-6 if way == "float32" else 1e-12)
    one_each = to_rotations(given[:, 0], options.get("form"), options.get("order"))
    np.testing.assert_allclose(one_each, R[:, 0], atol=1e-6 if way == "float32" else 1e-12)


def test_every_form_is_tried():
    assert {options.get("form", way.split()[0]) for way, (_, options) in WAYS.items()} >= set(FORMS) - {"quaternion"}


@pytest.mark.parametrize(
    ("shape", "words"),
    [
        ((N, M, 3), ["--form rotvec", "Euler"]),
        ((N, M, 6), ["--form 6d-columns", "--form 6d-rows"]),
        ((N, M, 4), ["--order wxyz", "--order xyzw"]),
        ((N, M, 7), ["no form of rotations"]),
        ((N, M, 3, 2), ["no form of rotations"]),
    ],
)
def test_what_has_more_than_one_meaning_has_to_be_named(shape, words):
    with pytest.raises(SettingsError) as caught:
        to_rotations(np.zeros(shape), None, None)
    assert all(word in str(caught.value) for word in words)


def test_three_quaternions_per_image_are_no_poses_where_the_order_is_said():
    quaternions = WAYS["xyzw"][0][:, :3]
    np.testing.assert_allclose(to_rotations(quaternions, None, "xyzw"), R[:, :3], atol=1e-12)
    with pytest.raises(RotationError, match="--form names another form"):
        to_rotations(quaternions, None, None)


@pytest.mark.parametrize(
    ("given", "form", "order", "words"),
    [
        (R, None, "wxyz", "has the shape"),
        (R, "matrix", "wxyz", "--order belongs to quaternions"),
        (R, "matrx", None, "did you mean 'matrix'"),
        (np.zeros((N, 4)), "quaternion", "wxyz", "norms of 1"),
        (3.0 * WAYS["wxyz"][0], None, "wxyz", "norms of 1"),
        (np.full((N, 3), 180.0), "rotvec", None, "np.radians"),
        (-R, None, None, "row 0: expected rotations"),
        (np.where(np.arange(N)[:, None, None, None] == 4, np.nan, R), None, None, "row 4: NaN"),
        (np.ones((N, 6)), "6d-rows", None, "row 0: expected rotations"),
    ],
)
def test_what_is_no_rotation_is_refused_with_the_row_and_what_to_do(given, form, order, words):
    with pytest.raises((RotationError, SettingsError)) as caught:
        to_rotations(given, form, order)
    assert words in str(caught.value)


# Frames: a camera at (0, 0, -4) sees a point of the model at a pixel, whatever the convention that says where it is.

POINT = np.array([0.3, -0.2, 0.5])
GIVEN_AS = {  # from R_m2c to what a program of that convention would have
    "opencv": R,
    "transposed": np.swapaxes(R, -1, -2),
    "opengl": np.stack([R[..., 0, :], -R[..., 1, :], -R[..., 2, :]], axis=-2),  # y and z of what comes out reversed
    "pytorch3d": np.swapaxes(np.stack([-R[..., 0, :], -R[..., 1, :], R[..., 2, :]], axis=-2), -1, -2),
    "model-y-up": R @ Rotation.from_euler("x", 90, degrees=True).as_matrix(),
    "model-z-up": R @ Rotation.from_euler("x", -90, degrees=True).as_matrix(),
}


@pytest.mark.parametrize("name", FRAMES)
def test_each_frame_gives_back_the_matrices(name):
    np.testing.assert_allclose(to_opencv(GIVEN_AS[name], [name]), R, atol=1e-15)


def test_a_model_that_stands_on_y_puts_its_top_where_z_is_here():
    up_there, up_here = np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])
    np.testing.assert_allclose(GIVEN_AS["model-y-up"] @ up_there, R @ up_here, atol=1e-15)
    np.testing.assert_allclose(GIVEN_AS["model-z-up"] @ up_here, R @ up_there, atol=1e-15)


def test_frames_are_undone_in_their_order():
    given = np.swapaxes(GIVEN_AS["opengl"], -1, -2)
    np.testing.assert_allclose(to_opencv(given, ["transposed", "opengl"]), R, atol=1e-15)
    with pytest.raises(SettingsError, match="did you mean 'opengl'"):
        to_opencv(R, ["open-gl"])


# Arrays of a file


def test_rows_go_where_image_index_says():
    order = np.random.default_rng(1).permutation(N)
    found = to_hypotheses(
        {"image_index": order, "R": R[order], "weights": np.arange(N * M).reshape(N, M)[order]}, N, Given()
    )
    np.testing.assert_allclose(found.rotations, R)
    assert np.array_equal(found.weights, np.arange(N * M).reshape(N, M))


def test_a_row_per_hypothesis_is_gathered_by_image():
    index = np.repeat(np.arange(N), np.arange(1, N + 1))
    rows = np.concatenate([R[i, np.arange(i + 1) % M] for i in range(N)])
    shuffled = np.random.default_rng(2).permutation(len(index))
    found = to_hypotheses({"image_index": index[shuffled], "R": rows[shuffled]}, N, Given())
    assert [len(one) for one in found.rotations] == list(range(1, N + 1))
    weights = np.arange(1.0, len(index) + 1)
    weighed = to_hypotheses({"image_index": index, "R": rows, "hypothesis_weights": weights}, N, Given())
    assert weighed.rotations.shape == (N, N, 3, 3)
    assert weighed.weights[0].tolist() == [1.0, 0, 0, 0, 0, 0]
    assert weighed.weights[2].tolist() == [4.0, 5.0, 6.0, 0, 0, 0]
    np.testing.assert_allclose(weighed.rotations[weighed.weights > 0], rows)


@pytest.mark.parametrize(
    ("arrays", "words"),
    [
        ({"a": R, "b": R}, "these are a, b: --array names it"),
        ({"image_index": np.arange(N)}, "there is none: --array"),
        ({"R": R[:4]}, "expected a row for each of the 6 images, found 4"),
        ({"R": R[None]}, "axes"),
        ({"R": R.astype(complex)}, "expected real numbers"),
        ({"R": R, "image_index": np.zeros(N, int)}, "5 of the 6 images are missing"),
        ({"R": R, "image_index": np.arange(1, N + 1)}, "1 rows are about images outside"),
        ({"R": R[:, 0], "image_index": np.arange(3)}, "one number per row"),
    ],
)
def test_arrays_that_are_about_other_images_or_of_no_kind_are_refused(arrays, words):
    with pytest.raises((SettingsError, PredictionsError)) as caught:
        to_hypotheses(arrays, N, Given())
    assert words in str(caught.value)


# Files


def test_files_give_back_their_arrays(tmp_path):
    np.savez_compressed(tmp_path / "a.npz", R=R, image_index=np.arange(N))
    np.save(tmp_path / "a.npy", np.asfortranarray(R))
    lines = [",".join(map(str, [i, *R[i, m].ravel()])) for i in range(N) for m in range(M)]
    (tmp_path / "a.csv").write_text("\n".join(["image_index," + ",".join(f"r{k}" for k in range(9)), *lines, ""]))
    found = read_arrays(tmp_path / "a.npz")
    assert np.array_equal(found["R"], R)
    assert found["image_index"].tolist() == list(range(N))
    assert np.array_equal(read_arrays(tmp_path / "a.npy")["hypotheses"], R)
    table = read_arrays(tmp_path / "a.csv")
    np.testing.assert_allclose(to_hypotheses(table, N, Given()).rotations, R)


def bomb():
    """A .npz of a kilobyte whose array says that it has an exabyte."""
    made, header = io.BytesIO(), io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (2**57,)})
    with zipfile.ZipFile(made, "w") as file:
        file.writestr("R.npy", header.getvalue())
    return made.getvalue()


def saved(**arrays):
    made = io.BytesIO()
    np.savez(made, **arrays)
    return made.getvalue()


BROKEN = {
    "missing.npz": (None, "cannot be read"),
    "empty.npz": (b"", "damaged"),
    "text.npz": (b"hello", "damaged"),
    "cut.npz": (saved(R=R)[:-300], "damaged"),
    "bomb.npz": (bomb(), "more than the"),
    "objects.npz": (saved(R=np.array([None, 1], dtype=object)), "Python objects"),
    "nothing.npz": (saved(), "found 0"),
    "many.npz": (saved(**{f"a{i}": R[0, 0] for i in range(100)}), "found 100"),
    "text.npy": (b"hello", "damaged"),
    "bytes.csv": (b"\xff\xfe\x00", "UTF-8"),
    "words.csv": (b"image_index,a\n0,b\n", "line 2: expected numbers"),
    "short.csv": (b"image_index,a\n0\n", "line 2: expected 2 numbers"),
    "header.csv": (b"a,b\n0,1\n", "image_index among them"),
    "double.csv": (b"image_index,a,a\n0,1,2\n", "each once"),
    "alone.csv": (b"image_index\n0\n", "no columns"),
    "half.csv": (b"image_index,a\n0.5,1\n", "whole numbers"),
    "rows.csv": (b"image_index,a\n", "no row"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_file_is_one_error_that_names_it(tmp_path, name):
    data, words = BROKEN[name]
    if data is not None:
        (tmp_path / name).write_bytes(data)
    with pytest.raises(PredictionsError) as caught:
        read_arrays(tmp_path / name)
    assert words in str(caught.value)
    assert str(tmp_path / name) in str(caught.value)
