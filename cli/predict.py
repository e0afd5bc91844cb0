"""`symsol-annot predict`: write a trained model's predictions."""

from pathlib import Path

import click
from symsol_annot_cli.parameters import DATA, SPLIT, example
from symsol_annot_cli.terminal import say

from symsol_annot.bench.predictions.truth import find_set
from symsol_annot.rotations.grid import STANDARD_LEVEL
from symsol_annot.sets import dataset
from symsol_annot.system.machine import check_extra


@click.command(epilog=example("symsol-annot predict runs/tetX-small-ewta --data data --out preds.h5"))
@click.argument("checkpoint", type=click.Path(path_type=Path))
@DATA
@SPLIT
@click.option(
    "--out",
    type=click.Path(path_type=Path, dir_okay=False),
    default=Path("preds.h5"),
    show_default=True,
    help="The predictions file.",
)
@click.option(
    "--device", default="auto", show_default=True, help="What the network runs on: auto, cpu, cuda or cuda:N."
)
@click.option("--method", help="The method's name in the file.  [default: the recipe's name]")
@click.option(
    "--level", type=click.IntRange(0, 5), default=STANDARD_LEVEL, show_default=True, help="Level of the grid."
)
@click.option(
    "--precision",
    type=click.Choice(["float32", "bfloat16", "auto"]),
    default="float32",
    show_default=True,
    help="Of the products that score rotations. bfloat16 is faster on CPUs that compute in it; auto takes it there.",
)
@click.option(
    "--compile",
    "is_compiled",
    is_flag=True,
    help="Use torch.compile to score rotations, which makes bfloat16 faster. Needs a C++ compiler.",
)
@click.option(
    "--hypotheses",
    type=click.Choice(["balanced", "covering", "surest"]),
    default="balanced",
    show_default=True,
    help="Of a mixture: covering lists 180 that leave less of the set out, surest the one that is expected to be "
    "nearest to it. Both write hypotheses alone.",
)
def predict(
    checkpoint: Path,
    data: Path,
    split: str,
    out: Path,
    device: str,
    method: str | None,
    level: int,
    precision: str,
    hypotheses: str,
    *,
    is_compiled: bool,
) -> None:
    """Write the predictions of a trained model, for `score`.

    CHECKPOINT is the folder that `train` wrote, or a file of weights in it. Re-running an interrupted command resumes
    it; the answers of another checkpoint are refused.
    """
    check_extra("bench", "predicting")
    from symsol_annot.bench.models import devices, inference  # noqa: PLC0415 - slow to import
    from symsol_annot.bench.models.training import checkpoints  # noqa: PLC0415

    chosen = devices.choose_device(device)
    model = checkpoints.open_checkpoint(checkpoint)
    with dataset.load(find_set(data, model.record.object), split) as images:
        tracks = inference.predict(
            model,
            images,
            out,
            chosen,
            method=method,
            level=level,
            precision=precision,
            is_compiled=is_compiled,
            hypotheses=hypotheses,
        )
    say(
        f"{out}: {', '.join(tracks)} about {len(images)} images of {images.object}\n"
        f"Next:\n  symsol-annot score {out} --data {data}"
    )
