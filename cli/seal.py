"""`symsol-annot seal`: a sealed test, made, published without labels, and checked once its seed is revealed."""

import re
import sys
from functools import partial
from pathlib import Path
from shlex import quote

import click
from symsol_annot_cli.parameters import ENGINE, SET_FOLDER, SIZE, Group, ObjectType, example
from symsol_annot_cli.reporting import reporter
from symsol_annot_cli.terminal import say

from symsol_annot.errors import SealError
from symsol_annot.generation.executors import OpenExecutor, local_processes
from symsol_annot.generation.maker import software_of
from symsol_annot.objects.spec import ObjectSpec
from symsol_annot.rendering.blender_process import check_blender_installed
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.render_process import RenderProcess
from symsol_annot.rendering.settings import RenderSettings
from symsol_annot.sealing import checking, making
from symsol_annot.sealing.secret import (
    COMMITMENT_NAME,
    LABELLED,
    PUBLIC,
    SECRET_NAME,
    SEED_DIGITS,
    SPLIT,
    read_commitment,
    read_secret,
)
from symsol_annot.sets.plan import SetPlan
from symsol_annot.system.machine import cores

_FOLDER = click.argument("folder", metavar="SEALED", type=click.Path(path_type=Path))
_OWN_OBJECT = click.option(
    "--object", "spec", type=ObjectType(), help="The object to draw, where it is a folder of your own."
)
_WORKERS = click.option(
    "--workers", type=click.IntRange(min=1), default=None, help="Number of Blender processes.  [default: all cores]"
)


class _HexType(click.ParamType):  # type: ignore[type-arg]  # generic for the checker alone
    """So many hexadecimal digits."""

    name = "HEX"

    def __init__(self, digits: int) -> None:
        self._digits = digits

    def convert(self, value: str, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """Return the digits in lower case; anything else is a fault of the command line."""
        found = value.strip().lower()
        if not re.fullmatch(rf"[0-9a-f]{{{self._digits}}}", found):
            self.fail(f"expected {self._digits} hexadecimal digits, found {value!r}", param, ctx)
        return found


@click.group(cls=Group)
def seal() -> None:
    """Make a test whose labels are secret until its seed is revealed, and check it then."""


@seal.command(
    epilog=example("symsol-annot seal new --object cylO", "symsol-annot seal new --object tetX --images 100 --size 64")
)
@click.option(
    "--object",
    "spec",
    type=ObjectType(),
    required=True,
    help="A built-in object, or the folder of an object of your own.",
)
@click.option("--images", type=click.IntRange(min=1), default=5000, show_default=True, help="Number of images.")
@click.option(
    "--out", type=click.Path(path_type=Path), default=Path("sealed"), show_default=True, help="Folder of sealed tests."
)
@SIZE
@ENGINE
def new(spec: ObjectSpec, images: int, out: Path, size: int, engine: str) -> None:
    """Draw a secret seed of 128 bits, and write the commitment to it, which is to be published."""
    check_blender_installed()
    plan = SetPlan(spec, {SPLIT: images}, 0, Camera.filling(size), RenderSettings(engine), SPLIT)
    folder = out / spec.name
    secret = making.seal(plan, _software(plan), folder)
    path = quote(str(folder))
    say(f"{folder}: a sealed test of {images} images of {spec.name}")
    say(f"  digest {secret.digest}")
    say(f"  {folder / COMMITMENT_NAME}: publish it now, or the digest alone, where its date is on record")
    say(f"  {folder / SECRET_NAME}: keep it to yourself, with a copy elsewhere; nothing makes it again")
    say(f"Next:\n  symsol-annot seal render {path}")


@seal.command(epilog=example("symsol-annot seal render sealed/cylO"))
@_FOLDER
@_OWN_OBJECT
@_WORKERS
def render(folder: Path, spec: ObjectSpec | None, workers: int | None) -> None:
    """Make the images of a sealed test, with labels for its owner and without for everybody.

    Re-running the command resumes it, even after a crash.
    """
    test = _made(folder, spec, workers)
    digest, public = test.secret.digest, folder / PUBLIC
    say(f"{folder / LABELLED}: {test.secret.images} images with labels, for you alone")
    say(f"{public}: the same images without labels, to be published as it is")
    say(f"  fingerprint {test.public.split_fingerprint(SPLIT)}\n  sealed with  {digest}")
    secret = quote(str(folder / SECRET_NAME))
    say(f"Next, with predictions:\n  symsol-annot score preds.h5 --data {quote(str(public))} --secret {secret}")


@seal.command(epilog=example("symsol-annot seal reveal sealed/cylO"))
@_FOLDER
def reveal(folder: Path) -> None:
    """Print the seed of a sealed test and the command that checks it, once no more predictions are taken."""
    secret = read_secret(folder / SECRET_NAME)
    if secret.commitment != read_commitment(folder / COMMITMENT_NAME):
        raise SealError(f"{folder}: {SECRET_NAME} is not what {COMMITMENT_NAME} was made of; one is another test's")
    say(f"digest {secret.digest}\nseed   {secret.seed_hex}")
    options = f"--seed {secret.seed_hex} --digest {secret.digest}"
    say(f"Whoever has the images checks both:\n  symsol-annot seal check {PUBLIC} {options}")


@seal.command(epilog=example("symsol-annot seal check public --seed 00112233445566778899aabbccddeeff"))
@SET_FOLDER
@click.option("--seed", type=_HexType(SEED_DIGITS), required=True, help="The seed that was revealed.")
@click.option("--digest", type=_HexType(64), help="The digest that was published beforehand, to be compared as well.")
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("checked"),
    show_default=True,
    help="Folder for what is made again.",
)
@_OWN_OBJECT
@_WORKERS
def check(folder: Path, seed: str, digest: str | None, out: Path, spec: ObjectSpec | None, workers: int | None) -> None:
    """Make a sealed test again from its revealed seed, and compare its images with the published ones.

    DATA is the folder that was published. Afterwards --out holds the labels, too: scores can be computed again.
    """
    secret = checking.revealed_secret(folder, int(seed, 16), digest)
    published = "which was published beforehand" if digest else "to be compared with the one published beforehand"
    say(f"{folder}: the seed fits the digest {secret.digest}, {published}")
    place = out / secret.settings.object
    with reporter("text", secret.settings.object) as report:
        found = checking.check(folder, secret, place, _executor(workers), report, given=spec)
    shards = len(found.test.public.shards)
    say(f"{place}: made again: {shards - len(found.other_images)} of {shards} shards have the published images")
    say(f"  {shards - len(found.other_bytes)} of {shards} are the same to the byte")
    for line in found.other_software:
        say(f"  {line}")
    if found.other_images:
        why = "other software draws here" if found.other_software else "the published images are not of this seed"
        say(f"FAULT {folder}: other images in {', '.join(found.other_images)}: {why}")
        sys.exit(1)
    secret_path = quote(str(place / SECRET_NAME))
    say(f"Next:\n  symsol-annot score preds.h5 --data {quote(str(folder))} --secret {secret_path}")


def _made(folder: Path, spec: ObjectSpec | None, workers: int | None) -> making.SealedTest:
    name = read_secret(folder / SECRET_NAME).settings.object
    with reporter("text", name) as report:
        try:
            return making.render(folder, _executor(workers), _software, report, given=spec)
        except KeyboardInterrupt:
            say(f"Finished shards in {folder} are kept; re-running the command resumes it.", err=True)
            raise


def _executor(workers: int | None) -> OpenExecutor:
    check_blender_installed()
    return partial(local_processes, workers=workers or cores())


def _software(plan: SetPlan) -> dict[str, str]:
    """Return the software here that decides the bytes of a plan's set: name to version."""
    with RenderProcess(plan.spec, plan.camera, plan.settings) as renderer:
        return software_of(renderer)
