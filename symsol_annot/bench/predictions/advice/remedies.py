"""What was given in place of hypotheses, or of numbers, and the line of code that makes them of it.

A line is offered only where its steps were tried on what was given and led to what is wanted; files alone are not
opened for that. It may be pasted as it is: the argument has the name that the writer gives it.
"""

import contextlib
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from symsol_annot.bench.predictions.columns import Array
from symsol_annot.bench.predictions.format import ROTATION_TOLERANCE
from symsol_annot.rotations.so3 import quat_wxyz_to_rotation, rotation_deviation

_TRIED_IMAGES = 10
_NEARLY = 0.05  # how far from a rotation a matrix may be that the nearest rotation is offered for
_LONGEST_VECTOR = 2.0 * np.pi  # of a rotation vector, in rad


@dataclass(frozen=True, eq=False)
class _Draft:
    """Code, what it gives, and in words what it takes the input for."""

    code: str
    value: Array
    words: tuple[str, ...] = ()
    imports: tuple[str, ...] = ()

    def then(self, code: str, value: Array, words: str = "", imports: str = "") -> "_Draft":
        """Return the draft with one step more; `code` has {} where the code so far goes."""
        more_words, more_imports = (words,) if words else (), (imports,) if imports else ()
        return _Draft(code.format(self.code), value, self.words + more_words, self.imports + more_imports)

    def line(self, target: str, end: str = "") -> str:
        """Return the line that gives a name what the code gives, with what it imports."""
        imports = sorted({*self.imports, *(("import numpy as np",) if "np." in self.code else ())})
        return "; ".join([*imports, f"{target}{self.code}{end}"])


def six_numbers_to_rotation(six: npt.ArrayLike) -> Array:
    """Return the rotations (..., 3, 3) of (..., 6) numbers: two columns, made orthonormal one after the other.

    Zhou et al., "On the continuity of rotation representations in neural networks", CVPR 2019.
    """
    six = np.asarray(six)
    first, second = six[..., :3], six[..., 3:]
    third = np.cross(first, second)
    columns = np.stack([first, np.cross(third, first), third], axis=-1)
    with np.errstate(invalid="ignore", divide="ignore"):  # parallel columns have no rotation
        rotations: Array = columns / np.linalg.norm(columns, axis=-2, keepdims=True)
    return rotations


def remedy_for_array(given: Any, images: int, name: str = "hypotheses") -> str:
    """Return what to do with something that is no (N, M, 3, 3) array of rotations, after "; "; "" where unknown.

    Args:
        given: as the argument.
        images: N.
        name: of the argument.
    """
    if isinstance(given, str | Path):
        return said(["this is a path"], _loading(Path(given), name))
    whole = None if isinstance(given, Mapping) else _hypotheses_of_all(given, images, name)
    if whole is not None:
        return said(whole.words, whole.line(f"{name} = "))
    row = _first_row(given, images)
    draft = None if row is None else _hypotheses_of_one_image(row, "rows[i]")
    if draft is None:
        return ""
    return said(["this is a row per image", *draft.words], draft.line(f"{name} = lambda i, rows={name}: "))


def remedy_for_answer(given: Any, name: str = "hypotheses") -> str:
    """Return what to do with a callable's answer about one image that is no (m, 3, 3) array of rotations.

    Args:
        given: the answer.
        name: of the argument that is the callable.
    """
    found = _hypotheses_of_one_image(given, "ask(i)")
    return said(found.words, found.line(f"{name} = lambda i, ask={name}: ")) if found else ""


def remedy_for_row(given: Any, name: str) -> str:
    """Return what to do with an entry of a list, about one image, that is no (m, 3, 3) array of rotations.

    Args:
        given: the entry.
        name: of the argument that is the list.
    """
    found = _hypotheses_of_one_image(given, "rows")
    return said(found.words, found.line(f"{name} = [", f" for rows in {name}]")) if found else ""


def remedy_for_numbers(given: Any, name: str) -> str:
    """Return what to do with an argument that is no array of real numbers."""
    found = _plain(given, name)
    return said(found.words, found.line(f"{name} = ")) if found and found.words else ""


def remedy_for_values(given: Any, count: int, name: str) -> str:
    """Return what to do with an answer about `count` rotations that is no (count,) array of real numbers."""
    found = _plain(given, "ask(i, R)")
    if found is None or found.value.size != count:
        return ""
    if found.value.shape != (count,):
        words = f"there is one number per rotation, in the shape {found.value.shape}"
        found = found.then("np.reshape({}, -1)", found.value.reshape(-1), words)
    return said(found.words, found.line(f"{name} = lambda i, R, ask={name}: ")) if found.words else ""


def said(words: Sequence[str], line: str) -> str:
    """Return the end of a message: what something is taken for, and a line that mends it, on a line of its own."""
    return f"; {' and '.join(words)}; this line mends it:\n    {line}" if words and line else ""


def _loading(path: Path, name: str) -> str:
    match path.suffix:
        case ".npy":
            return f"import numpy as np; {name} = np.load({str(path)!r})"
        case ".npz":
            return f"import numpy as np; {name} = np.load({str(path)!r})[{_name_in(path)!r}]"
        case ".pt" | ".pth":
            return f'import torch; {name} = torch.load({str(path)!r}, map_location="cpu", weights_only=True)'
    return ""


def _name_in(path: Path) -> str:
    """Return the name of the only array of an .npz, or the one that it should have."""
    with contextlib.suppress(OSError, zipfile.BadZipFile):
        names = zipfile.ZipFile(path).namelist()
        if len(names) == 1:
            return names[0].removesuffix(".npy")
    return "hypotheses"


def _first_row(given: Any, images: int) -> Any:
    """Return the first of as many rows as there are images; None where there are no such rows."""
    if not isinstance(given, Sequence | Mapping) or isinstance(given, str | bytes) or len(given) != images:
        return None
    return given.get(0) if isinstance(given, Mapping) else given[0]


def _hypotheses_of_all(given: Any, images: int, name: str) -> _Draft | None:
    draft = _plain(given, name)
    if draft is None or draft.value.ndim < 2 or not draft.value.size:
        return None
    if draft.value.shape[0] != images and draft.value.shape[1:2] == (images,):
        swapped = np.swapaxes(draft.value, 0, 1)
        draft = draft.then("np.swapaxes({}, 0, 1)", swapped, "the images are along the second axis")
    if draft.value.shape[0] != images:
        return None
    draft = _Draft(draft.code, draft.value[:_TRIED_IMAGES], draft.words, draft.imports)  # enough to try it on
    return _as_rotations(draft, leading=2)


def _hypotheses_of_one_image(given: Any, code: str) -> _Draft | None:
    draft = _plain(given, code)
    return None if draft is None or not draft.value.size else _as_rotations(draft, leading=1)


def _plain(given: Any, code: str) -> _Draft | None:
    """Return numbers as an array of a type that numpy computes with; None where there are none."""
    draft = _unwrapped(given, code)
    if draft is None:
        return None
    name, value = draft.value.dtype.name, draft.value
    if value.dtype.kind == "c":
        return draft.then("np.real({})", np.real(value), "these are complex numbers")
    if name in ("float16", "bfloat16"):
        return draft.then("{}.astype(np.float32)", value.astype(np.float32), f"these are {name}")
    if value.dtype.kind in "biu" or (value.dtype.kind == "f" and value.dtype.str not in ROTATION_TOLERANCE):
        return draft.then("{}.astype(np.float64)", value.astype(np.float64), f"these are {value.dtype}")
    return draft if value.dtype.kind == "f" else None


def _unwrapped(given: Any, code: str) -> _Draft | None:
    """Return what an array, a tensor or scipy's rotations hold."""
    if isinstance(given, np.ndarray):
        return _Draft(code, given)
    try:
        if hasattr(given, "detach"):  # torch's, which this module must not import
            return _of_tensor(given, code)
        if hasattr(given, "as_matrix"):
            return _Draft(f"{code}.as_matrix()", np.asarray(given.as_matrix()), ("these are scipy's rotations",))
        return _Draft(f"np.asarray({code})", np.asarray(given))
    except (TypeError, ValueError, RuntimeError):
        return None


def _of_tensor(given: Any, code: str) -> _Draft:
    """Return the numbers of a torch tensor, wherever it lies; numpy has no bfloat16."""
    if "bfloat16" in str(given.dtype):
        value = np.asarray(given.detach().float().cpu().numpy())
        return _Draft(f"{code}.detach().float().cpu().numpy()", value, ("this is a tensor of bfloat16",))
    value = np.asarray(given.detach().cpu().numpy())
    return _Draft(f"{code}.detach().cpu().numpy()", value, ("this is a tensor of torch",))


def _as_rotations(draft: _Draft, leading: int) -> _Draft | None:
    """Return rotations with so many leading dimensions (images and hypotheses), or None where no way leads to them."""
    for form in _FORMS:
        shaped = form(draft, leading)
        placed = None if shaped is None else _with_leading(shaped, leading)
        right = None if placed is None else _made_exact(placed)
        if right is not None:
            return right
    return None


def _with_leading(draft: _Draft, leading: int) -> _Draft | None:
    value = draft.value
    if value.ndim == leading + 1:
        here = "[:, None]" if leading == 2 else "[None]"
        words = "one hypothesis per image" if leading == 2 else "one hypothesis"
        return draft.then("{}" + here, np.expand_dims(value, leading - 1), f"there is {words}")
    if value.ndim == leading + 3 and value.shape[leading - 1] == 1:
        here = "[:, 0]" if leading == 2 else "[0]"
        return draft.then("{}" + here, value.take(0, axis=leading - 1), "there is an axis of length 1 too many")
    return draft if value.ndim == leading + 2 else None


def _made_exact(draft: _Draft) -> _Draft | None:
    """Return the nearest rotations where they are nearly some; None where they are not."""
    off = rotation_deviation(draft.value.astype(np.float64)).max()
    if off <= ROTATION_TOLERANCE[draft.value.dtype.str]:
        return draft
    if not off <= _NEARLY:  # NaN is not either
        return None
    left, _, right = np.linalg.svd(draft.value)
    words = f"they are off by up to {off:.2g} from rotations, of which the nearest may be taken"
    return draft.then("np.matmul(*np.linalg.svd({})[::2])", left @ right, words)


def _matrices(draft: _Draft, _leading: int) -> _Draft | None:
    return draft if draft.value.shape[-2:] == (3, 3) else None


def _poses(draft: _Draft, _leading: int) -> _Draft | None:
    shape = draft.value.shape
    if shape[-2:] == (4, 4):
        return draft.then("{}[..., :3, :3]", draft.value[..., :3, :3], "these look like 4x4 poses")
    if shape[-2:] == (3, 4):
        return draft.then("{}[..., :3]", draft.value[..., :3], "these look like 3x4 poses")
    return None


def _flat(draft: _Draft, _leading: int) -> _Draft | None:
    *rest, last = draft.value.shape
    if last not in (9, 16):
        return None
    side, dims = (3, "") if last == 9 else (4, "[..., :3, :3]")
    lead = ", ".join(["-1", *map(str, rest[1:])]) if rest else ""
    value = draft.value.reshape(*rest, side, side)[..., :3, :3]
    shape = f"({lead}, {side}, {side})" if lead else f"({side}, {side})"
    return draft.then(f"np.reshape({{}}, {shape}){dims}", value, f"these look like {side}x{side} matrices, row by row")


def _quaternions(draft: _Draft, _leading: int) -> _Draft | None:
    if draft.value.shape[-1] != 4:
        return None
    with np.errstate(invalid="ignore", divide="ignore"):
        value = quat_wxyz_to_rotation(draft.value)
    words = "these look like quaternions (the scalar first; where it is last, index them with [..., [3, 0, 1, 2]])"
    imports = "from symsol_annot.rotations.so3 import quat_wxyz_to_rotation"
    return draft.then("quat_wxyz_to_rotation({})", value, words, imports)


def _rotation_vectors(draft: _Draft, leading: int) -> _Draft | None:
    *rest, last = draft.value.shape
    if last != 3 or len(rest) > leading or not np.linalg.norm(draft.value, axis=-1).max() <= _LONGEST_VECTOR:
        return None
    if draft.value.shape[-2:] == (3, 3) and _is_orthonormal(draft.value):  # reflections
        return None
    value = Rotation.from_rotvec(draft.value.reshape(-1, 3)).as_matrix().reshape(*rest, 3, 3)
    shape = ", ".join(["-1", *map(str, rest[1:]), "3", "3"]) if rest else "3, 3"
    return draft.then(
        f"Rotation.from_rotvec(np.reshape({{}}, (-1, 3))).as_matrix().reshape({shape})",
        value,
        "these look like rotation vectors, in rad",
        "from scipy.spatial.transform import Rotation",
    )


def _is_orthonormal(matrices: Array) -> bool:
    return bool((np.abs(np.swapaxes(matrices, -1, -2) @ matrices - np.eye(3)) <= _NEARLY).all())


def _six_numbers(draft: _Draft, _leading: int) -> _Draft | None:
    if draft.value.shape[-1] != 6:
        return None
    words = "these look like the two first columns of matrices"
    imports = "from symsol_annot.bench.predictions.advice.remedies import six_numbers_to_rotation"
    return draft.then("six_numbers_to_rotation({})", six_numbers_to_rotation(draft.value), words, imports)


# In this order: (.., 3, 3) may be a matrix or three vectors, (.., 3, 4) a pose or three quaternions.
_FORMS: tuple[Callable[[_Draft, int], _Draft | None], ...] = (
    _matrices,
    _poses,
    _flat,
    _quaternions,
    _six_numbers,
    _rotation_vectors,
)
