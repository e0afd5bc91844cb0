"""`symsol-annot objects`: list the built-in objects."""

import click
from symsol_annot_cli.parameters import example
from symsol_annot_cli.terminal import say

from symsol_annot.objects.spec import PUBLISHED_NAMES, ObjectSpec, builtin_names, load_object


@click.command(epilog=example("symsol-annot objects"))
def objects() -> None:
    """List the built-in objects: those of the published benchmark, and what ships beside them."""
    say(f"{'name':<7}{'|C|':>6}{'|H|':>5}{'T (px)':>8}  what")
    others = [name for name in builtin_names() if name not in PUBLISHED_NAMES]
    for name in PUBLISHED_NAMES:
        say(_line(load_object(name)))
    say("beside those of the published benchmark, with parts that are compared one by one:")
    for name in others:
        say(_line(load_object(name)))
    say(
        "|C|: rotations of the body's symmetry group, the candidates of an image.\n"
        "|H|: those that leave the marking in place, the set of an image that shows it.\n"
        "     With parts: those that leave each of them in place; they are in every set.\n"
        "T: the marking is hidden where it covers less than this area.\n"
        "     With parts: images are the same that differ by less than this area."
    )


def _line(spec: ObjectSpec) -> str:
    tolerance = f"{spec.marking.tolerance_px:g}" if spec.marking else "-"
    parts = ": " + ", ".join(part.name for part in spec.parts) if len(spec.parts) > 1 and spec.has_general_rule else ""
    candidates = "SO(3)" if spec.has_all_rotations else str(len(spec.symmetry_group))
    return f"{spec.name:<7}{candidates:>6}{len(spec.stabiliser):>5}{tolerance:>8}  {spec.title}{parts}"
