"""The line that mends a fault of a predictions file: what to write in place of what was found, as code to copy."""

import difflib
import os
from collections.abc import Callable
from pathlib import Path

from symsol_annot.system.reading import open_regular

PROJECT = "U, _, Vt = np.linalg.svd(R.astype(np.float64)); R = U @ Vt"
_ROUNDED = 0.05  # float16, and products in it, are off by less
_GRAM_SCHMIDT = (
    "a, b = x[..., :3], x[..., 3:]; a = a / np.linalg.norm(a, axis=-1, keepdims=True); "
    "b = b - (a * b).sum(-1, keepdims=True) * a; b = b / np.linalg.norm(b, axis=-1, keepdims=True); "
    "R = np.stack([a, b, np.cross(a, b)], axis=-1)"
)
_START_BYTES = 256
_OF_TORCH = (".pt", ".pth", ".ckpt")
_CONVERTED = (".npz", ".npy", ".pt", ".pth")
_OTHERS = {  # how other files begin, what they are, and how the array in them is had
    b"\x93NUMPY": ("an array of NumPy's", "np.load({name})"),
    b"PK\x03\x04": ("a zip, as np.savez writes", "np.load({name})['R']"),
    b"\x80": ("a pickle", "R"),
}


def mend_of_shape(name: str, shape: tuple[int, ...], dtype: str, rows: int) -> str:
    """Return how hypotheses, or another data set, of this shape and type become what belongs there; "" if unknown.

    Args:
        name: of the data set.
        shape: as found.
        dtype: as found, numpy's name.
        rows: N, how many images the split has.
    """
    if name == "hypotheses":
        return _mend_of_hypotheses(shape, dtype, rows)
    if name == "image_index":
        return "write np.asarray(image_index, dtype=np.int64)" if len(shape) == 1 else ""
    if dtype == "<f2":
        return f"write {name}.astype(np.float32)"
    return ""


def _mend_of_hypotheses(shape: tuple[int, ...], dtype: str, rows: int) -> str:
    mend = ""
    match shape:
        case (first, _, 3, 3) if first == rows:
            mend = f"project what was rounded: {PROJECT}" if dtype == "<f2" else "write R.astype(np.float64)"
        case (_, second, 3, 3) if second == rows:
            mend = "the first axis is the images: write R.swapaxes(0, 1)"
        case (_, _, 4, 4):
            mend = "these are 4x4 poses: write poses[..., :3, :3]"
        case (_, 3, 3):
            mend = "this is one rotation per image: write R[:, None]"
        case (_, 4, 4):
            mend = "these are 4x4 poses, one per image: write poses[:, None, :3, :3]"
        case (_, _, last) if last in _FORMS:
            mend = _FORMS[last]("x")
        case (_, last) if last in _FORMS:
            mend = _FORMS[last]("x[:, None]")
    return mend


def _of_quaternions(x: str) -> str:
    return (
        "these look like quaternions: with `from symsol_annot.rotations.so3 import quat_wxyz_to_rotation`, write "
        f"quat_wxyz_to_rotation({x}) where the scalar is first, quat_wxyz_to_rotation(np.roll({x}, 1, axis=-1)) where "
        "it is last"
    )


def _of_rotation_vectors(x: str) -> str:
    made = f"as_matrix().reshape(*{x}.shape[:2], 3, 3)"
    return (
        "these look like rotation vectors: with `from scipy.spatial.transform import Rotation`, write "
        f"Rotation.from_rotvec({x}.reshape(-1, 3)).{made}; Euler angles need from_euler with their order"
    )


def _of_columns(x: str) -> str:
    return (
        f"these look like two columns of each matrix: complete them, x = {x}; {_GRAM_SCHMIDT} (axis=-2 where they are "
        "rows, as in PyTorch3D)"
    )


def _of_entries(x: str) -> str:
    return f"these look like the entries of matrices, row by row: write {x}.reshape(*{x}.shape[:2], 3, 3)"


_FORMS: dict[int, Callable[[str], str]] = {
    3: _of_rotation_vectors,
    4: _of_quaternions,
    6: _of_columns,
    9: _of_entries,
}


def mend_of_matrices(off: float) -> str:
    """Return how matrices that are off by this much become rotations; "" where they are something else."""
    return f"; project what was rounded: {PROJECT}" if off < _ROUNDED else ""


def mend_of_name(name: str, known: list[str]) -> str:
    """Return which name of the format a strange one was meant for; "" where none is near."""
    if name == "density_probabilities":
        return "; the format has 'density_log_probabilities', np.log of them, without the cells whose probability is 0"
    near = difflib.get_close_matches(name.lower(), known, n=1)
    return f"; {near[0]!r} is" if near else ""


def mend_of_file(path: Path, set_folder: str) -> str:
    """Say what a file is that is no predictions file, and what to do; "" where that is not known.

    Args:
        path: of the file.
        set_folder: of the set that predictions would be about, for the code.
    """
    try:
        with os.fdopen(open_regular(path), "rb") as file:
            start = file.read(_START_BYTES)
    except OSError:
        return ""
    if start.lstrip().startswith(b"{") and b"symsol-annot scores" in start:
        return "is a file of scores, where predictions belong; `symsol-annot compare` takes scores"
    found = next((pair for opening, pair in _OTHERS.items() if start.startswith(opening)), None)
    if found is None:
        return ""
    what, read = found
    if path.suffix in _OF_TORCH:
        what, read = "a file of PyTorch's", "torch.load({name}).cpu().numpy()"
    array = read.format(name=repr(path.name))
    write = f"write_hypotheses('preds.h5', symsol_annot.load({set_folder!r}), {array}, method='mine')"
    command = (
        f"; `symsol-annot convert {path}` does so, of other forms and frames too" if path.suffix in _CONVERTED else ""
    )
    return (
        f"is {what}, where an HDF5 file of predictions belongs, which {write} makes of an (N, M, 3, 3) array{command}"
    )
