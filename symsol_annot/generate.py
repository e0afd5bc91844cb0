"""Making a set: a plan of shards, carried out by workers that each hold a renderer.

The plan depends on nothing but the settings, and a shard on nothing but the plan, so that the bytes are the
same whatever the number of workers and the order they worked in.
"""

import hashlib
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from itertools import count
from pathlib import Path
from queue import Empty, SimpleQueue

import numpy as np

from symsol_annot import __version__
from symsol_annot.annotate import annotate, is_shown, marking_pixels
from symsol_annot.errors import DataError, DifferentSetError, RendererCrashedError, SettingsError
from symsol_annot.files import file_sha256, locked, make_folder, output_errors, remove_partial_files, write_atomically
from symsol_annot.manifest import MANIFEST_NAME, SPLITS, Manifest, ShardEntry, read_manifest, write_manifest
from symsol_annot.objects import ObjectSpec
from symsol_annot.scene import Camera, Renderer, RenderSettings
from symsol_annot.shards import ImageRecord, ShardFile, ShardHeader, ShardWriter, read_versions, storage_versions
from symsol_annot.so3 import Rotations, uniform_rotations
from symsol_annot.visibility import MarkingVisibility, is_convex

ANNOTATE_CHOICES = ("all", "test", "none")
MAX_IMAGES_PER_SHARD = 500
MAX_SEED = 2**63 - 1  # HDF5 stores it as a 64-bit integer
_MAX_PIXELS_PER_SHARD = 2**25  # a shard is built in memory
_SMALL_SET_SHARDS = 8  # a small set is still divided, so that several workers have work
_MIN_IMAGES_PER_SHARD = 16
MAX_CRASHES_PER_SHARD = 2

OpenRenderer = Callable[[], Renderer]
OnImage = Callable[[], object]
OnCrash = Callable[[str, RendererCrashedError], object]


@dataclass(frozen=True)
class SetPlan:
    """All that decides a set's bytes.

    Attributes:
        spec: the object.
        images: how many images a split has, by split.
        seed: of the random rotations.
        camera: what the object is seen through.
        settings: how it is drawn.
        annotate: which splits get symmetry sets: "all", "test" or "none".
    """

    spec: ObjectSpec
    images: dict[str, int]
    seed: int
    camera: Camera
    settings: RenderSettings
    annotate: str

    def __post_init__(self) -> None:
        """Refuse counts and choices that make no set."""
        if any(number < 0 for number in self.images.values()) or not any(self.images.values()):
            raise SettingsError(f"images: expected counts of 0 or more that are not all 0, found {self.images}")
        if set(self.images) - set(SPLITS):
            raise SettingsError(f"splits: expected {', '.join(SPLITS)}, found {', '.join(self.images)}")
        if self.annotate not in ANNOTATE_CHOICES:
            raise SettingsError(f"annotate: expected one of {', '.join(ANNOTATE_CHOICES)}, found {self.annotate!r}")
        if not 0 <= self.seed <= MAX_SEED:
            raise SettingsError(f"seed: expected 0 to {MAX_SEED}, found {self.seed}")

    @classmethod
    def of(cls, manifest: Manifest, spec: ObjectSpec) -> "SetPlan":
        """Return the plan that a set was made by; whether the object is the right one is for `generate` to find."""
        recipe = manifest.recipe
        images = {split: manifest.images(split) for split in SPLITS}
        camera, settings = Camera(**recipe["camera"]), RenderSettings.from_dict(recipe["render"])
        return cls(spec, images, recipe["seed"], camera, settings, recipe["annotate"])

    def manifest(self) -> Manifest:
        """Return the manifest of the set before its first shard is written."""
        recipe = {
            "object": self.spec.name,
            "object_sha256": self.spec.digest,
            "seed": self.seed,
            "camera": self.camera.to_dict(),
            "render": self.settings.to_dict(),
            "tolerance_px": self.spec.marking.tolerance_px if self.spec.marking else None,
            "annotate": self.annotate,
        }
        return Manifest(recipe, tuple(entry for split in SPLITS for entry in self._shards(split)))

    def _shards(self, split: str) -> Iterator[ShardEntry]:
        images = self.images.get(split, 0)
        fitting = max(1, _MAX_PIXELS_PER_SHARD // (self.camera.width * self.camera.height))
        per_shard = max(_MIN_IMAGES_PER_SHARD, -(-images // _SMALL_SET_SHARDS))
        per_shard = min(per_shard, MAX_IMAGES_PER_SHARD, fitting)
        shards = -(-images // per_shard)
        for number in range(shards):
            first = number * per_shard
            name = f"{split}-{number:05d}-of-{shards:05d}.h5"
            yield ShardEntry(name, split, first, min(per_shard, images - first))


def label_rotation(seed: int, object_name: str, split: str, index: int) -> Rotations:
    """Return the rotation (3, 3) of one image: uniform on SO(3), from these four values alone."""
    key = hashlib.sha256(f"{seed}/{object_name}/{split}/{index}".encode()).digest()
    rng = np.random.Generator(np.random.Philox(key=np.frombuffer(key[:16], dtype="<u8")))
    return uniform_rotations(1, rng)[0]


def generate(
    plan: SetPlan,
    folder: Path,
    open_renderer: OpenRenderer,
    workers: int = 1,
    on_image: OnImage = lambda: None,
    *,
    exhaustive: bool = False,
    repair: bool = False,
    on_crash: OnCrash = lambda *_: None,
) -> Manifest:
    """Make the shards of a plan that the folder does not hold yet, and return the finished manifest.

    Args:
        plan: the set.
        folder: where its shards and its manifest go.
        open_renderer: starts a renderer; each worker calls it once.
        workers: how many shards are made at the same time.
        on_image: called after each image, also for those of shards that are there already.
        exhaustive: draw every candidate, also where geometry decides; the bytes are the same.
        repair: make damaged or missing shards again that were finished once, too.
        on_crash: called when a renderer crashed and its shard is begun again with a new one: shard, error.

    Raises:
        DifferentSetError: the folder holds another set; nothing was touched.
        DataError: a finished shard in the folder is damaged, or made again it is not what the manifest says; that shard
            was not touched.
        OutputError: the folder cannot be written to.
        RenderError: a renderer failed, or crashed at one shard more than twice; finished shards are kept.
    """
    manifest = _open_set(plan, folder)
    damaged = damaged_shards(folder, manifest)
    if damaged and not repair:
        raise DataError(
            f"{folder}: finished shards are missing or damaged: {', '.join(entry.file for entry in damaged)}. "
            "`symsol-annot verify` says more, and with --repair it makes them again"
        )
    todo = [entry for entry in manifest.shards if not entry.is_finished or entry in damaged]
    for _ in range(sum(entry.images for entry in manifest.shards) - sum(entry.images for entry in todo)):
        on_image()
    visibility = None if exhaustive else visibility_of(plan)
    _Run(plan, folder, open_renderer, on_image, manifest, todo, visibility, on_crash).carry_out(workers)
    return read_manifest(folder)


def damaged_shards(folder: Path, manifest: Manifest) -> list[ShardEntry]:
    """Return the shards that were finished once and are not there, or not as they were."""
    return [entry for entry in manifest.shards if entry.is_finished and not _is_whole(folder, entry)]


def visibility_of(plan: SetPlan) -> MarkingVisibility | None:
    """Return what decides by geometry whether a plan's marking shows; None without a marking or a convex body."""
    spec = plan.spec
    if spec.marking is None or not is_convex(spec.mesh):
        return None
    return MarkingVisibility(spec.mesh, plan.camera, plan.settings)


def _open_set(plan: SetPlan, folder: Path) -> Manifest:
    """Return the manifest to go on from: the one that is there, if it is of this plan, or a new one; touch nothing."""
    planned = plan.manifest()
    with output_errors(folder):
        is_there = (folder / MANIFEST_NAME).exists()
        foreign = sorted(path.name for path in folder.glob("*.h5")) if folder.is_dir() else []
    if is_there:
        manifest = read_manifest(folder)
        differences = planned.differences(manifest)
        if differences:
            raise DifferentSetError(str(folder), differences)
        return manifest
    if foreign:
        raise DifferentSetError(str(folder), [f"it holds {foreign[0]} without a {MANIFEST_NAME}"])
    return planned


def _is_whole(folder: Path, entry: ShardEntry) -> bool:
    try:
        return file_sha256(folder / entry.file) == entry.sha256
    except OSError:
        return False


def _check_same_software(folder: Path, manifest: Manifest, versions: dict[str, str]) -> None:
    """Refuse to finish a set with other software than it was begun with: its bytes would not be reproducible."""
    for entry in manifest.shards:
        if entry.is_finished and _is_whole(folder, entry):
            there = read_versions(folder / entry.file)
            names = sorted(name for name in {*there, *versions} if there.get(name) != versions.get(name))
            if names:
                differences = [f"{name}: there {there.get(name)}, here {versions.get(name)}" for name in names]
                raise DifferentSetError(str(folder), differences)
            return


class _Run:
    """One carrying-out of a plan; its threads share the queue of shards, the manifest and the will to stop."""

    def __init__(
        self,
        plan: SetPlan,
        folder: Path,
        open_renderer: OpenRenderer,
        on_image: OnImage,
        manifest: Manifest,
        todo: list[ShardEntry],
        visibility: MarkingVisibility | None,
        on_crash: OnCrash,
    ) -> None:
        self._plan, self._folder, self._open_renderer = plan, folder, open_renderer
        self._on_image, self._on_crash = on_image, on_crash
        self._manifest, self._visibility = manifest, visibility
        self._lock = threading.Lock()
        self._stopping = threading.Event()
        self._is_prepared = False
        self._crashes: Counter[str] = Counter()  # by shard
        self._counted: Counter[str] = Counter()  # images of a shard that `on_image` was called for
        self._renderers: list[Renderer] = []
        self._queue: SimpleQueue[ShardEntry] = SimpleQueue()
        self._todo = todo
        for entry in todo:
            self._queue.put(entry)

    def carry_out(self, workers: int) -> None:
        """Make all shards to do; on an error or Ctrl-C, stop at once and keep the finished ones."""
        threads = max(1, min(workers, len(self._todo)))
        if not self._todo:
            return
        with ExitStack() as self._held, ThreadPoolExecutor(threads, thread_name_prefix="shard") as pool:
            try:
                futures = [pool.submit(self._work) for _ in range(threads)]
                done, _ = wait(futures, return_when=FIRST_EXCEPTION)
            except BaseException:
                self._stop()
                raise
            failed = [future for future in done if future.exception() is not None]
            if failed:
                self._stop()
                failed[0].result()

    def _stop(self) -> None:
        self._stopping.set()
        with self._lock:
            for renderer in self._renderers:
                renderer.close()

    def _work(self) -> None:
        """Make shards until none is left, with a new renderer after one that crashed."""
        while not (self._stopping.is_set() or self._queue.empty()):
            with self._open_renderer() as renderer:
                with self._lock:
                    self._renderers.append(renderer)
                versions = software_versions(renderer)  # waits for it to start
                with self._lock:
                    self._prepare_folder(versions)
                self._work_with(renderer)

    def _work_with(self, renderer: Renderer) -> None:
        """Make shards until none is left or the renderer crashes; its shard is then begun again."""
        while not self._stopping.is_set():
            try:
                entry = self._queue.get_nowait()
            except Empty:
                return
            on_image = partial(self._image_done, entry, count(1))
            try:
                shard = make_shard(self._plan, entry, renderer, on_image, self._visibility)
            except RendererCrashedError as error:
                self._begin_again(entry, error)
                return
            self._keep(entry, shard)

    def _begin_again(self, entry: ShardEntry, error: RendererCrashedError) -> None:
        """Put a shard back, unless it has crashed renderers too often, or all work is to stop."""
        with self._lock:
            self._crashes[entry.file] += 1
            if self._stopping.is_set() or self._crashes[entry.file] > MAX_CRASHES_PER_SHARD:
                raise error
            self._on_crash(entry.file, error)
        self._queue.put(entry)

    def _prepare_folder(self, versions: dict[str, str]) -> None:
        """Take the folder and write the manifest before the first shard, but only once there is a renderer for it."""
        if self._is_prepared:
            return
        make_folder(self._folder)
        self._held.enter_context(locked(self._folder))
        self._manifest = _open_set(self._plan, self._folder)  # again: another process may have come first
        _check_same_software(self._folder, self._manifest, versions)
        remove_partial_files(self._folder)
        write_manifest(self._folder, self._manifest)
        self._is_prepared = True

    def _image_done(self, entry: ShardEntry, numbers: Iterator[int]) -> None:
        """Count an image, unless it was counted before the renderer crashed."""
        if self._stopping.is_set():
            raise _StoppedError
        number = next(numbers)
        with self._lock:
            if number > self._counted[entry.file]:
                self._counted[entry.file] = number
                self._on_image()

    def _keep(self, entry: ShardEntry, shard: ShardFile) -> None:
        sha256 = hashlib.sha256(shard.data).hexdigest()
        if entry.is_finished and sha256 != entry.sha256:
            raise DataError(
                f"{self._folder / entry.file}: made again, its SHA-256 is {sha256}, not {entry.sha256} as the manifest "
                "says: other software made the set. Fetch the shard again, or render the set anew"
            )
        write_atomically(self._folder / entry.file, shard.data)
        with self._lock:
            self._manifest = self._manifest.with_finished(
                replace(entry, bytes=len(shard.data), sha256=sha256, content_sha256=shard.content_sha256)
            )
            write_manifest(self._folder, self._manifest)


class _StoppedError(Exception):
    """Another worker failed, or the user pressed Ctrl-C."""


def make_shard(
    plan: SetPlan,
    entry: ShardEntry,
    renderer: Renderer,
    on_image: OnImage,
    visibility: MarkingVisibility | None = None,
) -> ShardFile:
    """Draw and annotate the images of one shard."""
    spec = plan.spec
    header = ShardHeader(
        object=spec.name,
        object_sha256=spec.digest,
        split=entry.split,
        first_index=entry.first_index,
        seed=plan.seed,
        camera=plan.camera.to_dict(),
        render=plan.settings.to_dict(),
        tolerance_px=spec.marking.tolerance_px if spec.marking else np.nan,
        versions=software_versions(renderer),
    )
    annotated = plan.manifest().is_annotated(entry.split)
    writer = ShardWriter(header, entry.images, spec.symmetry_group, annotated=annotated)
    candidates = within_tolerance = 0
    try:
        for index in range(entry.first_index, entry.first_index + entry.images):
            R_gt = label_rotation(plan.seed, spec.name, entry.split, index)
            view = renderer.render(R_gt)
            pixels = marking_pixels(spec, R_gt, view.marking_pixels, renderer, visibility)
            mask = None
            if annotated:
                annotation = annotate(spec, R_gt, pixels, renderer, visibility)
                mask, drawn = annotation.mask, annotation.candidate_pixels
                candidates += int(np.count_nonzero(np.isfinite(drawn)))
                within_tolerance += int(np.count_nonzero((drawn > 0) & ~is_shown(spec, drawn)))
            writer.add(ImageRecord(view, R_gt, pixels, mask))
            on_image()
        return writer.finish({"candidates_drawn": candidates, "candidates_within_tolerance": within_tolerance})
    finally:
        writer.close()


def software_versions(renderer: Renderer) -> dict[str, str]:
    """Return the software that decides a shard's bytes: name to version."""
    return {"symsol-annot": __version__, **storage_versions(), **renderer.versions}
