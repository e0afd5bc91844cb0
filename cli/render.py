"""`symsol-annot render`: make an object's image set."""

from functools import partial
from pathlib import Path
from shlex import quote

import click
from symsol_annot_cli.parameters import ENGINE, SIZE, ObjectType, example
from symsol_annot_cli.reporting import LOG_FORMATS, Tally, failures_in_words, reporter
from symsol_annot_cli.terminal import say

from symsol_annot.errors import ClusterError
from symsol_annot.generation.events import Event, Started
from symsol_annot.generation.executors import OpenExecutor, local_processes
from symsol_annot.generation.generate import generate
from symsol_annot.generation.kept_object import KEPT_OBJECT, checked_object, keep_object
from symsol_annot.generation.process import DEFAULT_LIMITS, Limits
from symsol_annot.objects.spec import ObjectSpec
from symsol_annot.rendering.blender_process import check_blender_installed
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.settings import RenderSettings
from symsol_annot.sets.manifest import Manifest
from symsol_annot.sets.plan import SetPlan
from symsol_annot.sets.stated.settings import ANNOTATE_CHOICES
from symsol_annot.sets.stated.values import MAX_SEED
from symsol_annot.system.machine import check_extra, cores
from symsol_annot.system.text.names import SPLITS

_MIB = 2**20


@click.command(
    epilog=example(
        "symsol-annot render --object cylO",
        "symsol-annot render --object tetX --train 0 --test 100 --out small",
        "symsol-annot render --object path/to/mug --cluster tcp://10.0.0.1:8786",
    )
)
@click.option(
    "--object",
    "given",
    type=ObjectType(takes_mesh_files=True),
    required=True,
    help="A built-in object, the folder of an object of your own, or a mesh file, which is imported.",
)
@click.option(
    "--out", type=click.Path(path_type=Path), default=Path("data"), show_default=True, help="Folder of the sets."
)
@click.option(
    "--train", type=click.IntRange(min=0), default=45000, show_default=True, help="Number of training images."
)
@click.option("--test", type=click.IntRange(min=0), default=5000, show_default=True, help="Number of test images.")
@click.option(
    "--seed", type=click.IntRange(0, MAX_SEED), default=0, show_default=True, help="Seed of the random rotations."
)
@SIZE
@ENGINE
@click.option(
    "--annotate",
    type=click.Choice(ANNOTATE_CHOICES),
    default=ANNOTATE_CHOICES[0],
    show_default=True,
    help="Splits that get symmetry sets.",
)
@click.option(
    "--annotate-method",
    type=click.Choice(["auto", "exhaustive"]),
    default="auto",
    show_default=True,
    help="auto: let geometry decide where it can. exhaustive: draw every candidate. Both give the same bytes.",
)
@click.option(
    "--workers", type=click.IntRange(min=1), default=None, help="Number of Blender processes.  [default: all cores]"
)
@click.option(
    "--cluster", metavar="ADDRESS", help="Address of a Dask scheduler whose workers draw, like tls://HOST:8786."
)
@click.option(
    "--scheduler-file",
    type=click.Path(path_type=Path),
    help="As --cluster, with the address read from the scheduler's file.",
)
@click.option(
    "--worker-memory",
    metavar="MIB",
    type=click.IntRange(min=1),
    default=DEFAULT_LIMITS.memory_bytes // _MIB,
    show_default=True,
    help="A worker process that holds more memory is ended, and its shard is begun again.",
)
@click.option(
    "--worker-frames",
    metavar="N",
    type=click.IntRange(min=1),
    default=DEFAULT_LIMITS.frames,
    show_default=True,
    help="A worker process that has drawn N frames is replaced after its shard.",
)
@click.option(
    "--time-limit",
    metavar="SECONDS",
    type=click.FloatRange(min=0, min_open=True),
    default=DEFAULT_LIMITS.silence_s,
    show_default=True,
    help="A worker process that gives no sign of life for this long is ended, and its shard is begun again.",
)
@click.option(
    "--depth", is_flag=True, help="Store a depth map per image as well (engine opengl only); shards get larger."
)
@click.option("--repair", is_flag=True, help="Make damaged or missing shards again, and replace foreign ones.")
@click.option(
    "--log-format",
    type=click.Choice(LOG_FORMATS),
    default=LOG_FORMATS[0],
    show_default=True,
    help="Form of the progress on standard error.",
)
def render(
    given: ObjectSpec | Path,
    out: Path,
    train: int,
    test: int,
    seed: int,
    size: int,
    engine: str,
    annotate: str,
    annotate_method: str,
    workers: int | None,
    cluster: str | None,
    scheduler_file: Path | None,
    worker_memory: int,
    worker_frames: int,
    time_limit: float,
    log_format: str,
    *,
    depth: bool,
    repair: bool,
) -> None:
    """Make an object's image set: RGB, segmentation and symmetry sets, in HDF5 shards.

    With --object alone it makes the published set. Re-running the command resumes it, even after a crash.
    """
    if train == test == 0:
        raise click.UsageError("--train and --test are both 0, which makes no set; --train 0 alone is fine")
    limits = Limits(worker_frames, worker_memory * _MIB, time_limit)
    open_executor = _executor(workers, cluster, scheduler_file, limits, exhaustive=annotate_method == "exhaustive")
    settings = RenderSettings(engine, depth=depth)
    spec, files = (given, None) if isinstance(given, ObjectSpec) else _imported(given)
    plan = SetPlan(spec, {"train": train, "test": test}, seed, Camera.filling(size), settings, annotate)
    folder = out / spec.name
    with reporter(log_format, spec.name) as report:

        def on_event(event: Event) -> None:
            if files is not None and isinstance(event, Started):  # the folder is this set's
                keep_object(folder, files)
            report(event)

        try:
            manifest = generate(plan, folder, open_executor, on_event, repair=repair)
        except KeyboardInterrupt:
            say(f"Finished shards in {folder} are kept; re-running the command resumes it.", err=True)
            raise
    _summarise(folder, manifest, report.tally)
    if files is not None:
        say(f"The object that was made of {given} is kept in {folder / KEPT_OBJECT}, where `verify --audit` finds it.")


def _imported(path: Path) -> tuple[ObjectSpec, dict[str, bytes]]:
    """Return the object that a mesh file describes, and the files that make it; say what was found and done."""
    from symsol_annot_cli.import_object import import_in_words, object_name  # noqa: PLC0415 - of no use to other objects

    from symsol_annot.objects.importing.importing import ImportOptions, import_mesh  # noqa: PLC0415 - takes scipy
    from symsol_annot.objects.importing.object_writing import object_files  # noqa: PLC0415

    imported = import_mesh(path, object_name(path.stem), ImportOptions())
    files = object_files(imported.draft)
    spec = checked_object(files)
    say("\n".join(import_in_words(imported, spec)))
    return spec, files


def _executor(
    workers: int | None, cluster: str | None, scheduler_file: Path | None, limits: Limits, *, exhaustive: bool
) -> OpenExecutor:
    if sum(choice is not None for choice in (workers, cluster, scheduler_file)) > 1:
        raise click.UsageError("--workers, --cluster and --scheduler-file are three ways to say who works; give one")
    if cluster is None and scheduler_file is None:
        check_blender_installed()
        return partial(local_processes, workers=workers or cores(), limits=limits, exhaustive=exhaustive)
    check_extra("cluster", "a cluster")
    try:
        from symsol_annot.generation.dask.address import address_in, is_unprotected  # noqa: PLC0415
        from symsol_annot.generation.dask.executor import DaskCluster  # noqa: PLC0415 - an extra, slow to import
    except ValueError as error:  # Dask reads its configuration when it is imported
        raise ClusterError(f"Dask cannot be imported before its configuration is corrected: {error}") from None

    address = address_in(scheduler_file) if scheduler_file else cluster or ""
    if is_unprotected(address):
        say(
            f"Warning: the connection to {address} is neither encrypted nor authenticated: whoever is on its way reads "
            "it, and can run code here, on the scheduler and on its workers; docs/scale.md#tls says how to protect it",
            err=True,
        )
    return partial(DaskCluster, address=address, limits=limits, exhaustive=exhaustive)


def _summarise(folder: Path, manifest: Manifest, tally: Tally) -> None:
    say(f"{folder}: {manifest.settings.object}, fingerprint {manifest.fingerprint}")
    for split in SPLITS:
        entries = manifest.of_split(split)
        if entries:
            mebibytes = sum(entry.bytes or 0 for entry in entries) / 2**20
            sets = "with symmetry sets" if manifest.is_annotated(split) else "without symmetry sets"
            say(f"  {split}: {manifest.images(split)} images {sets}, {len(entries)} shards, {mebibytes:.1f} MiB")
    for line in failures_in_words(tally):
        say(line)
    split = "test" if manifest.images("test") else "train"
    path, code = quote(str(folder)), f"import symsol_annot; print(symsol_annot.load({str(folder)!r}, {split!r})[0])"
    say(f"Next:\n  symsol-annot verify {path}\n  symsol-annot plot images {path} --split {split}")
    say(f"  python -c {quote(code)}")
