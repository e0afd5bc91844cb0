"""Groups as an object.toml names them, by their kind and what that needs."""

import math
from collections.abc import Callable
from typing import Any

from symsol_annot.objects.object_toml import ObjectToml
from symsol_annot.rotations.groups import GROUP_KINDS, GroupParameter
from symsol_annot.rotations.so3 import Rotations
from symsol_annot.system.text.toml import shown

MAX_GROUP_ORDER = 3600
_AXIS_LENGTHS = (1e-9, 1e9)  # within which its square, and so its direction, is a number


def read_group(toml: ObjectToml, field: str) -> Rotations:
    """Return the group that a table like { kind = "cyclic", order = 3, axis = [0, 0, 1] } names.

    Args:
        toml: the object.toml.
        field: the dotted name of the table.

    Raises:
        ObjectError: it names none; the message names the field.
    """
    name = toml.take(f"{field}.kind", str)
    if name not in GROUP_KINDS:
        raise toml.fault(f"{field}.kind", f"expected one of {', '.join(GROUP_KINDS)}, found {name!r}")
    kind = GROUP_KINDS[name]
    given = [*kind.needs, *(parameter for parameter in kind.takes if toml.has(f"{field}.{parameter}"))]
    return kind.make(**{parameter: _PARAMETER_READERS[parameter](toml, f"{field}.{parameter}") for parameter in given})


def _read_order(toml: ObjectToml, field: str) -> int:
    order: int = toml.take(field, int)
    if not 1 <= order <= MAX_GROUP_ORDER:
        raise toml.fault(field, f"expected 1 to {MAX_GROUP_ORDER}, found {order}")
    return order


def _read_axis(toml: ObjectToml, field: str) -> list[float]:
    axis = toml.take(field, list)
    numbers = [float(x) for x in axis if isinstance(x, int | float) and not isinstance(x, bool) and math.isfinite(x)]
    if len(axis) != 3 or len(numbers) != 3 or not any(numbers):
        raise toml.fault(field, f"expected three finite numbers that are not all 0, found {shown(axis)}")
    least, most = _AXIS_LENGTHS
    if not least <= math.hypot(*numbers) <= most:
        raise toml.fault(field, f"expected an axis of a length from {least:g} to {most:g}, found {shown(axis)}")
    return numbers


_PARAMETER_READERS: dict[GroupParameter, Callable[[ObjectToml, str], Any]] = {"order": _read_order, "axis": _read_axis}
