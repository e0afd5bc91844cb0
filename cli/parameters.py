"""What several commands share: parameters for objects, sets and predictions, examples in help, the progress bar."""

import sys
from pathlib import Path
from typing import Any

import click
from click.shell_completion import CompletionItem
from tqdm import tqdm

from symsol_annot.bench.scoring.metric import LEAST_DECIMALS, MOST_DECIMALS
from symsol_annot.errors import UnknownObjectError
from symsol_annot.objects.spec import ObjectSpec, builtin_names, load_object
from symsol_annot.rendering.camera import DEFAULT_SIZE, SIZE_RANGE
from symsol_annot.rendering.engines import DEFAULT_ENGINE, ENGINES
from symsol_annot.system.text.names import SPLITS, nearest

_MESH_ENDINGS = (".obj", ".stl", ".ply", ".off", ".glb", ".gltf", ".dae")


class ObjectType(click.ParamType):  # type: ignore[type-arg]  # generic for the checker alone
    """The name of a built-in object or the path of an object's folder.

    Args:
        takes_mesh_files: whether the path of a mesh file is taken as well, and returned as it is.
    """

    name = "OBJECT"

    def __init__(self, *, takes_mesh_files: bool = False) -> None:
        self._takes_mesh_files = takes_mesh_files

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> ObjectSpec | Path:
        """Load the object; an unknown one, or one of two of that name, is a fault of the command line."""
        if is_mesh_name(value) and not Path(value).is_dir():
            if self._takes_mesh_files:
                return Path(value)
            self.fail(f"{value} is a mesh file: `symsol-annot import-object` makes an object of it", param, ctx)
        if value in builtin_names() and (Path(value) / "object.toml").is_file():
            self.fail(
                f"{value!r} is a built-in object, and an object's folder here: './{value}' names the folder; "
                "for the built-in one, rename the folder, or run the command elsewhere",
                param,
                ctx,
            )
        try:
            return load_object(value)
        except UnknownObjectError as error:
            self.fail(str(error), param, ctx)

    def shell_complete(
        self,
        ctx: click.Context,  # noqa: ARG002 - as click calls it
        param: click.Parameter,  # noqa: ARG002
        incomplete: str,
    ) -> list[CompletionItem]:
        """Offer the built-in objects, and folders where none of them fits."""
        names = [name for name in builtin_names() if name.startswith(incomplete)]
        return [CompletionItem(name) for name in names] or [CompletionItem(incomplete, type="dir")]


def is_mesh_name(name: str) -> bool:
    """Tell whether a name has the ending of a mesh file, as objects.mesh_files.reading reads them."""
    return Path(name).suffix.lower() in _MESH_ENDINGS


class NearChoice(click.Choice):  # type: ignore[type-arg]  # generic for the checker alone
    """One of some words; of a mistyped one, the nearest is named."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the word; another one is a fault of the command line."""
        try:
            return super().convert(value, param, ctx)
        except click.BadParameter:
            words = [str(choice) for choice in self.choices]
            self.fail(f"{value!r} is not one of {', '.join(words)}{nearest(str(value), words)}", param, ctx)


class Group(click.Group):
    """A command of several, whose help has the whole summary of each."""

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the name and the first paragraph of each command's help."""
        commands = [(name, self.get_command(ctx, name)) for name in self.list_commands(ctx)]
        with formatter.section("Commands"):
            rows = ((name, ((command and command.help) or "").partition("\n\n")[0]) for name, command in commands)
            formatter.write_dl([(name, " ".join(text.split())) for name, text in rows])


def example(*lines: str) -> str:
    """Return the last block of a command's help: example lines to copy into a shell."""
    return "\n".join(["\b", "Example:", *(f"  {line}" for line in lines)])


SET_FOLDER = click.argument("folder", metavar="DATA", type=click.Path(path_type=Path))
SIZE = click.option(
    "--size",
    type=click.IntRange(*SIZE_RANGE),
    default=DEFAULT_SIZE,
    show_default=True,
    help="Width and height in pixels.",
)
ENGINE = click.option(
    "--engine", type=click.Choice(list(ENGINES)), default=DEFAULT_ENGINE, show_default=True, help="Blender's engine."
)
SPLIT = click.option(
    "--split", type=NearChoice(SPLITS), default="test", show_default=True, help="Split whose images are used."
)
DECIMALS = click.option(
    "--decimals",
    type=click.IntRange(LEAST_DECIMALS, MOST_DECIMALS),
    help="Number of decimals of each image's figures in scores.json; fewer make a smaller file.  [default: 12 digits]",
)
SHOWN_PREDICTIONS = click.option(
    "--predictions",
    "paths",
    metavar="PREDS.H5",
    multiple=True,
    type=click.Path(path_type=Path),
    help="Predictions to show over the truth, worst first; may be repeated.",
)
SHOWN_SPLITS = click.option(
    "--split",
    "splits",
    type=NearChoice(SPLITS),
    multiple=True,
    default=("test",),
    show_default=True,
    help="Split whose images are shown; may be repeated.",
)
PREDICTIONS = click.argument("paths", metavar="PREDS.H5...", nargs=-1, required=True, type=click.Path(path_type=Path))
DATA = click.option(
    "--data",
    type=click.Path(path_type=Path),
    default=Path("data"),
    show_default=True,
    help="A set's folder, or the folder that holds the sets.",
)


def progress_bar(total: int | None, unit: str, done: int = 0, *, scaled: bool = False) -> "tqdm[None]":
    """Return a bar on standard error with the rate and the time left; it is silent where that is no terminal.

    Args:
        total: units of work; None where that is not known yet.
        unit: what is counted, in the singular.
        done: units that an earlier run finished, which do not count for the rate.
        scaled: whether large counts are shown in thousands and millions, as those of bytes.
    """
    return tqdm(
        total=total,
        initial=done,
        unit=unit,
        unit_scale=scaled,
        disable=None,
        file=sys.stderr,
        dynamic_ncols=True,
        smoothing=0.05,
    )


_DEFAULT_TOLERANCE = 1e-4  # as objects.finding.find has it, which takes a while to import
TOLERANCE = click.option(
    "--tolerance",
    type=click.FloatRange(1e-9, 0.05),
    default=_DEFAULT_TOLERANCE,
    show_default=True,
    help="How far a symmetry may carry a point from the surface, as a part of the mesh's radius.",
)
