"""What was found, in words."""

import numpy as np

from symsol_annot.objects.finding.found import Axis, CertifiedGroup, Group, LargerGroup, Roundness, Symmetries
from symsol_annot.rotations.groups import ALL_ROTATIONS

_CLOSE = 10.0  # a residual within this factor of the tolerance is said to be close to it


def report_lines(found: Symmetries) -> list[str]:
    """Return the lines that tell a person what was found."""
    shape = found.shape
    lines = [f"group        {_in_words(shape.group)}"]
    lines += [f"  axis       {axis_in_words(axis)}" for axis in shape.group.axes[:8]]
    if len(shape.group.axes) > 8:
        lines.append(f"  and {len(shape.group.axes) - 8} more axes")
    x, y, z = shape.centre
    lines.append(f"fixed point  ({x:.6g}, {y:.6g}, {z:.6g}); the mesh reaches {found.radius:.6g} from it")
    lines += _certainty(shape, found.tolerance)
    if len(found.parts) > 1:
        lines.append(f"with parts   {_in_words(found.object)} map every part onto itself")
        lines += [
            f"  {part.name}: {part.triangles} triangles, kept in place by {_in_words(part.stabiliser)}"
            for part in found.parts
        ]
    if found.roundness is not None and not shape.group.is_continuous:
        lines.append(_roundness_in_words(found.roundness))
    lines += [_larger_in_words(one) for one in found.larger]
    lines += [f"not looked for: {what}" for what in found.not_looked_for]
    return lines


def _in_words(group: Group) -> str:
    if group.size is None:
        return f"{group.name}, more rotations than can be listed"
    return f"{group.name}, {group.size} rotation{'s' if group.size > 1 else ', the identity'}"


def axis_in_words(axis: Axis) -> str:
    """Return an axis's direction and its fold."""
    x, y, z = (round(value, 6) + 0.0 for value in axis.direction)
    fold = "any turn" if axis.fold is None else f"{axis.fold}-fold"
    return f"({x:g}, {y:g}, {z:g}), {fold}"


def _certainty(shape: CertifiedGroup, tolerance: float) -> list[str]:
    if shape.group.kind == ALL_ROTATIONS:
        return [
            f"certainty    no rotation carries points more than {shape.residual:.2g} off it; allowed {tolerance:g}",
            "next         no candidate is left: all rotations are in the group",
        ]
    bound = f"points are carried {shape.residual:.2g} off the surface"
    if not shape.group.is_continuous and shape.group.size != 1:
        bound += f", at most {max(shape.bound, shape.residual):.2g} anywhere"
        if shape.unbounded:
            bound += f", but for {shape.unbounded} triangles of which many points were compared"
    lines = [f"certainty    {bound}; allowed {tolerance:g}"]
    if shape.failed is None:
        lines.append(f"next         no other of the {shape.candidates} candidates came near")
    else:
        axis = ", ".join(f"{round(value, 4) + 0.0:g}" for value in shape.failed.axis)
        angle = np.degrees(shape.failed.angle_rad)
        lines.append(f"next         a turn by {angle:.4g} degrees about ({axis}) fails by {shape.failed.residual:.2g}")
    if is_close(shape, tolerance):
        lines.append("             that is close to the tolerance: look at the mesh, and state --tolerance")
    return lines


def is_close(shape: CertifiedGroup, tolerance: float) -> bool:
    """Tell whether a group, or the nearest miss, is so close to the tolerance that another might decide otherwise."""
    is_near_miss = shape.failed is not None and shape.failed.residual < tolerance * _CLOSE
    return is_near_miss or (shape.residual > tolerance / _CLOSE and not shape.group.is_continuous)


def _roundness_in_words(nearly: Roundness) -> str:
    return (
        f"round        {nearly.group.name} within {nearly.deviation:.2g}: "
        f"--round-within {rounded_up(nearly.deviation):g} takes it so"
    )


def rounded_up(value: float) -> float:
    """Return a value with two digits that is no smaller; 1e-9 for nothing."""
    if value < 1e-9:
        return 1e-9
    unit = 10.0 ** (np.floor(np.log10(value)) - 1)
    return float(f"{np.ceil(value / unit) * unit:.2g}")


def _larger_in_words(one: LargerGroup) -> str:
    return (
        f"larger       {one.group.name}, but for {one.what}, {100 * (1 - one.area_left):.2g}% of the area: "
        f"make them a part (what is left fits within {one.residual:.2g})"
    )
