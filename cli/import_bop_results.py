"""`symsol-annot import-bop-results`: a CSV of BOP as a predictions file."""

from pathlib import Path

import click
from symsol_annot_cli.parameters import SPLIT, example
from symsol_annot_cli.terminal import say

from symsol_annot.bop.numbering import FIRST_SCENE
from symsol_annot.bop.results import read_results, write_results
from symsol_annot.sets.dataset import load


@click.command(
    "import-bop-results",
    epilog=example(
        "symsol-annot import-bop-results mine_cylO-test.csv --data data/cylO --out preds.h5",
        "symsol-annot score preds.h5",
    ),
)
@click.argument("path", metavar="CSV", type=click.Path(path_type=Path))
@click.option("--data", type=click.Path(path_type=Path), required=True, help="Folder of the set that was exported.")
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("preds.h5"),
    show_default=True,
    help="The predictions file.",
)
@SPLIT
@click.option("--obj-id", type=click.IntRange(min=1), default=1, show_default=True, help="Id of the object in the CSV.")
@click.option(
    "--first-scene",
    type=click.IntRange(min=1),
    default=FIRST_SCENE,
    show_default=True,
    help="Id of the object's first scene, as dataset_info.md says it for the second object and later ones.",
)
@click.option("--method", help="Name of the method.  [default: the CSV's name without its ending]")
@click.option("--alike", is_flag=True, help="Count all estimates of an image alike, whatever their scores.")
@click.option(
    "--fill-missing", is_flag=True, help="Give images without an estimate the identity; otherwise they are refused."
)
def import_bop_results(
    path: Path,
    data: Path,
    out: Path,
    split: str,
    obj_id: int,
    first_scene: int,
    method: str | None,
    *,
    alike: bool,
    fill_missing: bool,
) -> None:
    """Write a CSV of BOP's results as a predictions file, which `symsol-annot score` scores.

    The CSV is about the images of a set that `symsol-annot export-bop` wrote. Its rotations become hypotheses and its
    scores their weights; translations and times are left out.
    """
    with load(data, split) as dataset:
        results = read_results(path, len(dataset), obj_id, first_scene, alike=alike)
        missing = write_results(out, dataset, results, method=method or path.stem, fill_missing=fill_missing)
    filled = f", {missing} images without one got the identity" if missing else ""
    others = f", {results.others} of other objects were left out" if results.others else ""
    say(f"{out}: {len(results.index)} estimates of {len(dataset)} images{filled}{others}")
