"""Making a set: a plan of shards, carried out by an executor, each checked on arrival and put into the folder.

The plan depends on nothing but the settings, and a shard on nothing but the plan, so that the bytes are the
same whichever worker made it and in whatever order. This process alone writes to the folder.
"""

import hashlib
import threading
from collections import Counter, deque
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import replace
from functools import partial
from pathlib import Path

from symsol_annot.errors import (
    ClusterError,
    DataError,
    DifferentSetError,
    RendererCrashedError,
    bulleted,
    output_errors,
)
from symsol_annot.generation.events import (
    ForeignShardsFound,
    ImagesMade,
    ObjectChecked,
    OnEvent,
    ShardBegunAgain,
    ShardFinished,
    Started,
    WorkersGone,
    ignore,
)
from symsol_annot.generation.executors import Executor, OpenExecutor
from symsol_annot.generation.maker import MadeShard
from symsol_annot.objects.checking.check import check_object
from symsol_annot.sets.manifest import (
    MANIFEST_NAME,
    Manifest,
    ShardEntry,
    read_manifest,
    refuse_to_add,
    shards_in,
    write_manifest,
)
from symsol_annot.sets.membership import membership_faults
from symsol_annot.sets.plan import SetPlan
from symsol_annot.sets.shard.laws import label_faults
from symsol_annot.sets.shard.reader import header_mismatches, open_shard, prepare_to_open
from symsol_annot.system.files import check_inside, make_folder, written_atomically
from symsol_annot.system.locks import held_folder
from symsol_annot.system.reading import file_sha256
from symsol_annot.system.scratch import sweep

MAX_CRASHES_PER_SHARD = 2
_AHEAD = 1  # shards that wait beyond those being made, so that no worker waits for this process
_LOOK_SECONDS = 1.0  # between two looks at how many workers there are


def generate(
    plan: SetPlan,
    folder: Path,
    open_executor: OpenExecutor,
    on_event: OnEvent = ignore,
    *,
    repair: bool = False,
) -> Manifest:
    """Make the shards of a plan that the folder does not hold yet, and return the finished manifest.

    Args:
        plan: the set.
        folder: where its shards and its manifest go.
        open_executor: from the plan to who makes its shards; called only if there is work.
        on_event: told what happens, by one thread at a time.
        repair: make shards again that were finished once and are missing or damaged, and replace foreign ones.

    Raises:
        ObjectError: the object's surface or marking has other symmetries than it declares; nothing was touched.
        DifferentSetError: the folder holds another set, or one begun with other software; nothing was touched.
        DataError: a shard in the folder is damaged or foreign, or made again it is not what the manifest says; that
            shard was not touched. Or the folder's set is of an older format, to which nothing is added.
        OutputError: the folder cannot be written to, or another process is making this set.
        RenderError: a worker failed, or a shard lost more than two of them; finished shards are kept.
    """
    _open_set(plan, folder)  # refuses another set before anything is touched
    with held_folder(folder):
        manifest = _open_set(plan, folder)
        damaged = damaged_shards(folder, manifest)
        todo = [entry for entry in manifest.shards if not entry.is_finished or entry in damaged]
        if not repair:
            _refuse_damaged(folder, damaged)
            _refuse_foreign(folder, manifest, [entry for entry in todo if not entry.is_finished])
        total, left = (sum(entry.images for entry in entries) for entries in (manifest.shards, todo))
        on_event(Started(total, len(manifest.shards), total - left, len(manifest.shards) - len(todo)))
        foreign = set(shards_in(folder)) - {entry.file for entry in manifest.shards}
        if foreign:
            on_event(ForeignShardsFound(tuple(sorted(foreign))))
        if not todo:
            _check(plan, on_event)
        else:
            check_inside(folder, [MANIFEST_NAME, *(entry.file for entry in manifest.shards)])
            with open_executor(plan) as executor:
                executor.prepare(len(todo))
                prepare_to_open()
                _check(plan, on_event)  # while all these start
                make_folder(folder)
                _Execution(folder, executor, manifest, on_event, repair=repair).carry_out(todo)
        return read_manifest(folder)


def _check(plan: SetPlan, on_event: OnEvent) -> None:
    checked = check_object(plan.spec)
    if checked.group is not None:
        on_event(ObjectChecked(checked.group, checked.residual, checked.notes))


def damaged_shards(folder: Path, manifest: Manifest) -> list[ShardEntry]:
    """Return the shards that were finished once and are not there, or not as they were."""
    return [entry for entry in manifest.shards if entry.is_finished and not _is_whole(folder, entry)]


def _open_set(plan: SetPlan, folder: Path) -> Manifest:
    """Return the manifest to go on from: the one that is there, if it is of this plan, or a new one; touch nothing."""
    planned = plan.manifest()
    with output_errors(folder):
        is_there = (folder / MANIFEST_NAME).exists()
        foreign = shards_in(folder) if folder.is_dir() else []
    if is_there:
        manifest = read_manifest(folder)
        refuse_to_add(folder, manifest)
        differences = planned.differences(manifest)
        if differences:
            raise DifferentSetError(str(folder), differences)
        return manifest
    if foreign:
        raise DifferentSetError(str(folder), [f"it holds {foreign[0]} without a {MANIFEST_NAME}"])
    return planned


def _is_whole(folder: Path, entry: ShardEntry) -> bool:
    path = folder / entry.file
    try:
        return path.stat().st_size == entry.bytes and file_sha256(path) == entry.sha256
    except OSError:
        return False


def _refuse_damaged(folder: Path, damaged: list[ShardEntry]) -> None:
    if damaged:
        raise DataError(
            f"{folder}: finished shards are missing or damaged: {', '.join(entry.file for entry in damaged)}. "
            "They are left as they are; the same command with --repair makes them again, to the same bytes"
        )


def _refuse_foreign(folder: Path, manifest: Manifest, unfinished: list[ShardEntry]) -> None:
    """Refuse files with the names of shards to be made, unless a killed run of this very plan may have left them."""
    foreign = [
        entry.file for entry in unfinished if _is_foreign(folder / entry.file, manifest.expected_attributes(entry))
    ]
    if foreign:
        raise DataError(
            f"{folder}: holds files that are no shards of this set, under the names of shards to be made: "
            f"{', '.join(foreign)}. They are left as they are; move them elsewhere, or give --repair to replace them"
        )


def _is_foreign(path: Path, expected: dict[str, object]) -> bool:
    if not path.exists():
        return False
    try:
        with open_shard(path) as shard:
            return bool(header_mismatches(shard, expected))
    except DataError:
        return True


def _where(entry: ShardEntry, made: MadeShard) -> str:
    return f"{entry.file}, as it arrived from {made.worker or 'its worker'}"


def _differences(there: dict[str, str], here: dict[str, str]) -> list[str]:
    """Say which software differs between two shards."""
    names = sorted(name for name in {*there, *here} if there.get(name) != here.get(name))
    return [f"{name}: there {there.get(name)}, here {here.get(name)}" for name in names]


class _Execution:
    """The execution of a plan: a thread submits shards, one keeps what arrives, the executor's threads count images."""

    def __init__(
        self, folder: Path, executor: Executor, manifest: Manifest, on_event: OnEvent, *, repair: bool
    ) -> None:
        self._folder, self._executor, self._manifest, self._repair = folder, executor, manifest, repair
        self._on_event = on_event
        self._lock = threading.Lock()
        self._counted: Counter[str] = Counter()  # images of a shard that were told of
        self._crashes: Counter[str] = Counter()  # by shard
        self._versions: dict[str, str] = {}  # the software that this set is made with, once a shard has arrived
        self._first_worker = ""
        self._is_prepared = False
        self._has_workers = True

    def carry_out(self, todo: list[ShardEntry]) -> None:
        """Make all shards to do; on an error or Ctrl-C, leave at once and keep the finished ones."""
        waiting = deque(todo)
        under_way: dict[Future[MadeShard], ShardEntry] = {}
        with ThreadPoolExecutor(1, thread_name_prefix="keep") as keeper:  # which Ctrl-C does not interrupt half-way
            while waiting or under_way:
                room = self._capacity() + _AHEAD - len(under_way)
                for entry in [waiting.popleft() for _ in range(min(room, len(waiting)))]:
                    under_way[self._executor.submit(entry, partial(self._count, entry))] = entry
                done, _ = wait(under_way, timeout=_LOOK_SECONDS, return_when=FIRST_COMPLETED)
                arrived = [future for future in under_way if future in done]
                for future in sorted(
                    arrived, key=lambda future: future.exception() is not None
                ):  # lose none that is made
                    entry = under_way.pop(future)
                    try:
                        keeper.submit(self._keep, entry, future.result()).result()
                    except RendererCrashedError as error:
                        self._begin_again(entry, error)
                        waiting.append(entry)

    def _capacity(self) -> int:
        capacity = self._executor.capacity()
        if capacity == 0 and self._has_workers:
            self._tell(WorkersGone())
        self._has_workers = capacity > 0
        return capacity

    def _count(self, entry: ShardEntry, made: int) -> None:
        with self._lock:
            more = made - self._counted[entry.file]
            if more > 0:
                self._counted[entry.file] = made
                self._on_event(ImagesMade(more))

    def _tell(self, event: ShardFinished | ShardBegunAgain | WorkersGone) -> None:
        with self._lock:
            self._on_event(event)

    def _begin_again(self, entry: ShardEntry, error: RendererCrashedError) -> None:
        """Take note of a crash; refuse to go on with a shard that has had too many."""
        self._crashes[entry.file] += 1
        if self._crashes[entry.file] > MAX_CRASHES_PER_SHARD:
            raise type(error)(
                f"{entry.file}: {self._crashes[entry.file]} workers were lost while they made it, and it is given up. "
                f"The last: {error}\nFinished shards are kept: re-running the command resumes it. "
                "`symsol-annot doctor` tells what Blender may be missing here."
            )
        self._tell(ShardBegunAgain(entry.file, error.worker, self._crashes[entry.file], str(error)))

    def _keep(self, entry: ShardEntry, made: MadeShard) -> None:
        """Check a shard on its arrival, and put it into the folder."""
        path = self._folder / entry.file
        if hashlib.sha256(made.data).hexdigest() != made.sha256:
            raise DataError(
                f"{_where(entry, made)}: its bytes are not those that were made; the same command makes it again"
            )
        if entry.is_finished and made.sha256 != entry.sha256:
            raise DataError(
                f"{path}: made again, its SHA-256 is {made.sha256}, not {entry.sha256} as the manifest says: other "
                "software made the set. Fetch the shard again, or render the set anew"
            )
        if self._is_to_be_written(entry, made):
            with written_atomically(path, made.data) as new:
                self._check_arrival(entry, made, new)
                self._prepare_folder()
        else:
            self._check_arrival(entry, made, path)
            self._prepare_folder()
        self._manifest = self._manifest.with_finished(
            replace(entry, bytes=len(made.data), sha256=made.sha256, content_sha256=made.content_sha256)
        )
        write_manifest(self._folder, self._manifest)
        self._count(entry, entry.images)
        self._tell(ShardFinished(entry.file, entry.images, made.worker))

    def _is_to_be_written(self, entry: ShardEntry, made: MadeShard) -> bool:
        """Tell whether the folder lacks a shard that arrived; a killed run may have left it, not yet listed."""
        path = self._folder / entry.file
        if not path.exists():
            return True
        if file_sha256(path) == made.sha256:
            return False
        if not (self._repair or entry.is_finished):
            raise DataError(
                f"{path}: is there already, unknown to the manifest and other than this set's shard. It is left as it "
                "is; move it elsewhere, or give --repair to replace it"
            )
        return True

    def _check_arrival(self, entry: ShardEntry, made: MadeShard, path: Path) -> None:
        """Refuse a shard that is not the one asked for, or made with other software than the set's others.

        Args:
            entry: what was asked for.
            made: what came.
            path: a file of those bytes.

        Raises:
            DataError: it is no shard, or not this one, or its labels break a law.
            DifferentSetError: other software would make other bytes.
        """
        try:
            with open_shard(path) as shard:
                versions = shard.versions
                wrong = [*membership_faults(shard, self._manifest, entry)]
                wrong = wrong or [*label_faults(shard, shard.labels())]
        except DataError as error:  # which names a file that is gone by then
            raise DataError(f"{_where(entry, made)}: {str(error).removeprefix(f'{path}: ')}") from None
        if wrong:
            raise DataError(f"{_where(entry, made)}: is another shard, or damaged:\n" + bulleted(wrong))
        self._check_software(made, versions)

    def _check_software(self, made: MadeShard, versions: dict[str, str]) -> None:
        if not self._versions:
            there = self._versions_there()
            if there and _differences(there, versions):
                raise DifferentSetError(str(self._folder), _differences(there, versions))
            self._versions, self._first_worker = versions, made.worker
        elif _differences(self._versions, versions):
            raise ClusterError(
                f"{made.worker} makes shards with other software than {self._first_worker}, so their bytes would "
                f"differ ({'; '.join(_differences(self._versions, versions))}). Give all workers the same environment; "
                "finished shards are kept, and re-running the command resumes it"
            )

    def _versions_there(self) -> dict[str, str] | None:
        """Return the software that a shard of the folder was made with; None where there is none yet."""
        for entry in self._manifest.shards:
            if entry.is_finished and _is_whole(self._folder, entry):
                with open_shard(self._folder / entry.file) as shard:
                    return shard.versions
        return None

    def _prepare_folder(self) -> None:
        """Write the manifest before the first shard, but only once there is one."""
        if not self._is_prepared:
            sweep(self._folder)
            write_manifest(self._folder, self._manifest)
            self._is_prepared = True
