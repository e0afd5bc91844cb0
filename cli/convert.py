"""`symsol-annot convert`: make a predictions file of arrays in other forms, frames and files."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click
from symsol_annot_cli.parameters import DATA, SPLIT, NearChoice, example
from symsol_annot_cli.terminal import say

from symsol_annot.bench.predictions.foreign.conversion import (
    Given,
    columns_of,
    is_in_the_files_form,
    to_hypotheses,
    told,
)
from symsol_annot.bench.predictions.foreign.files import read_arrays
from symsol_annot.bench.predictions.foreign.forms import FORMS, ORDERS
from symsol_annot.bench.predictions.foreign.frames import FRAMES
from symsol_annot.bench.predictions.tracks.table import TRACKS
from symsol_annot.bench.scoring.memory.foreign import split_of
from symsol_annot.errors import PredictionsError, WeightsError
from symsol_annot.sets.dataset import Dataset
from symsol_annot.system.machine import check_extra

_OF_TORCH = (".pt", ".pth")
_READ = (".npz", ".npy", ".csv", *_OF_TORCH)
_FORMS = "; ".join(f"{name}: {form.words}" for name, form in FORMS.items())
_FRAMES = "; ".join(f"{name}: {frame.words}" for name, frame in FRAMES.items())


@click.command(
    epilog=example(
        "symsol-annot convert preds.npz --data data/cylO",
        "symsol-annot convert quats.npy --order xyzw --frame opengl --data data/cylO --out preds.h5",
    )
)
@click.argument("path", metavar="IN", type=click.Path(path_type=Path))
@DATA
@SPLIT
@click.option("--object", "object_name", metavar="NAME", help="Name of the object, where --data holds several sets.")
@click.option(
    "--out",
    type=click.Path(path_type=Path, dir_okay=False),
    default=Path("preds.h5"),
    show_default=True,
    help="The predictions file; where it is there, the track is added to it.",
)
@click.option("--method", help="What the method calls itself.  [default: the name of IN]")
@click.option("--array", metavar="NAME", help="Name of the array that holds the rotations, where there are several.")
@click.option("--form", type=NearChoice(list(FORMS)), help=f"What the numbers are. {_FORMS}.  [default: by the shape]")
@click.option(
    "--order", type=NearChoice(ORDERS), help="The order of quaternions: whether the scalar w is first or last."
)
@click.option(
    "--frame",
    "frames",
    type=NearChoice(list(FRAMES)),
    multiple=True,
    help=f"How the rotations differ from those of docs/conventions.md; may be repeated. {_FRAMES}.",
)
def convert(
    path: Path,
    data: Path,
    split: str,
    object_name: str | None,
    out: Path,
    method: str | None,
    array: str | None,
    form: str | None,
    order: str | None,
    frames: tuple[str, ...],
) -> None:
    """Make a predictions file of rotations in another form, frame or file.

    IN is a .npz, a .npy or a file of torch.save with rotations of shape (images, hypotheses, ...), or (images, ...) for
    one per image; or a .csv with the columns image_index, perhaps weight, and the numbers of a rotation, a line per
    hypothesis. An array image_index says which image each row is about; without it rows are in the order of the images.
    """
    if path.suffix not in _READ:
        raise click.UsageError(f"{path}: files that are read end in {', '.join(_READ)}")
    arrays = _of_torch(path) if path.suffix in _OF_TORCH else dict(read_arrays(path))
    with split_of(arrays, data, split, object_name or "") as dataset:
        name = method or told(arrays, "method") or path.stem
        _write(out, dataset, arrays, Given(array, form, order, frames), name)
        say(
            f"{out}: predictions of {name!r} about {len(dataset)} images of {dataset.object}\n"
            f"Next:\n  symsol-annot score {out} --data {dataset.folder}"
        )


def _write(out: Path, dataset: Dataset, arrays: Mapping[str, Any], given: Given, method: str) -> None:
    from symsol_annot.bench.predictions.writing.submission import (  # noqa: PLC0415 - brings HDF5
        write_columns,
        write_hypotheses,
    )

    if not is_in_the_files_form(arrays):
        found = to_hypotheses(arrays, len(dataset), given)
        rotations = found.rotations.__getitem__ if isinstance(found.rotations, list) else found.rotations
        write_hypotheses(out, dataset, rotations, method=method, weights=found.weights, progress=False)
        return
    if given != Given():
        raise click.UsageError("--array, --form, --order and --frame are about rotations; these arrays are on the grid")
    for track, columns in columns_of(arrays).items():
        attributes = {name: value for name, value in columns.items() if name in TRACKS[track].attributes}
        datasets = {name: value for name, value in columns.items() if name not in attributes}
        write_columns(out, dataset, track, datasets, method=method, **attributes)


def _of_torch(path: Path) -> dict[str, Any]:
    """Return the tensors of a file of torch.save, which a process with limits reads, as arrays."""
    check_extra("bench", "reading files of torch.save")
    from symsol_annot.bench.models.weights.state_dicts import read_weights  # noqa: PLC0415 - slow to import

    try:
        return {
            name: tensor.detach().float().numpy()
            if tensor.dtype.is_floating_point and tensor.element_size() < 4
            else tensor.detach().numpy()
            for name, tensor in read_weights(path).items()
        }
    except WeightsError as error:
        raise PredictionsError(
            str(path),
            [f"the file: {error}. Tensors by their names are read: torch.save({{'hypotheses': R.cpu()}}, 'preds.pt')"],
        ) from None
