"""`symsol-annot objects`: list the built-in objects."""

import click
from symsol_annot_cli.parameters import example
from symsol_annot_cli.terminal import say

from symsol_annot.objects.spec import builtin_names, load_object


@click.command(epilog=example("symsol-annot objects"))
def objects() -> None:
    """List the built-in objects."""
    say(f"{'name':<7}{'|C|':>5}{'|H|':>5}{'T (px)':>8}  what")
    for name in builtin_names():
        spec = load_object(name)
        tolerance = f"{spec.marking.tolerance_px:g}" if spec.marking else "-"
        say(f"{name:<7}{len(spec.symmetry_group):>5}{len(spec.stabiliser):>5}{tolerance:>8}  {spec.title}")
    say(
        "|C|: rotations of the body's symmetry group, the candidates of an image.\n"
        "|H|: those that leave the marking in place, the set of an image that shows it.\n"
        "T: the marking is hidden where it covers less than this area."
    )
